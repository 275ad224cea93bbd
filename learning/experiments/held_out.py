"""People held out: their textures in ten lights, and how far found maps are from theirs.

Textures and pictures are shaded by `dielectric` facets with exact Fresnel, which is the formula of
neither the trainings (`physical` or `paper`) nor of the refinement (`ggx`): no setting is measured
by the formula that it learned from.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from learning.encoding import SPECULAR_MOST
from learning.experiments.lights import TARGET, lights_around
from learning.experiments.people import subject_of
from learning.infer import Inferred
from learning.maps import SHININESS, TRANSLUCENCY, from_batch, skin_maps_from, to_batch
from learning.render.environments import Environment
from learning.render.kept_shadows import shadows_of_scan
from learning.render.occlusion import DOME_MM, PositionGrid, bake_grid, openness, sharpened
from learning.render.shading import ShadeOptions, SkinMaps, shade, unit
from learning.render.uv import grid_quads, texel_surface
from learning.whole.face import read_small
from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.mesh import Mesh
from processing.colour import srgb_from_linear
from processing.dataset import Store

OPTIONS = ShadeOptions("dielectric")
MAPS = ("diffuse_albedo", "specular_albedo", "diffuse_normal", "specular_normal")
SOURCE, IN_TARGET = "source", "target"
REFLECTANCE = "reflectance"
FIGURES = (REFLECTANCE, *MAPS, SOURCE, IN_TARGET)
"""Mean squared errors of the whole reflectance, of each map, and of pictures in two lights."""

Infer = Callable[[np.ndarray, Mesh], Inferred]


@dataclasses.dataclass(frozen=True)
class Subject:
    """A person held out.

    Attributes:
        name: pseudonym.
        mesh: of the texels, in the head frame.
        skin: the true maps, a batch of one.
        measured: (rows, columns) bool, captured skin.
        grid: a coarser surface, that casts shadows.
        maps: the true maps by name, (rows, columns[, 3]).
    """

    name: str
    mesh: Mesh
    skin: SkinMaps
    measured: np.ndarray
    grid: PositionGrid
    maps: dict[str, np.ndarray]


@dataclasses.dataclass(frozen=True)
class Measured:
    """What was found of one person in one light.

    Attributes:
        light: of `lights.NAMES`.
        texture: (rows, columns, 3) linear, what was given.
        found: maps by name.
        figures: by the names of `FIGURES`.
        seconds: of the inference.
    """

    light: str
    texture: np.ndarray
    found: dict[str, np.ndarray]
    figures: dict[str, float]
    seconds: float


def read_subjects(
    store: Store, names: set[str], shadow_rows: int, shadows: Path | None = None
) -> list[Subject]:
    """One scan of each person of a store of `people.store_of`, the first one.

    Args:
        store: the data.
        names: of the people.
        shadow_rows: rows of the grid on which shadows are baked, at most.
        shadows: folder of kept shadows; None where they are baked each time.
    """
    found: dict[str, Subject] = {}
    for scan in store.scans:
        if scan.subject in names and scan.subject not in found:
            found[scan.subject] = _subject(store, scan.index, shadow_rows, shadows)
    return [found[name] for name in sorted(found)]


def measure(
    subject: Subject,
    target: Environment,
    lights: tuple[str, ...],
    infer: Infer,
    progress: ProgressCallback = quiet,
) -> list[Measured]:
    """Infer one person's maps in some lights, and hold them against the truth.

    Args:
        subject: the person.
        target: around which the training's lights are.
        lights: of `lights.NAMES`.
        infer: a texture and its mesh to maps.
        progress: of the lights.
    """
    chosen, visibility = shadowed(subject, target, lights)
    truth = {name: _lit(subject.skin, chosen[name], visibility[name]) for name in chosen}
    measured = subject.measured
    out = []
    for done, name in enumerate(lights):
        texture = from_batch(truth[name]) * measured[..., None]
        began = time.perf_counter()
        found = infer(texture, subject.mesh).maps
        seconds = time.perf_counter() - began
        skin = _with(subject.skin, found)
        figures = map_errors(found, subject.maps, measured)
        for figure, light in ((SOURCE, name), (IN_TARGET, TARGET)):
            picture = _lit(skin, chosen[light], visibility[light])
            figures[figure] = picture_error(picture, truth[light], measured)
        out.append(Measured(name, texture, found, figures, seconds))
        progress(done + 1, len(lights))
    return out


def shadowed(
    subject: Subject, target: Environment, lights: tuple[str, ...]
) -> tuple[dict[str, Environment], dict[str, Tensor]]:
    """Some lights and the target, and (1, L, rows, columns) shares of them that a texel sees.

    Args:
        subject: a person.
        target: around which the lights are.
        lights: of `lights.NAMES`.
    """
    around = lights_around(target)
    chosen = {name: around[name] for name in dict.fromkeys((*lights, TARGET))}
    # All ten at once, so that what is kept of them serves every choice.
    visibility = _visibility(subject, around)
    return chosen, {name: visibility[name] for name in chosen}


def map_errors(
    found: dict[str, np.ndarray], true: dict[str, np.ndarray], measured: np.ndarray
) -> dict[str, float]:
    """Mean squared errors of maps on a scale of 0 to 1, and their mean.

    Diffuse albedo is sRGB-encoded, specular albedo over `SPECULAR_MOST`, and a normal is
    (n + 1) / 2, as a picture of it has it.

    Args:
        found: (rows, columns[, 3]) maps by the names of `MAPS`.
        true: the same maps of the truth, of the same shapes.
        measured: (rows, columns) bool, captured skin.
    """
    squares = {name: (_scaled(name, found[name]) - _scaled(name, true[name])) ** 2 for name in MAPS}
    each = {name: float(square[measured].mean()) for name, square in squares.items()}
    return {REFLECTANCE: float(np.mean(list(each.values()))), **each}


def picture_error(found: Tensor, true: Tensor, measured: np.ndarray) -> float:
    """Mean squared error of (1, 3, rows, columns) pictures, sRGB-encoded, over skin."""
    one, other = (srgb_from_linear(np.clip(from_batch(x), 0, 1)) for x in (found, true))
    return float(((one - other)[measured] ** 2).mean())


def _scaled(name: str, values: np.ndarray) -> np.ndarray:
    values = np.asarray(values, float)
    if name == "diffuse_albedo":
        return np.asarray(srgb_from_linear(np.clip(values, 0, 1)))
    if name == "specular_albedo":
        return values / SPECULAR_MOST
    return (values + 1) / 2


def _subject(store: Store, scan: int, shadow_rows: int, shadows: Path | None) -> Subject:
    info, everything = store.scans[scan], slice(None)
    names = (*MAPS, "position", "confidence")
    maps = {name: store.read(scan, name, everything, everything) for name in names}
    covered = (maps["position"] != 0).any(axis=2)
    measured = covered & (maps["confidence"][..., 0] > 0)
    measured &= (maps["diffuse_albedo"] > 0).all(axis=2)
    maps["specular_albedo"] = maps["specular_albedo"][..., 0]
    rows = min(shadow_rows, info.rows)
    columns = max(2, round(rows * info.columns / info.rows))
    small, _ = read_small(store, scan, rows, columns)
    surface = texel_surface(small["position"], (small["position"] != 0).any(axis=2), smooth_px=1.0)
    there = (small["position"] != 0).any(axis=2)
    kept = shadows_of_scan(shadows, info.sha256, "all lights")
    grid = PositionGrid(small["position"], surface.normal, there, kept)
    ones = np.ones(covered.shape, np.float32)
    baked = bake_grid(grid, DOME_MM)
    maps["ambient_occlusion"] = _enlarged(openness(surface.normal, baked), covered.shape)
    skin = skin_maps_from(maps, covered, SHININESS * ones, TRANSLUCENCY * ones)
    mesh = texel_mesh(maps["position"], covered)
    true = {name: maps[name] for name in MAPS}
    return Subject(subject_of(info.subject), mesh, skin, measured, grid, true)


def texel_mesh(position_mm: np.ndarray, covered: np.ndarray) -> Mesh:
    """The surface of a position map: a vertex at each texel's centre, quads between neighbours.

    Args:
        position_mm: (rows, columns, 3).
        covered: (rows, columns) bool.
    """
    rows, columns = covered.shape
    vertex = np.cumsum(covered.ravel(), dtype=np.int32) - 1
    position_mm = position_mm.astype(float)
    faces = vertex[grid_quads(position_mm, covered)[:, [1, 2, 3, 0]]]
    points = position_mm[covered]
    row, column = np.nonzero(covered)
    uvs = np.stack([(column + 0.5) / columns, 1 - (row + 0.5) / rows], axis=1)
    return Mesh(points, faces, uvs, faces)


def _visibility(subject: Subject, lights: dict[str, Environment]) -> dict[str, Tensor]:
    """(1, L, rows, columns) share of each light that a texel sees, of all lights by one baking."""
    places = [light.position_mm[0].double().numpy() for light in lights.values()]
    baked = bake_grid(subject.grid, np.concatenate(places))
    parts = np.split(baked, np.cumsum([len(at) for at in places])[:-1])
    size = subject.measured.shape
    return {
        name: sharpened(torch.from_numpy(np.stack([_enlarged(one, size) for one in part])))[None]
        for name, part in zip(lights, parts, strict=True)
    }


def _enlarged(image: np.ndarray, size: tuple[int, ...]) -> np.ndarray:
    large = torch.nn.functional.interpolate(
        to_batch(image), (size[0], size[1]), mode="bilinear", align_corners=False
    )
    return from_batch(large)


def _lit(skin: SkinMaps, light: Environment, visibility: Tensor) -> Tensor:
    with torch.inference_mode():
        return shade(skin, light, OPTIONS, visibility).clamp_min(0)


def _with(skin: SkinMaps, found: dict[str, np.ndarray]) -> SkinMaps:
    """The true surface with found maps."""
    tensors: dict[str, Any] = {name: to_batch(found[name]) for name in MAPS}
    # Where nothing was found the surface's own normal stays: a picture needs one.
    for name in ("diffuse_normal", "specular_normal"):
        known = tensors[name].norm(dim=1, keepdim=True) > 1e-3
        tensors[name] = torch.where(known, unit(tensors[name]), getattr(skin, name))
    return dataclasses.replace(skin, **tensors)
