"""What the commands do: read files, call the pure function, write files, return the facts."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from learning.checkpoint import (
    load_generator,
    load_mesostructure,
    load_super_resolution,
    load_whole_face,
    read_checkpoint,
    shipped_mesostructure,
    shipped_super_resolution,
    shipped_weights,
)
from learning.clock import DATA, IDLE, NETWORK, PARTS, RENDERING
from learning.data import DataConfig
from learning.devices import choose_device, memory_of
from learning.domain.command import read_target_light
from learning.errors import MapsError
from learning.four.config import FourTrainConfig
from learning.four.infer import infer_four
from learning.four.networks import FourNetworks, load_four_networks
from learning.infer import infer
from learning.map_folders import require_texture_maps
from learning.maps import TexturedHead, load_head
from learning.mesostructure.infer import TrainedMesostructure
from learning.presets import preset, require_one_length
from learning.processes import ALONE, Processes, joined
from learning.relight import (
    lit_texture,
    notes_of_light,
    read_light,
    render_head,
    shadows_of,
    turned_camera,
    write_picture,
)
from learning.render.shading import ShadeOptions
from learning.resample import resampled_texture
from learning.run import not_better
from learning.train import other_rows, train
from learning.upscale.infer import upscale
from learning.whole.infer import infer_whole_face
from lightstage.commands import ProgressCallback
from lightstage.counting import counted
from lightstage.errors import ConfigError
from lightstage.formats.config import make_config, read_toml
from lightstage.formats.consents import require_consents
from lightstage.formats.environment import LightSet, write_lights
from lightstage.formats.exr import read_exr, write_exr
from lightstage.formats.files import atomic_folder, others_in, require_replaceable
from lightstage.formats.mesh import Mesh, read_mesh
from lightstage.formats.processed import ProcessedFolder, write_map
from lightstage.formats.template import load_template
from lightstage.rig import Camera, default_rig, load_rig
from processing.dataset import open_store, read_head_pose

DEFAULT_RIG_SCALE = 1080 / 6016
"""Without a rig, pictures are 720 x 1080 pixels."""
SHIPPED = "shipped"
"""For `train --begin-with`, in place of a run's folder."""
NONE = "none"
"""For `infer --mesostructure`, in place of a run's folder."""
REFINE_SECONDS = 60.0
"""Default limit of `infer`'s refinement; most textures take less."""
LIGHT = "light.json"
INFERRED = ("diffuse_albedo", "specular_albedo", "diffuse_normal", "specular_normal", "confidence")
"""Maps that `infer` writes. An atlas of a capture has others beside them."""
OWN = (LIGHT, *(f"{name}.exr" for name in INFERRED))
ON_CPU = "Infer with --device cpu."
NO_BACKGROUND = "none"
BACKGROUNDS = {"white": 1.0, "black": 0.0, NO_BACKGROUND: 0.0}


@dataclasses.dataclass(frozen=True)
class RenderRequest:
    """The options of `render` and `bake`.

    Attributes:
        maps: folder of atlas maps.
        mesh: registered_mesh.obj beside the maps where None.
        environment: light set, or .exr picture of light.
        out: file to write.
        rig: rig.json; the default rig where None.
        camera: of the rig.
        template: whose shininess and translucency maps to use.
        mode: of shading.
        lights: number of lights that replace a picture of light.
        rotate_deg: turns the light about +y.
        shadows: of `learning.relight.SHADOWS`.
    """

    maps: Path
    mesh: Path | None
    environment: Path
    out: Path
    rig: Path | None
    camera: str
    template: Path | None
    mode: str
    lights: int
    rotate_deg: float
    shadows: str


