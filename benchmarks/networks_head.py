"""One head under its lights: what networks, refinement and plain guesses find, and how far off."""

from __future__ import annotations

import dataclasses
import functools
import zlib
from pathlib import Path
from typing import TypedDict

import numpy as np

from benchmarks.networks_flaws import FLAWS
from benchmarks.networks_guesses import (
    Neighbours,
    Texture,
    harmonic_division,
    without_network,
)
from benchmarks.networks_lights import CAMERA_MM, light_of, new_lights
from benchmarks.networks_people import Head, Who, make
from benchmarks.networks_scores import (
    CONFIDENCE_TEXELS,
    Albedo,
    Other,
    albedo_score,
    angle_deg,
    light_deg,
    specular_sums,
    squared,
)
from benchmarks.networks_sheet import strip
from learning.checkpoint import (
    load_mesostructure,
    load_whole_face,
    shipped_mesostructure,
    shipped_weights,
)
from learning.errors import MapsError
from learning.infer import Inferred
from learning.maps import SHININESS, TexturedHead, skin_maps_from
from learning.mesostructure.infer import TrainedMesostructure
from learning.networks.whole_face import BANDS, WholeFaceNetwork
from learning.relight import lit_texture, shadows_of
from learning.render.uv import UvRaster, rasterise
from learning.whole.detail import enlarged
from learning.whole.infer import infer_whole_face
from lightstage.formats.environment import LightSet
from processing.colour import srgb_from_linear

REFINED, NETWORK, FIT = "refined", "network", "the fit without a network"
OWN_LIGHT = "lit by learning's renderer"
FLAW_LIGHTS = ("front", "hard-oblique")
FIT_EVERY = 5
"""The fit without a network is as slow as refinement: it is tried under each fifth light."""
COARSER = 2
"""New lights are seen at each second texel of each second row."""


class Refining(TypedDict, total=False):
    """Arguments of `infer_whole_face` with which it refines."""

    refine_seconds: float
    mesostructure: TrainedMesostructure


@dataclasses.dataclass(frozen=True)
class Task:
    """What is measured on each head.

    Attributes:
        rows: of the textures, a multiple of 3.
        lights: names of `networks_lights.GROUPS`.
        refine_seconds: most that refinement may take.
        checkpoint: a run; the shipped weights where None.
        mesostructure: a run of the network of pores and folds; the shipped weights where None.
        neighbours: the fitted regression.
        pictures: whether strips for a sheet are made.
        flawed: heads whose textures are spoiled too, by name.
    """

    rows: int
    lights: tuple[str, ...]
    refine_seconds: float
    checkpoint: Path | None
    mesostructure: Path | None
    neighbours: Neighbours
    pictures: bool
    flawed: frozenset[str]


@dataclasses.dataclass(frozen=True)
class Lit:
    """What one texture gave.

    Attributes:
        kind: of head.
        name: of head.
        tone: 1 to 6, or None.
        light: of `GROUPS`.
        albedo: by what was guessed; empty where the texture was refused.
        other: of the refined answer; None where it was refused.
        strip: pictures for a sheet, or None.
        flaws: by flaw and by `REFINED` or `NETWORK`, but for those that were refused.
    """

    kind: str
    name: str
    tone: int | None
    light: str
    albedo: dict[str, Albedo]
    other: Other | None
    strip: np.ndarray | None
    flaws: dict[tuple[str, str], Albedo]


@functools.cache
def network_of(checkpoint: Path | None) -> WholeFaceNetwork:
    """The network that is measured."""
    return load_whole_face(checkpoint or shipped_weights())[0]


@functools.cache
def relief_of(checkpoint: Path | None) -> TrainedMesostructure:
    """The network of pores and folds that refinement uses, as `infer` does."""
    network, about = load_mesostructure(checkpoint or shipped_mesostructure())
    return TrainedMesostructure(network, about.texture_rows)


def measure(who: Who, task: Task) -> list[Lit]:
    """Make a head and measure it under each light."""
    head = make(who, task.rows)
    network = network_of(task.checkpoint)
    shape = Shape(head)
    turn = _number(who.name) % FIT_EVERY
    lit = []
    for index, name in enumerate(task.lights):
        light = light_of(name, _number(who.name))
        texture = head.image(head.lit.under(light))
        with_fit = index % FIT_EVERY == turn % min(FIT_EVERY, len(task.lights))
        try:
            found = guesses(network, head, shape, texture, task, with_fit)
        except MapsError as error:
            print(f"{who.kind} {who.name}, {name}: refused: {error}", flush=True)
            lit.append(Lit(who.kind, who.name, who.tone, name, {}, None, None, {}))
            continue
        true = head.maps["diffuse_albedo"]
        refined = found.inferred[REFINED]
        pictures = [texture, found.albedo[NETWORK], found.albedo[REFINED], true]
        label = f"{who.name}{'' if who.tone is None else f', tone {who.tone}'}: {name}"
        lit.append(
            Lit(
                who.kind,
                who.name,
                who.tone,
                name,
                {n: albedo_score(a, true, head.skin) for n, a in found.albedo.items()},
                other_score(head, shape, refined, light),
                strip(pictures, label) if task.pictures else None,
                flawed(network, head, shape, texture, light, task)
                if who.name in task.flawed and name in FLAW_LIGHTS
                else {},
            )
        )
    return lit


class Shape:
    """A head's mesh in its texels."""

    def __init__(self, head: Head) -> None:
        """Rasterise it at the size of the head's maps."""
        self.raster: UvRaster = rasterise(head.mesh, *head.shown.shape)
        self.normal = self.raster.normals(head.mesh).astype(np.float32)
        self.position_mm = self.raster.interpolate(head.mesh.vertices)
        rotation = head.head_from_world[:, :3]
        self.head_normal = self.normal @ rotation.T
        self.head_position_mm = self.position_mm @ rotation.T + head.head_from_world[:, 3]


