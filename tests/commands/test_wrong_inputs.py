"""Wrong inputs of every command, one at a time: a clear refusal, no traceback, nothing left.

Commands and their options are found from the parsers. Each test changes one input of a command
line that is right otherwise.
"""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from learning.checkpoint import save_checkpoint
from learning.networks.generator import Generator
from learning.presets import preset
from lightstage.formats.config import as_dict
from lightstage.formats.environment import LightSet, write_lights
from lightstage.formats.exr import write_exr
from lightstage.formats.files import write_json
from lightstage.formats.mesh import Mesh, write_obj
from lightstage.importing import import_session
from lightstage.rig import default_rig, save_rig
from processing.dataset import build_store

NEW = "a new place"
"""Stands for a path that is not there yet."""
RIGHT: dict[str, dict[str, str]] = {
    "lightstage capture": {"--out": NEW, "--rig": "rig", "--leds": "serial:///dev/none"},
    "lightstage retake": {"session": "session", "pattern": "full", "--leds": "serial:///n"},
    "lightstage watch": {"session": "session"},
    "lightstage calibrate": {"kind": "grey", "--rig": "rig", "--out": NEW, "--leds": "serial:///n"},
    "lightstage calibrations": {"lab": "lab"},
    "lightstage patterns": {"sequence": "binary", "--rig": "rig"},
    "lightstage import": {"folder": "photographs", "--rig": "rig", "--out": NEW},
    "lightstage check": {"session": "session"},
    "processing calibrate": {"lab": "lab", "--out": NEW},
    "processing calibrate-cameras": {"lab": "lab", "--out": NEW},
    "processing run": {"session": "session", "--out": NEW, "--until": "decode"},
    "processing separate": {"session": "session", "--out": NEW},
    "processing reconstruct": {"session": "session", "--out": NEW},
    "processing refine": {"session": "session", "--out": NEW},
    "processing register": {"session": "session", "--out": NEW},
    "processing atlas": {"session": "session", "--out": NEW},
    "processing register-mesh": {"mesh": "mesh", "--landmarks": "points", "--out": NEW},
    "processing evaluate": {"out": "processed", "truth": "processed"},
    "processing dataset build": {"processed": "processed", "--out": NEW},
    "processing dataset publish": {"store": "store", "--out": NEW},
    "learning render": {
        "--maps": "maps", "--environment": "lights", "--out": NEW, "--mesh": "mesh",
    },
    "learning bake": {"--maps": "maps", "--mesh": "mesh", "--environment": "lights", "--out": NEW},
    "learning occlusion": {"--out": NEW},
    "learning train": {"--data": "store", "--out": NEW},
    "learning infer": {
        "--texture": "texture", "--mesh": "mesh", "--checkpoint": "run", "--out": NEW,
    },
    "sim import-ict": {"path": "session", "--out": NEW},
    "sim import-scan": {"file": "mesh", "--out": NEW},
    "sim stage": {},
    "sim calibrate": {"kind": "grey", "--out": NEW},
    "sim session": {"--subject": "P1", "--out": NEW},
    "sim dataset": {"--out": NEW, "--subjects": "1"},
    "sim render": {"--subject": "P1", "--light": "full", "--out": NEW},
    "sim targets": {"--out": NEW},
    "sim gallery": {"--out": NEW},
    "sim template": {"--out": NEW},
}  # fmt: skip
"""A right command line of each command: inputs by the name of a file of `world`."""
RIGHT_TOO = {
    ("lightstage calibrations", "lab", "empty"),
    ("lightstage calibrations", "--config", "empty"),
    ("lightstage import", "--config", "empty"),
    ("processing run", "--config", "empty"),
    ("processing separate", "--config", "empty"),
    ("sim stage", "--faults", "empty"),
    ("sim session", "--faults", "empty"),
    ("lightstage watch", "session", "missing"),
    ("lightstage watch", "session", "empty"),
    ("lightstage watch", "--wait", "inf"),
}
"""What is taken, and rightly: a lab without shots, a file that changes nothing; `watch` waits."""
CHOICES = {
    "kind", "--drive", "--do", "--mode", "--background", "--shadows", "--light", "--until",
    "--sequence", "sequence", "--preset", "--flaws", "--people", "--camera",
}  # fmt: skip
"""Options that take one of some words."""


def wrong_values(param: Any) -> list[str]:
    """What is tried in place of an option's right value."""
    kind = str(param.type_descriptor.annotation)
    if "Path" in kind:
        return ["missing", "of the other kind", "empty", "garbage", "FIFO"]
    words = {"int": ["-1", "many"], "float": ["nan", "inf", "much"]}
    found = next((v for name, v in words.items() if f"'{name}'" in kind), [])
    return [*found, *(["nonsense"] if param.opts[0] in CHOICES else [])]