def render_command(
    request: RenderRequest,
    background: str,
    captured_only: bool,
    turntable: int,
    progress: ProgressCallback,
) -> dict[str, Any]:
    """Render a head to a picture, or to several from around it; returns the facts."""
    began = time.monotonic()
    out = request.out
    if background not in BACKGROUNDS:
        raise ConfigError("--background", found=repr(background), expected=" or ".join(BACKGROUNDS))
    if out.suffix.lower() not in (".png", ".exr"):
        raise MapsError(out, found=f"suffix {out.suffix!r}", expected=".png or .exr")
    if background == NO_BACKGROUND and out.suffix.lower() != ".png":
        raise ConfigError("--background", found=f"none, for {out.name}", expected="a .png for none")
    if not 1 <= turntable <= 999:
        raise ConfigError("--turntable", found=str(turntable), expected="1 to 999 pictures")
    options = make_config(ShadeOptions, {"mode": request.mode}, "shading")
    view = _camera(request.rig, request.camera)
    head, lights, seen = _lit_head(request, progress)
    centre = head.mesh.vertices.mean(axis=0)
    for index in range(turntable):
        camera = turned_camera(view, 360.0 * index / turntable, centre) if index else view
        rgb, alpha = render_head(
            head, lights, camera, BACKGROUNDS[background], captured_only, options, seen
        )
        name = out if turntable == 1 else out.with_stem(f"{out.stem}_{index:03d}")
        write_picture(name, rgb, alpha if background == NO_BACKGROUND else None)
        progress(index + 1, turntable)
    return {
        "width_px": view.width_px,
        "height_px": view.height_px,
        "pictures": turntable,
        "lights": len(lights.rgb),
        "surface_percent": 100 * float(alpha.mean()),
        "notes": [*head.notes, *notes_of_light(lights, options.mode)],
        "seconds": time.monotonic() - began,
    }


def bake_command(request: RenderRequest, progress: ProgressCallback) -> dict[str, Any]:
    """Bake light into a texture; returns the facts."""
    began = time.monotonic()
    options = make_config(ShadeOptions, {"mode": request.mode}, "shading")
    view = _camera(request.rig, request.camera)
    head, lights, seen = _lit_head(request, progress)
    texture = lit_texture(head, lights, view.centre_mm, options, seen)
    write_exr(request.out, texture)
    rows, columns = texture.shape[:2]
    return {
        "rows": rows,
        "columns": columns,
        "lights": len(lights.rgb),
        "notes": [*head.notes, *notes_of_light(lights, options.mode)],
        "seconds": time.monotonic() - began,
    }


def _lit_head(
    request: RenderRequest, progress: ProgressCallback
) -> tuple[TexturedHead, LightSet, Tensor | None]:
    """The head, the light and its shadows."""
    if not 1 <= request.lights <= 4096:
        raise ConfigError("--lights", found=str(request.lights), expected="1 to 4096")
    # An atlas is in a processed folder, beside the mesh that it belongs to.
    require_texture_maps(request.maps)
    folder = ProcessedFolder(request.maps.parent)
    mesh = folder.registered_mesh if request.mesh is None else request.mesh
    lights = read_light(request.environment, request.lights, request.rotate_deg, request.mode)
    head = _head(request.maps, mesh, request.template)
    # The pose is the mesh's: maps of `infer` have none beside them.
    beside = [ProcessedFolder(mesh.parent).head_pose, folder.head_pose]
    pose = next((read_head_pose(path) for path in beside if path.exists()), None)
    return head, lights, shadows_of(head, lights, request.shadows, pose, progress)


def _camera(rig: Path | None, camera: str) -> Camera:
    chosen = default_rig().scaled(DEFAULT_RIG_SCALE) if rig is None else load_rig(rig)
    return chosen.camera(camera)


def _head(maps: Path, mesh: Path, template: Path | None) -> TexturedHead:
    if not mesh.exists():
        raise MapsError(
            mesh,
            found="no such file",
            expected="the mesh of the maps",
            hint="Name it by --mesh; the atlas of a capture has its registered_mesh.obj one folder "
            "up.",
        )
    shape = read_mesh(mesh)
    _require_uv(shape, mesh)
    return load_head(maps, shape, load_template(template) if template else None, mesh)


def _require_uv(shape: Mesh, where: Path) -> None:
    if shape.uvs is None:
        raise MapsError(where, field="uv", found="none", expected="the maps' texture coordinates")