@dataclasses.dataclass(frozen=True)
class Found:
    """Albedos by what guessed them, and the whole answers of the networks."""

    albedo: dict[str, np.ndarray]
    inferred: dict[str, Inferred]


def guesses(
    network: WholeFaceNetwork,
    head: Head,
    shape: Shape,
    texture: np.ndarray,
    task: Task,
    with_fit: bool,
) -> Found:
    """All guesses of a texture's albedo, (rows, columns, 3) linear each."""
    inputs = (texture, head.mesh, head.head_from_world)
    answers = {
        REFINED: infer_whole_face(network, *inputs, **refining(task)),
        NETWORK: infer_whole_face(network, *inputs),
    }
    albedo = {name: answer.maps["diffuse_albedo"] for name, answer in answers.items()}
    blurred = infer_whole_face(network, *inputs, shares=[0.0] * BANDS)
    albedo["network, without the texture's detail"] = blurred.maps["diffuse_albedo"]
    if with_fit:
        fit = infer_whole_face(without_network(network), *inputs, **refining(task))
        albedo[FIT] = fit.maps["diffuse_albedo"]
    mean_log = network.mean_log_albedo[0].permute(1, 2, 0).numpy()
    mean = enlarged(np.exp(mean_log), *head.shown.shape)
    lit = Texture(texture, shape.head_normal, shape.head_position_mm, head.shown)
    true = head.maps["diffuse_albedo"]
    tone = true[head.skin].mean(axis=0)
    albedo["regression on neighbours"] = task.neighbours.find(lit)
    albedo["harmonic division"] = harmonic_division(texture, mean, shape.head_normal, head.shown)
    albedo["texture as albedo"] = texture
    albedo["mean person"] = mean
    albedo["oracle: the person's true tone"] = np.broadcast_to(tone, true.shape)
    return Found(albedo, answers)


def refining(task: Task) -> Refining:
    """How the refined answer is asked for."""
    return {
        "refine_seconds": task.refine_seconds,
        "mesostructure": relief_of(task.mesostructure),
    }


def other_score(head: Head, shape: Shape, found: Inferred, light: LightSet) -> Other:
    """Score a network's other maps besides the diffuse albedo."""
    skin, true, maps = head.skin, head.maps, found.maps
    names = ("diffuse_normal", "specular_normal")
    errors = [angle_deg(maps[name][skin], true[name][skin]) for name in names]
    own = [angle_deg(shape.normal[skin], true[name][skin]) for name in names]
    off = srgb_from_linear(maps["diffuse_albedo"]) - srgb_from_linear(true["diffuse_albedo"])
    trust = np.stack([maps["confidence"][skin], np.abs(off).mean(axis=2)[skin]], axis=1)
    rng = np.random.default_rng(0)
    some = rng.choice(len(trust), min(CONFIDENCE_TEXELS, len(trust)), replace=False)
    return Other(
        specular_sums(maps["specular_albedo"][skin], true["specular_albedo"][skin]),
        (errors[0], errors[1], own[0], own[1]),
        relit_squares(head, maps),
        trust[some],
        light_deg(found.light, light),
    )


def relit_squares(head: Head, maps: dict[str, np.ndarray]) -> tuple[float, ...]:
    """Mean square errors of a head in new lights, by found maps and by true ones, over skin."""
    coarse = np.zeros_like(head.skin)
    coarse[::COARSER, ::COARSER] = head.skin[::COARSER, ::COARSER]
    lit = head.lit.kept(coarse[head.shown])
    mine = dataclasses.replace(
        lit.points,
        albedo=maps["diffuse_albedo"][coarse],
        specular=maps["specular_albedo"][coarse],
        normal=maps["diffuse_normal"][coarse],
    )
    shine = maps["specular_normal"][coarse]
    return tuple(
        squared(lit.relit(light, mine, shine), lit.relit(light, lit.points))
        for light in new_lights()
    )


def flawed(
    network: WholeFaceNetwork,
    head: Head,
    shape: Shape,
    texture: np.ndarray,
    light: LightSet,
    task: Task,
) -> dict[tuple[str, str], Albedo]:
    """Scores of the texture as people have it, and as learning's own renderer lights it."""
    spoiled = {n: make(texture, head.shown, shape.head_normal) for n, make in FLAWS.items()}
    spoiled[OWN_LIGHT] = own_light(head, shape, light)
    true, out = head.maps["diffuse_albedo"], {}
    for name, image in spoiled.items():
        image = image.astype(np.float32)
        ways: dict[str, Refining] = {REFINED: refining(task), NETWORK: {}}
        for guess, how in ways.items():
            try:
                answer = infer_whole_face(network, image, head.mesh, head.head_from_world, **how)
            except MapsError as error:
                print(f"{head.who.name}, {name}: refused: {error}", flush=True)
                continue
            out[name, guess] = albedo_score(answer.maps["diffuse_albedo"], true, head.skin)
    return out


def own_light(head: Head, shape: Shape, light: LightSet) -> np.ndarray:
    """The texture that `learning`'s renderer makes of the true maps."""
    ones = np.ones(head.shown.shape, np.float32)
    maps = {"position": shape.position_mm, **head.maps}
    skin = skin_maps_from(maps, head.shown, SHININESS * ones, 0.5 * ones)
    textured = TexturedHead(head.mesh, shape.raster, skin, head.skin)
    lit = lit_texture(textured, light, CAMERA_MM, seen=shadows_of(textured, light))
    found: np.ndarray = lit * head.shown[..., None]
    return found


def _number(name: str) -> int:
    """The same for the same head in any selection."""
    return zlib.crc32(name.encode())
