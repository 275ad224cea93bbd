"""Every command of the four programs, found from their parsers, and right inputs for them."""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import typer

from learning.checkpoint import save_checkpoint
from learning.networks.generator import Generator
from learning.patch_config import TrainConfig
from learning.presets import preset
from learning.render.uv import rasterise
from learning.upscale.config import UpscaleTrainConfig
from learning.upscale.network import Rcan
from lightstage.day import DayPlan, write_plan
from lightstage.formats.config import as_dict
from lightstage.formats.environment import LightSet, write_lights
from lightstage.formats.exr import write_exr
from lightstage.formats.files import write_json
from lightstage.formats.mesh import Mesh, write_obj
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.template import Template, default_template_path, save_template
from lightstage.importing import import_session
from lightstage.rig import default_rig, save_rig
from processing.dataset import build_store

PROGRAMS = ("lightstage", "processing", "learning", "sim")


@dataclasses.dataclass(frozen=True)
class Command:
    """One command of a program.

    Attributes:
        program: package that holds it.
        words: its name, with its group's before it.
        parser: Typer's.
    """

    program: str
    words: tuple[str, ...]
    parser: Any

    def __str__(self) -> str:
        return " ".join((self.program, *self.words))

    @property
    def outputs(self) -> dict[str, Any]:
        """Options that name what is written, by name."""
        named = {option: p for p in self.parser.params for option in p.opts}
        return {name: named[name] for name in ("--out", "--picture", "--network") if name in named}

    def suffix(self, option: str) -> str:
        """What a file of this output ends in; nothing for a folder."""
        text = self.outputs[option].help.lower()
        if text.startswith("folder"):
            return ""
        return next(
            (s for s in (".exr", ".png", ".npz", ".obj", ".svg", ".json") if s[1:] in text), ""
        )

    def words_with(self, option: str, value: Path) -> list[str]:
        """A command line with this output and something for all else that is required."""
        words = [*self.words, option, str(value)]
        for param in self.parser.params:
            if not param.required or option in param.opts:
                continue
            words += [param.opts[0]] if param.opts[0].startswith("-") else []
            words.append("nothing")
        return words


def found_commands() -> list[Command]:
    """All commands, from the parsers."""
    found = []
    for program in PROGRAMS:
        app = importlib.import_module(f"{program}.__main__").app
        _add(found, program, (), typer.main.get_command(app))
    return found


def _add(found: list[Command], program: str, words: tuple[str, ...], parser: Any) -> None:
    for name in parser.list_commands(None):
        below = parser.get_command(None, name)
        if hasattr(below, "commands"):
            _add(found, program, (*words, name), below)
        else:
            found.append(Command(program, (*words, name), below))