def train_command(
    data: Path,
    out: Path,
    preset_name: str,
    config: Path | None,
    seconds: float | None,
    seed: int | None,
    resume: bool,
    progress: ProgressCallback,
    device_name: str = "auto",
    processes: Processes = ALONE,
    consents: Path | None = None,
    environment: Path | None = None,
    begin_with: str | None = None,
) -> dict[str, Any]:
    """Train, as one of the processes; returns the facts."""
    device = choose_device(device_name, processes.local_rank)
    overrides = read_toml(config) if config else {}
    require_one_length(overrides, config or "--config")
    if environment is not None:
        target = dataclasses.asdict(read_target_light(environment))
        lights = overrides.get("lights", {})
        if isinstance(lights, dict):  # else `preset` refuses it
            overrides["lights"] = {**lights, "target": target}
    if seconds is not None:
        overrides["seconds"] = seconds
    if seed is not None:
        overrides["seed"] = seed
    resolved = preset(preset_name, overrides, str(config) if config else f"preset {preset_name}")
    store = open_store(data)
    require_consents(consents, "training", store.consents)
    begun = _run_to_begin_with(begin_with, resolved.family, resume)
    with joined(processes, device), memory_of(device, out, _smaller_batch(resolved.batch)):
        result = train(
            store,
            out,
            resolved,
            resume,
            progress,
            device,
            processes,
            begin_with=begun,
        )
    return {
        "steps": result.steps,
        "steps_of_earlier_calls": result.first,
        "examples": result.examples,
        "held_out": ", ".join(result.held_out),
        **dataclasses.asdict(result.score),
        "scored": result.score.scored,
        "said": result.score.sentence(),
        "device": str(device),
        "processes": processes.count,
        **{f"share_{name}": share for name, share in result.shares.items()},
        "seconds": result.seconds,
        "step_seconds": result.step_seconds,
        "warnings": list(
            filter(None, [other_rows(begun, resolved, store), not_better(result.score)])
        ),
    }


def _run_to_begin_with(given: str | None, family: str, resume: bool) -> Path | None:
    """The option --begin-with: the run's folder, of the shipped weights too."""
    if given is None:
        return None
    if resume:
        raise ConfigError(
            "--begin-with",
            found=f"{given}, with --resume",
            expected="one of the two",
            hint="A run that is resumed continues with its own weights.",
        )
    if given != SHIPPED:
        return Path(given)
    shipped = {
        "whole_face": shipped_weights,
        "super_resolution": shipped_super_resolution,
        "mesostructure": shipped_mesostructure,
    }
    if family not in shipped:
        raise ConfigError(
            "--begin-with",
            found=f"{SHIPPED}, for a network of the family {family!r}",
            expected="a run's folder",
            hint="Weights are shipped for --preset modern, rcan-small and mesostructure alone.",
        )
    return shipped[family]()


def trained_line(facts: Mapping[str, Any]) -> str:
    """What `train_command` came to, in one line."""
    steps, earlier = facts["steps"], facts["steps_of_earlier_calls"]
    now = f" ({steps - earlier} of them in this call)" if earlier else ""
    line = (
        f"{counted(steps, 'step')}{now}; {facts['step_seconds']:.0f} s of steps in "
        f"{facts['seconds']:.0f} s with reading and scoring; {facts['scored']} of the people held "
        f"out ({facts['held_out']}): {facts['said']}"
    )
    if steps == earlier:
        return line
    share = {name: f"{100 * facts[f'share_{name}']:.0f} %" for name in PARTS}
    return (
        f"{line}; of the steps' time on {facts['device']} the network took {share[NETWORK]}, "
        f"waiting for batches {share[IDLE]}; making batches, much of it at the same time, took "
        f"{share[DATA]} and rendering {share[RENDERING]}"
    )


def _smaller_batch(batch: int) -> str:
    """What to try where a GPU's memory does not hold a training."""
    if batch == 1:
        return "Set a smaller patch_px or width by --config, or train with --device cpu."
    return f"Set batch = {batch // 2} by --config; --resume requires the batch that the run has."


