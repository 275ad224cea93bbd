"""One photograph, or several of one person, to a head: shape, camera, light and texture.

Landmarks give the camera and the shape, which pixels and outlines change where the configuration
has rounds for them. The photographs are then brought into the template's texture, and to the light
of the first (`learning.photo.several`); the whole-face network and refinement (`learning.whole`)
find this light and the skin under it, which also fills what no photograph shows: the skin there,
under the same light.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import torch

from learning.errors import MapsError
from learning.infer import Inferred
from learning.maps import SHININESS, TRANSLUCENCY, TexturedHead, skin_maps_from
from learning.mesostructure.infer import TrainedMesostructure
from learning.networks.whole_face import WholeFaceNetwork
from learning.photo.config import FitConfig
from learning.photo.large_texture import Enlarging, Shown, brighter, finest, rows_of_search
from learning.photo.look import Looked, Texels, look
from learning.photo.own_skin import PersonTexels, PhotographedSkin
from learning.photo.several import Joined, View, join
from learning.photo.shape_fit import Photograph, Places, Shape, fit_shape
from learning.photo.tone import Tone, skin_colours
from learning.relight import lit_texture, shadows_of
from learning.render.uv import UvRaster, rasterise
from learning.upscale.network import Rcan
from learning.whole.detail import enlarged as resized
from learning.whole.gaps import continued
from learning.whole.texture_layout import FARTHEST_MM, apart_mm
from lightstage.commands import ProgressCallback, quiet
from lightstage.formats.environment import LightSet
from lightstage.formats.mesh import Mesh
from lightstage.formats.template import Template
from lightstage.rig import Camera

DOUBT = 4.0
"""Landmarks are so much less certain where they gave a head that people do not have, as those of a
face of 50 pixels do."""
DARK = 0.01
"""Added to both before a photograph is compared with its model."""


@dataclasses.dataclass(frozen=True)
class FittedHead:
    """A head as its photographs show it, in the light of the first.

    Attributes:
        shape: the person.
        texture: (rows, columns, 3) float32 linear, with the first photograph's light in it, whole.
        seen: (rows, columns) bool, taken from the photographs; the rest is filled.
        source: (rows, columns) int16, the photograph that shows it most, from 0; -1 where filled.
        confidence: (rows, columns) float32, 0..1, of the texture: the cosine to the camera where it
            was seen, 0 where it was filled.
        inferred: the maps of the skin, in the head frame.
        light: of the photograph, head frame; None where none explained it.
        misfit: root mean square of the difference between the photograph and the model under its
            light, over the seen texels, sRGB-like (natural logarithms); NaN without a light.
        masked: share of the face's texels in the first photograph that were found to be no skin.
        tone: of the skin; None where no light was found.
        notes: what a user should know, a line each.
    """

    shape: Shape
    texture: np.ndarray
    seen: np.ndarray
    source: np.ndarray
    confidence: np.ndarray
    inferred: Inferred
    light: LightSet | None
    misfit: float
    masked: float
    tone: Tone | None
    notes: tuple[str, ...]


def fit_head(
    photographs: list[Photograph],
    template: Template,
    places: Places,
    network: WholeFaceNetwork,
    config: FitConfig,
    mesostructure: TrainedMesostructure | None = None,
    progress: ProgressCallback = quiet,
    super_resolution: Rcan | None = None,
) -> FittedHead:
    """Fit a head to photographs of one person; shape and texture from all, light of the first.

    Args:
        photographs: the first one's light is the texture's.
        template: whose topology and UV the head has.
        places: of the landmarks on it.
        network: in evaluation mode.
        config: of the fit.
        mesostructure: finds pores and folds.
        progress: called with steps done and their number.
        super_resolution: enlarges a photograph of fewer pixels than texels.

    Raises:
        MapsError: see `fit_shape`; a first photograph that shows too little of the face.
    """
    steps = len(photographs) + 3
    notes: list[str] = []
    shape = _likely_shape(photographs, template, places, network, config, notes)
    progress(1, steps)
    several = len(photographs) > 1
    looked: list[Looked] = []
    for index, photograph in enumerate(photographs):
        try:
            found = look(photograph, shape, index, template, network, config.rounds, several)
        except MapsError as error:
            if index == 0:
                raise
            notes.append(f"{photograph.name} gives the shape alone, no texture: {error}")
        else:
            looked.append(found)
            notes += found.notes
        progress(2 + index, steps)
    rows = rows_of_search(config.rows, config.search_rows)
    texels = [Texels(each, rows, template, shape.model.face, super_resolution) for each in looked]
    together = _together(looked, texels)
    first, camera = texels[0], shape.cameras[0]
    seen = together.seen
    # The light is the first photograph's. All that this one shows goes to the network, which knows
    # the outline of what one photograph shows: without the texels that others show better, the
    # tone was off.
    network_sees = together.first & first.skin & ~first.own_hair
    own_eyes = _own_eyes(texels, together.source)
    skin = PhotographedSkin(
        PersonTexels(first.features, first.beard, own_eyes, first.hair, ~first.skin),
        skin_colours(network),
        looked[0].photograph.whites,
    )
    inferred = first.inferred(
        network,
        together.texture,
        together.seen,
        config.refine_seconds,
        camera,
        mesostructure,
        network_sees,
        own=skin,
    )
    progress(steps - 1, steps)
    notes += inferred.notes
    model = None
    if inferred.light is not None:
        model = _lit(first.raster, first.mesh, inferred.maps, inferred.light, camera)
    texture = joined(together.texture, seen, first.raster.covered, model)
    misfit = float("nan") if model is None else _misfit(together.texture, model, seen)
    if model is None:
        notes.append(
            f"{first.name}: no light was found that explains it; what it does not show was "
            "continued from what it shows"
        )
    notes += [
        f"{each.name} has fewer pixels than the texture has texels: super-resolution enlarged it"
        for each in texels
        if each.enlarged
    ]
    confidence = np.where(seen, np.clip(together.facing, 0, 1), 0).astype(np.float32)
    # As the caller numbers them: photographs that show too little are left out.
    numbers = np.array([*(each.index for each in looked), -1], np.int16)
    fitted = FittedHead(
        shape,
        texture,
        seen,
        numbers[np.where(seen, together.source, -1)],
        confidence,
        inferred,
        inferred.light,
        misfit,
        looked[0].masked,
        skin.tone,
        tuple(notes),
    )
    if config.rows != rows:
        # Eyes were filled from where the photograph has them, not from where the mesh has them.
        known = seen if own_eyes is None else seen & ~own_eyes
        shown = [
            Shown(
                own.shown.rgb_linear,
                own.shown.camera,
                each.mesh,
                known & (together.source == index),
                1 / own.shown_pixels,
            )
            for index, (each, own) in enumerate(zip(looked, texels, strict=True))
        ]
        fitted = _with_all_rows(fitted, shown, first, config.rows)
    progress(steps, steps)
    return fitted


def _likely_shape(
    photographs: list[Photograph],
    template: Template,
    places: Places,
    network: WholeFaceNetwork,
    config: FitConfig,
    notes: list[str],
) -> Shape:
    """The person's shape, by what gives one that people have: pixels, else landmarks."""
    shape = fit_shape(photographs, template, places, config, network=network)
    alone = dataclasses.replace(config, pixel_rounds=0)
    doubted = dataclasses.replace(alone, landmark_percent=DOUBT * config.landmark_percent)
    note = []
    for instead, what in (
        (alone, "the landmarks alone gave its shape"),
        (doubted, "the mean head's shape, changed little, was taken"),
    ):
        apart = _from_people_mm(shape.meshes[0], network)
        if apart <= FARTHEST_MM:
            break
        note = [f"the photograph gave a head {apart:.0f} mm from people's in the mean: {what}"]
        shape = fit_shape(photographs, template, places, instead, shape.model)
    notes += note
    return shape