COMMANDS = found_commands()


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Give tests `each_command`, or `each_output`: a command and one of its outputs."""
    if "each_command" in metafunc.fixturenames:
        metafunc.parametrize("each_command", COMMANDS, ids=str)
    if "each_output" in metafunc.fixturenames:
        pairs = [(command, option) for command in COMMANDS for option in command.outputs]
        names = [f"{command} {option}" for command, option in pairs]
        metafunc.parametrize("each_output", pairs, ids=names)


@pytest.fixture(scope="session")
def world(tmp_path_factory, make_processed) -> dict[str, Path]:
    """Small right inputs by name."""
    folder = tmp_path_factory.mktemp("Möbel und mehr")
    rig = default_rig().scaled(24 / 6016)
    rig = dataclasses.replace(rig, lights=rig.lights[::8], cameras=rig.cameras[:2])
    rng = np.random.default_rng(0)
    at = {"rig": save_rig(rig, folder / "rig.json")}
    at["plan"] = write_plan(folder / "plan.toml", DayPlan())
    at["photographs"] = folder / "photographs"
    (at["photographs"] / "full").mkdir(parents=True)
    for camera in rig.cameras:
        size = (camera.height_px, camera.width_px, 3)
        write_exr(at["photographs"] / "full" / f"{camera.id}.exr", rng.random(size))
    at["template"] = default_template_path()
    at["portrait"] = folder / "portrait.png"
    people = cv2.imread(str(Path(__file__).parents[2] / "docs" / "people.jpg"))
    cv2.imwrite(str(at["portrait"]), people[:270, 327:490])
    at["session"] = folder / "session"
    import_session(at["photographs"], rig, at["session"], "P1", "neutral")
    at["lab"] = folder / "lab"
    at["lab"].mkdir()
    # A sheet as wide as a face and bent: what is flat is no head.
    corners = np.array([[-1.0, -1, 0], [1, -1, 1], [1, 1, 0], [-1, 1, 1]])
    square = np.array([[0, 1, 2, 3]], np.int32)
    mesh = Mesh(60 * corners, square, (corners[:, :2] + 1) / 2, square)
    at["mesh"] = write_obj(mesh, folder / "mesh.obj")
    plate = Template("a plate", mesh, np.arange(68) % 4, {"skin": np.arange(4)}, "", "")
    at["template"] = save_template(plate, folder / "template")
    face = ProcessedFolder(folder / "face")
    raster = rasterise(mesh, 24, 16)
    for name in ("diffuse_normal", "specular_normal"):
        face.write_atlas(name, raster.normals(mesh))
    face.write_atlas("diffuse_albedo", rng.random((24, 16, 3)))
    face.write_atlas("specular_albedo", np.full((24, 16), 0.03))
    at["mesh's maps"] = face.root / "atlas"
    points = {"scheme": "ibug68", "points_mm": [[float(i), 0.0, 0.0] for i in range(68)]}
    at["points"] = write_json(folder / "points.json", points)
    lights = LightSet("key", np.array([[0.0, 0, 900]]), np.ones((1, 3)), np.zeros(3))
    at["lights"] = write_lights(lights, folder / "lights.json")
    at["texture"] = write_exr(folder / "texture.exr", rng.random((96, 64, 3)))
    config = preset("demo", {"generator": {"width": 2}, "data": {"patch_px": 32}}, "test")
    assert isinstance(config, TrainConfig)
    about = {
        "config": as_dict(config), "data_fingerprint": "", "held_out": [], "texture_rows": 96,
        "metrics": {},
    }  # fmt: skip
    weights = dict(Generator(config.generator).state_dict())
    at["run"] = folder / "run"
    save_checkpoint(at["run"], 1, {"generator": weights}, about)
    small = preset("rcan-small", {"network": {"groups": 1, "blocks": 1}}, "test")
    assert isinstance(small, UpscaleTrainConfig)
    at["super-resolution"] = folder / "super-resolution"
    weights = dict(Rcan(small.network).state_dict())
    about = {**about, "family": small.family, "config": as_dict(small)}
    save_checkpoint(at["super-resolution"], 1, {"network": weights}, about)
    quick = "steps = 1\njoint_steps = 1\nregressed = 1\nbatch = 2\n"
    at["quick training"] = folder / "quick.toml"
    at["quick training"].write_text(quick)
    at["small rig"] = save_rig(default_rig().scaled(48 / 6016), folder / "small rig.json")
    at["processed"] = make_processed(folder / "processed")
    at["maps"] = at["processed"] / "atlas"
    at["about"] = Path(__file__).parents[2] / "demo" / "about.toml"
    at["store"] = build_store([at["processed"]], folder / "store")
    return at


RUNNABLE = {
    "patterns": ("lightstage", "patterns", "binary", "--rig", "{rig}", "--out", "{new}.png"),
    "import": ("lightstage", "import", "{photographs}", "--rig", "{rig}", "--out", "{new}"),
    "decode": ("processing", "run", "{session}", "--until", "decode", "--out", "{new}"),
    "build": ("processing", "dataset", "build", "{processed}", "--out", "{new}"),
    "bake": (
        "learning", "bake", "--maps", "{mesh's maps}", "--mesh", "{mesh}",
        "--environment", "{lights}", "--out", "{new}.exr",
    ),
    "render": (
        "learning", "render", "--maps", "{mesh's maps}", "--mesh", "{mesh}",
        "--environment", "{lights}", "--rig", "{small rig}", "--out", "{new}.png",
    ),
    "occlusion": (
        "learning", "occlusion", "--rows", "24", "--directions", "8", "--out", "{new}.npz",
    ),
    "head's occlusion": (
        "learning", "occlusion", "--head", "{mesh}", "--directions", "8", "--out", "{new}.npz",
        "--network", "{new} network", "--config", "{quick training}",
    ),
    "export": ("learning", "export", "{mesh's maps}", "--mesh", "{mesh}", "--out", "{new}"),
    "infer": (
        "learning", "infer", "--texture", "{texture}", "--mesh", "{mesh}", "--checkpoint", "{run}",
        "--out", "{new}",
    ),
    "upscale": (
        "learning", "upscale", "{texture}", "--checkpoint", "{super-resolution}",
        "--out", "{new}.exr",
    ),
    "landmarks": ("lightstage", "landmarks", "{portrait}", "--out", "{new}.json"),
    "targets": ("sim", "targets", "--rig", "{rig}", "--scale", "1", "--out", "{new}"),
}  # fmt: skip
"""Words of each command; `{name}` is a file of `world`, `{new}` a place that is not there yet."""


@pytest.fixture(params=RUNNABLE)
def command(request: pytest.FixtureRequest, world: dict[str, Path]) -> Callable[[Path], list[str]]:
    """A function: the words of one command that writes to a place."""

    def words(new: Path) -> list[str]:
        return [word.format(**world, new=new) for word in RUNNABLE[request.param]]

    return words