def infer_command(
    texture: Path,
    mesh: Path,
    checkpoint: Path | None,
    out: Path,
    head_pose: Path | None,
    refine: float | None,
    progress: ProgressCallback,
    device_name: str = "auto",
    mesostructure: str | None = None,
) -> dict[str, Any]:
    """Infer the maps of a texture, with the shipped weights where none are named; the facts."""
    began = time.monotonic()
    if refine is not None and not 0 <= refine <= 3600:
        raise ConfigError("--refine", found=str(refine), expected="0 to 3600 seconds")
    _require_own(out)
    device = choose_device(device_name)
    about = read_checkpoint(checkpoint or shipped_weights())
    if texture.suffix.lower() != ".exr" and texture.exists():
        raise MapsError(
            texture,
            found=f"suffix {texture.suffix!r}",
            expected=".exr, linear light",
            hint="Decode an sRGB picture to linear light and write that as OpenEXR.",
        )
    image = read_exr(texture, finite=True)
    if image.ndim != 3:
        raise MapsError(texture, found="one channel", expected="R G B")
    pose = read_head_pose(head_pose) if head_pose else None
    shape, named = read_mesh(mesh), (texture, mesh)
    _require_uv(shape, mesh)
    notes: list[str] = []
    if about.family == "whole_face":
        network, _ = load_whole_face(about.folder)
        seconds = REFINE_SECONDS if refine is None else refine
        with memory_of(device, texture, ON_CPU):
            found = infer_whole_face(
                network,
                image,
                shape,
                pose,
                named,
                refine_seconds=seconds,
                device=device,
                mesostructure=_mesostructure(mesostructure, seconds, device),
            )
    else:
        for option, value in (("--refine", refine), ("--mesostructure", mesostructure)):
            if value and value != NONE:
                raise ConfigError(
                    option,
                    found=f"{value}, with a network of patches",
                    expected="none, or a whole-face network",
                    hint="Leave --checkpoint out for the weights that are shipped.",
                )
        four = about.family == FourTrainConfig.family
        networks, _ = load_four_networks(about.folder) if four else load_generator(about.folder)
        image, notes = resampled_texture(image, about.texture_rows, texture)
        # Before the frame of specular normals could be chosen it was the head's.
        fields = {"specular_frame": "head", **about.config.get("data", {})}
        data = make_config(DataConfig, fields, about.folder)
        placed = np.eye(3, 4) if pose is None else pose
        given = (data, image, shape, placed, progress, named)
        with memory_of(device, texture, ON_CPU):
            if isinstance(networks, FourNetworks):
                found = infer_four(networks.to(device), *given)
            else:
                found = infer(networks.to(device), *given)
    with atomic_folder(out, f"{INFERRED[0]}.exr", own=OWN) as folder:
        for name, values in found.maps.items():
            write_map(folder / f"{name}.exr", name, values)
        if found.light is not None:
            write_lights(found.light, folder / LIGHT)
    rows, columns = image.shape[:2]
    return {
        "rows": rows,
        "columns": columns,
        "tiles": found.tiles,
        "step": about.step,
        "device": str(device),
        "lamps": None if found.light is None else len(found.light.rgb),
        "notes": [*notes, *found.notes],
        "seconds": time.monotonic() - began,
    }


def _mesostructure(
    asked: str | None, refine_seconds: float, device: torch.device
) -> TrainedMesostructure | None:
    """The network that finds pores and folds in a refined texture; None where it is switched off.

    Args:
        asked: a run's folder, or `NONE`; the shipped weights where None.
        refine_seconds: of the refinement, without which no light is known.
        device: where it runs.
    """
    if asked not in (None, NONE) and not refine_seconds:
        raise ConfigError(
            "--mesostructure",
            found=f"{asked}, with --refine 0",
            expected="a refined texture: pores and folds are found by its light",
            hint="Give --refine more seconds, or leave --mesostructure out.",
        )
    if asked == NONE or not refine_seconds:
        return None
    network, about = load_mesostructure(Path(asked) if asked else shipped_mesostructure())
    return TrainedMesostructure(network, about.texture_rows, device)


def _require_own(out: Path) -> None:
    """Refuse a folder that holds anything but what `infer` writes, such as a capture's atlas."""
    others = others_in(out, OWN)
    if others:
        raise MapsError(
            out,
            field="--out",
            found=f"a folder that holds {others[0]}",
            expected="a new folder, or one with inferred maps, which are replaced",
            hint="Choose another --out.",
        )
    require_replaceable(out, f"{INFERRED[0]}.exr", own=OWN)


def upscale_command(
    picture: Path,
    checkpoint: Path | None,
    out: Path,
    times: int | None,
    progress: ProgressCallback,
    device_name: str = "auto",
) -> dict[str, Any]:
    """Enlarge a picture, with the shipped weights where none are named; returns the facts."""
    began = time.monotonic()
    device = choose_device(device_name)
    network, about = load_super_resolution(checkpoint or shipped_super_resolution())
    own = network.config.times
    if times not in (None, own):
        raise ConfigError(
            "--times",
            found=str(times),
            expected=f"{own}, as {about.folder} was trained for",
            hint="Another --checkpoint may have been trained for another; network.times of a "
            "training may be 2, 4 or 8.",
        )
    image = read_exr(picture, finite=True)
    with memory_of(device, picture, ON_CPU):
        large = upscale(network.to(device), image, picture, progress)
    write_exr(out, large)
    rows, columns = large.shape[:2]
    return {
        "rows": rows,
        "columns": columns,
        "times": own,
        "step": about.step,
        "trained_rows": about.texture_rows,
        "device": str(device),
        "seconds": time.monotonic() - began,
    }