def _from_people_mm(mesh: Mesh, network: WholeFaceNetwork) -> float:
    """Mean distance of a head's texels from the mean person's."""
    raster = rasterise(mesh, *network.mean_position_mm.shape[2:])
    place = torch.from_numpy(raster.interpolate(mesh.vertices)).float()
    return apart_mm(place.permute(2, 0, 1)[None], network.mean_position_mm)


def _with_all_rows(fitted: FittedHead, shown: list[Shown], first: Texels, rows: int) -> FittedHead:
    """A head of which light and skin were sought in fewer rows than its texture has."""
    raster = rasterise(first.mesh, rows, rows * 2 // 3)
    to_all = Enlarging(first.raster.covered, raster)
    low, own = (each.normals(first.mesh) for each in (first.raster, raster))
    maps = {
        name: to_all.normals(image, low, own) if name.endswith("_normal") else to_all.map(image)
        for name, image in fitted.inferred.maps.items()
    }
    del low, own
    detail = finest(shown, raster)
    texture = brighter(to_all.map(fitted.texture), detail)
    if fitted.inferred.detail_share is not None:
        detail *= to_all.map(fitted.inferred.detail_share)[..., None]
        np.minimum(brighter(maps["diffuse_albedo"], detail), 1, out=maps["diffuse_albedo"])
    del detail
    seen = (to_all.labels(fitted.seen) > 0) & raster.covered
    return dataclasses.replace(
        fitted,
        texture=texture,
        seen=seen,
        source=np.where(seen, to_all.labels(fitted.source), -1).astype(np.int16),
        confidence=to_all.map(fitted.confidence) * seen,
        inferred=dataclasses.replace(fitted.inferred, maps=maps),
    )


def _own_eyes(texels: list[Texels], source: np.ndarray) -> np.ndarray | None:
    """(rows, columns) bool, texels that show open eyes in the photograph they are from."""
    parts = [(each.eyes, index) for index, each in enumerate(texels) if each.eyes is not None]
    if not parts:
        return None
    return np.logical_or.reduce([eyes & (source == index) for eyes, index in parts])


def _together(looked: list[Looked], texels: list[Texels]) -> Joined:
    """The texture of all photographs in the light of the first."""
    views = []
    for each, own in zip(looked, texels, strict=True):
        rows, columns = own.raster.covered.shape
        model = None
        if len(looked) > 1 and each.found is not None and each.found.light is not None:
            model = _coarse_model(looked[0], each, each.found.light)
        # Hair is no skin, by which light and tone are found, and yet the person's.
        shown = own.skin if own.hair is None else own.skin | own.hair
        views.append(
            View(
                own.unwrapped.texture,
                own.unwrapped.seen & shown,
                own.unwrapped.facing,
                own.pixels,
                None if model is None else resized(model, rows, columns),
            )
        )
    return join(views)


def _coarse_model(first: Looked, each: Looked, light: LightSet) -> np.ndarray | None:
    """(rows, columns, 3) the first photograph's skin in the light of each, at the coarse size."""
    if first.found is None:
        return None
    rows, columns = first.found.maps["diffuse_albedo"].shape[:2]
    raster = rasterise(each.mesh, rows, columns)
    maps = {name: first.found.maps[name] for name in ("diffuse_albedo", "specular_albedo")}
    normal = raster.normals(each.mesh)
    maps |= {"diffuse_normal": normal, "specular_normal": normal}
    return _lit(raster, each.mesh, maps, light, each.camera)


def joined(
    photographed: np.ndarray, seen: np.ndarray, covered: np.ndarray, model: np.ndarray | None
) -> np.ndarray:
    """A whole texture: the photograph where it is seen, its model elsewhere, without a step.

    Args:
        photographed: (rows, columns, 3) linear.
        seen: (rows, columns) bool.
        covered: (rows, columns) bool, where a surface is.
        model: (rows, columns, 3) of the skin under the photograph's light; None for none, where the
            photograph is continued.
    """
    base = np.ones_like(photographed) if model is None else np.maximum(model, 0) + DARK
    ratio = np.log((np.maximum(photographed, 0) + DARK) / base)
    own = np.where(seen[..., None], ratio, 0).astype(np.float32)
    filled = np.exp(continued(own, seen)) * base - DARK
    texture = np.where(seen[..., None], photographed, np.maximum(filled, 0))
    return (texture * covered[..., None]).astype(np.float32)


def _lit(
    raster: UvRaster, mesh: Mesh, maps: dict[str, np.ndarray], light: LightSet, camera: Camera
) -> np.ndarray:
    """(rows, columns, 3) a skin under a light, from where a camera stands."""
    covered = raster.covered
    maps = {**maps, "position": raster.interpolate(mesh.vertices)}
    ones = np.ones(covered.shape, np.float32)
    skin = skin_maps_from(maps, covered, SHININESS * ones, TRANSLUCENCY * ones)
    head = TexturedHead(mesh, raster, skin, covered)
    return lit_texture(head, light, camera.centre_mm, None, shadows_of(head, light))


def _misfit(photographed: np.ndarray, model: np.ndarray, seen: np.ndarray) -> float:
    """Root mean square of the logarithm of the ratio, over the seen texels."""
    if not seen.any():
        return float("nan")
    off = np.log((np.maximum(photographed[seen], 0) + DARK) / (np.maximum(model[seen], 0) + DARK))
    return float(np.sqrt((off**2).mean()))