@pytest.fixture(scope="module")
def world(tmp_path_factory, make_processed) -> dict[str, Path]:
    """Small right inputs by name."""
    folder = tmp_path_factory.mktemp("Möbel und mehr")
    rig = default_rig().scaled(24 / 6016)
    rig = dataclasses.replace(rig, lights=rig.lights[::8], cameras=rig.cameras[:2])
    rng = np.random.default_rng(0)
    at = {"rig": save_rig(rig, folder / "rig.json")}
    at["photographs"] = folder / "photographs"
    (at["photographs"] / "full").mkdir(parents=True)
    for camera in rig.cameras:
        size = (camera.height_px, camera.width_px, 3)
        write_exr(at["photographs"] / "full" / f"{camera.id}.exr", rng.random(size))
    at["session"] = folder / "session"
    import_session(at["photographs"], rig, at["session"], "P1", "neutral")
    at["lab"] = folder / "lab"
    at["lab"].mkdir()
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    mesh = Mesh(50 * corners, np.array([[0, 1, 2, 3]]), (corners[:, :2] + 1) / 2, None)
    at["mesh"] = write_obj(mesh, folder / "mesh.obj")
    points = {"scheme": "ibug68", "points_mm": [[float(i), 0.0, 0.0] for i in range(68)]}
    at["points"] = write_json(folder / "points.json", points)
    lights = LightSet("key", np.array([[0.0, 0, 900]]), np.ones((1, 3)), np.zeros(3))
    at["lights"] = write_lights(lights, folder / "lights.json")
    at["texture"] = write_exr(folder / "texture.exr", rng.random((96, 64, 3)))
    config = preset("demo", {"generator": {"width": 2}}, "test")
    about = {
        "config": as_dict(config), "data_fingerprint": "", "held_out": [], "texture_rows": 96,
        "metrics": {},
    }  # fmt: skip
    weights = dict(Generator(config.generator).state_dict())
    at["run"] = folder / "run"
    save_checkpoint(at["run"], 1, {"generator": weights}, about)
    at["processed"] = make_processed(folder / "processed")
    at["maps"] = at["processed"] / "atlas"
    at["store"] = build_store([at["processed"]], folder / "store")
    return at


def test_every_command_has_a_right_command_line(each_command):
    assert str(each_command) in RIGHT


def test_every_wrong_input_is_refused_in_one_message(each_command, world, tmp_path, run_command):
    tried, failures = 0, []
    for param in each_command.parser.params:
        if param.opts[0] in each_command.outputs:
            continue
        for what in wrong_values(param):
            if (str(each_command), param.opts[0], what) in RIGHT_TOO:
                continue
            folder = tmp_path / f"{tried} {param.opts[0].strip('-')}"
            folder.mkdir()
            words = words_of(each_command, param.opts[0], what, world, folder)
            before = sorted(folder.rglob("*"))
            ended = run_command(each_command.program, *words)
            tried += 1
            if ended.code != 2 or "Traceback" in ended.err or not ended.err.strip():
                failures.append(f"{param.opts[0]} {what}: exit {ended.code}, {ended.err[-300:]}")
            elif sorted(folder.rglob("*")) != before:
                failures.append(f"{param.opts[0]} {what}: something was left in the folder")
    print(f"{each_command}: {tried} wrong inputs")
    assert not failures, "\n".join(failures)


def words_of(command, option, what, world, folder) -> list[str]:
    """A right command line but for one option."""
    right = {
        name: str(folder / f"out{suffix_of(command, name)}")
        if value == NEW
        else str(world.get(value, value))
        for name, value in RIGHT[str(command)].items()
    }
    was_folder = Path(right.get(option, "/none")).is_dir()
    suffix = Path(right.get(option, "")).suffix
    place = folder / f"wrong{suffix}"
    if what == "missing":
        right[option] = str(place)
    elif what == "of the other kind":
        place.write_text("x") if was_folder else place.mkdir()
        right[option] = str(place)
    elif what == "empty":
        place.mkdir() if was_folder else place.write_bytes(b"")
        right[option] = str(place)
    elif what == "garbage":
        place.write_bytes(bytes(range(256)) * 4)
        right[option] = str(place)
    elif what == "FIFO":
        os.mkfifo(place)
        right[option] = str(place)
    else:
        right[option] = what
    words = list(command.words)
    for name, value in right.items():
        words += [name, value] if name.startswith("-") else [value]
    return words


def suffix_of(command, option):
    """What a file of this option ends in; nothing for a folder."""
    text = command.outputs[option].help
    return next((s for s in (".exr", ".png", ".npz", ".obj", ".svg") if s[1:] in text.lower()), "")
