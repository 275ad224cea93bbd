"""Wrong inputs of every command, one at a time: a clear refusal, no traceback, nothing left.

Commands and their options are found from the parsers. Each test changes one input of a command
line that is right otherwise.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

NEW = "a new place"
"""Stands for a path that is not there yet."""
RIGHT: dict[str, dict[str, str]] = {
    "lightstage capture": {"--out": NEW, "--rig": "rig", "--leds": "serial:///dev/none"},
    "lightstage retake": {"session": "session", "pattern": "full", "--leds": "serial:///n"},
    "lightstage console": {"--plan": "plan", "--rig": "rig", "--leds": "serial:///dev/none"},
    "lightstage devices": {"--rig": "rig", "--leds": "serial:///dev/none"},
    "lightstage sessions": {"folder": "session"},
    "lightstage watch": {"session": "session"},
    "lightstage calibrate": {"kind": "grey", "--rig": "rig", "--out": NEW, "--leds": "serial:///n"},
    "lightstage calibrations": {"lab": "lab"},
    "lightstage rig check": {"rig": "rig"},
    "lightstage lights identify": {"--rig": "rig", "--out": NEW, "--leds": "serial:///dev/none"},
    "lightstage patterns": {"sequence": "binary", "--rig": "rig"},
    "lightstage import": {"folder": "photographs", "--rig": "rig", "--out": NEW},
    "lightstage landmarks": {"photo": "portrait", "--out": NEW},
    "lightstage check": {"session": "session"},
    "processing calibrate": {"lab": "lab", "--out": NEW},
    "processing calibrate-cameras": {"lab": "lab", "--out": NEW},
    "processing locate-lights": {"lab": "lab", "--out": NEW},
    "processing run": {"session": "session", "--out": NEW, "--until": "decode"},
    "processing separate": {"session": "session", "--out": NEW},
    "processing reconstruct": {"session": "session", "--out": NEW},
    "processing refine": {"session": "session", "--out": NEW},
    "processing register": {"session": "session", "--out": NEW},
    "processing atlas": {"session": "session", "--out": NEW},
    "processing register-mesh": {"mesh": "mesh", "--landmarks": "points", "--out": NEW},
    "processing template import-ict": {"clone": "session", "--out": NEW},
    "processing template import-gnm": {"model": "session", "--out": NEW},
    "processing template import-makehuman": {"data": "session", "--out": NEW},
    "processing template import-obj": {"mesh": "mesh", "--landmarks": "points", "--out": NEW},
    "processing template check": {"template": "template"},
    "processing template transfer": {
        "maps": "mesh's maps", "--from": "template", "--to": "template", "--out": NEW,
    },
    "processing template population": {"other": "template", "--to": "template"},
    "processing evaluate": {"out": "processed", "truth": "processed"},
    "processing dataset build": {"processed": "processed", "--out": NEW},
    "processing dataset publish": {"store": "store", "--about": "about", "--out": NEW},
    "processing dataset add": {"processed": "processed", "--store": "store"},
    "processing dataset remove": {"scans": "0123456789abcdef", "--store": "store"},
    "processing dataset list": {"store": "store"},
    "processing dataset verify": {"store": "store"},
    "processing dataset forget": {"subject": "P9", "--in": "lab", "--out": NEW},
    "processing batch": {"sessions": "session", "--out": NEW, "--until": "decode"},
    "learning render": {
        "--maps": "mesh's maps", "--environment": "lights", "--out": NEW, "--mesh": "mesh",
    },
    "learning bake": {
        "--maps": "mesh's maps", "--mesh": "mesh", "--environment": "lights", "--out": NEW,
    },
    "learning export": {"maps": "mesh's maps", "--mesh": "mesh", "--out": NEW},
    "learning occlusion": {"--out": NEW},
    "learning template-points": {"--template": "template", "--out": NEW},
    "learning train": {"--data": "store", "--out": NEW},
    "learning train-points": {"--data": "store", "--template": "template", "--out": NEW},
    "learning domain-light": {"textures": "texture", "--mesh": "mesh", "--out": NEW},
    "learning infer": {
        "--texture": "texture", "--mesh": "mesh", "--checkpoint": "run", "--out": NEW,
    },
    "learning upscale": {
        "picture": "texture", "--checkpoint": "super-resolution", "--out": NEW,
    },
    "learning fit": {"photo": "portrait", "--template": "template", "--out": NEW},
    "learning detail": {"maps": "mesh's maps", "--mesh": "mesh", "--out": NEW},
    "learning experiment": {"name": "ladder", "--data": "store", "--out": NEW},
    "learning evaluate": {"inferred": "maps", "--truth": "maps", "--out": NEW},
    "learning avatar": {"photo": "portrait", "--template": "template", "--out": NEW},
    "sim import-ict": {"path": "session", "--out": NEW},
    "sim import-scan": {"file": "mesh", "--out": NEW},
    "sim stage": {},
    "sim icl": {"--port": "0"},
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
    ("lightstage console", "--plan", "missing"),
    ("lightstage console", "--config", "empty"),
    ("lightstage console", "--calibration", "of the other kind"),
    ("lightstage console", "--processed", "of the other kind"),
    ("lightstage devices", "--config", "empty"),
    ("lightstage devices", "--folder", "of the other kind"),
    ("lightstage sessions", "--processed", "of the other kind"),
    ("lightstage import", "--config", "empty"),
    ("processing run", "--config", "empty"),
    ("processing batch", "--config", "empty"),
    ("processing separate", "--config", "empty"),
    ("processing template transfer", "--config", "empty"),
    ("learning fit", "--config", "empty"),
    ("learning train-points", "--config", "empty"),
    ("learning avatar", "--config", "empty"),
    ("sim stage", "--faults", "empty"),
    ("sim icl", "--faults", "empty"),
    ("sim session", "--faults", "empty"),
    ("lightstage watch", "session", "missing"),
    ("lightstage watch", "session", "empty"),
    ("lightstage watch", "--wait", "inf"),
}
"""What is taken, and rightly: a lab without shots, a file that changes nothing, an empty folder;
`watch` waits, and a day's plan may be new."""
CHOICES = {
    "kind", "--drive", "--do", "--mode", "--background", "--shadows", "--light", "--until",
    "--sequence", "sequence", "--preset", "--flaws", "--people", "--camera",
    "--format", "--scheme", "--recogniser-range", "--size", "--only",
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
        name: str(folder / f"out{command.suffix(name)}")
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
