"""Refinement of a network's answer through the renderer: light and skin found in turns.

The network gives the person's tone; the shape shows where each light falls. In turns, the lamps are
found under which the skin gives the texture (`learning.whole.light`), and the skin among those that
people have (the modes kept beside the network's weights) that gives the texture under these lamps.
The texture over its own light then shows what the modes do not have.
"""

from __future__ import annotations

import dataclasses
import functools
import time
from collections.abc import Callable
from typing import Protocol

import cv2
import numpy as np

from learning.encoding import shrink
from learning.maps import SHININESS, from_batch, to_batch
from learning.mesostructure.evidence import Frame, frame_of, slope_of
from learning.mesostructure.infer import TrainedMesostructure, find
from learning.networks.whole_face import DARKEST, WholeFaceNetwork
from learning.render.uv import UvRaster, rasterise
from learning.whole.detail import blurred, enlarged
from learning.whole.gaps import without_gaps
from learning.whole.light import SEARCH, Light, LightFit, LightSearch, LitSurface
from learning.whole.sides import sides_mirror
from learning.whole.together import Explained, KnownSkin, explain
from learning.whole.unlit import (
    DARK_LIGHT,
    in_the_dark,
    light_edges,
    lit_enough,
    matt,
    median_light,
    misplaced,
    over_light,
    trusted,
)
from lightstage.formats.environment import LightSet
from lightstage.formats.mesh import Mesh

CAMERA_MM = np.array([0.0, 0.0, 1100.0])
"""From where a photograph's highlights are taken to be seen: in front of the face."""
ROUNDS = 8
SETTLED = 0.003
"""A round that changes no texel's albedo by more than this share is the last."""
LEAST_COVERED = 0.3
"""Share of surface in a texel at the network's size from which it counts."""
WIDEST_MARK = 1 / 6
"""Standard deviation of what is wider than a mark, of a texture's rows; it is taken for light."""
SHININESS_STEP = 1.25
"""Ratio of the exponents of highlights that are tried one after the other."""
SHININESS_SPREAD = 0.5
"""Standard deviation of the exponent's logarithm among people, about `SHININESS`."""
SHININESS_RANGE = (6.0, 120.0)
LARGEST_MISFIT = 1.7
"""Largest misfit of a light that explains a texture: our people's have 0.2 to 0.6, a scanned head's
0.8 to 1.5 (refinement is nearer to the truth than the network under each of six lights), a wrong
one's 2."""
LARGEST_ROWS = 1536
"""Light is followed at so many rows at most, and enlarged for larger textures."""


@dataclasses.dataclass(frozen=True)
class TakenOut:
    """A texture over the light that was found in it.

    Attributes:
        texture: (rows, columns, 3) linear, with its light.
        unlit: (rows, columns, 3) texture over its light, linear.
        known: (rows, columns) bool, where that shows the skin.
        lit: (rows, columns) bool, where it is lit enough to show whatever is there.
        trust: (rows, columns) of `learning.whole.unlit.trusted`.
        covered: (rows, columns) bool, where a surface is.
        irradiance: (rows, columns, 3) of diffuse light.
        low_albedo: (h, w, 3) diffuse albedo among the skins that people have.
        shares: (h, w, L) share of each light, the ambient last, in the irradiance; 0 without a
            surface.
        normal: (h, w, 3) unit, head frame.
        sides: see `learning.whole.gaps.without_gaps`.
    """

    texture: np.ndarray
    unlit: np.ndarray
    known: np.ndarray
    lit: np.ndarray
    trust: np.ndarray
    covered: np.ndarray
    irradiance: np.ndarray
    low_albedo: np.ndarray
    shares: np.ndarray
    normal: np.ndarray
    sides: bool


@dataclasses.dataclass(frozen=True)
class Own:
    """Part of a texture over its light that is the person's own.

    Attributes:
        known: (rows, columns) bool, where it is.
        skin: (rows, columns) bool, the part of it that is skin, in which pores and folds are found.
        albedo: from (rows, columns, 3) texture over its light, without pores' shading, to the
            albedo of all texels.
        detail_share: (rows, columns) float32, part of the finest detail that is the person's, 0..1.
        light_gain: (3,) the light's strength over the one that was found.
    """

    known: np.ndarray
    skin: np.ndarray
    albedo: Callable[[np.ndarray], np.ndarray]
    detail_share: np.ndarray
    light_gain: np.ndarray = dataclasses.field(default_factory=lambda: np.ones(3))


class OwnSkin(Protocol):
    """Decides which part of a texture over its light is the person's own.

    Attributes:
        normals_off: standard deviation of the shape's normals, radians along each axis. Where light
            grazes the skin, what is over the light is trusted the less, the more they are off.
        penumbra: standard deviation over which shadows are softened, of a texture's rows.
        search: for the light.
    """

    @property
    def normals_off(self) -> float:
        """See above."""

    @property
    def penumbra(self) -> float:
        """See above."""

    @property
    def search(self) -> LightSearch:
        """See above."""

    def own(self, taken: TakenOut) -> Own:
        """Decide it for one texture."""


@dataclasses.dataclass(frozen=True)
class OwnShares:
    """Parts of what a texture over its light shows that are taken for the skin's own, 0..1.

    Attributes:
        marks: of a difference from the skins that people have, at the network's size. By true
            shapes our people and ICT's are nearest to the truth at less, the scanned head at more.
        detail: of all that is finer.
        normals_off: see `OwnSkin`.
        penumbra: see `OwnSkin`.
        search: see `OwnSkin`.
    """

    marks: float = 0.4
    detail: float = 0.75
    normals_off: float = 0.05
    penumbra: float = 0.0
    search: LightSearch = SEARCH

    def own(self, taken: TakenOut) -> Own:
        """Take these shares."""
        share = (self.detail * taken.known * taken.trust).astype(np.float32)
        return Own(taken.known, taken.known, lambda unlit: with_shares(unlit, taken, self), share)


OF_TRUE_SHAPES = OwnShares()
"""The shares that are nearest to the truth there."""


@dataclasses.dataclass(frozen=True)
class Refined:
    """A texture without its light.

    Attributes:
        diffuse_albedo: (rows, columns, 3) linear.
        known: (rows, columns) bool, where the texture shows it; elsewhere it was continued from
            around and from the face's other side.
        detail_share: (rows, columns) float32, part of the texture's finest detail that was taken
            for the skin's own, 0..1.
        light: lamps and light from everywhere, in the head frame.
        normals: (rows, columns, 3) unit of the diffuse and of the specular light, head frame; None
            where nothing finer than the shape's was sought.
        settled: whether the search ended by itself, not by the clock.
    """

    diffuse_albedo: np.ndarray
    known: np.ndarray
    detail_share: np.ndarray
    light: LightSet
    normals: tuple[np.ndarray, np.ndarray] | None = None
    settled: bool = True


@dataclasses.dataclass(frozen=True)
class Answer:
    """What a network found of a texture, at its own size.

    Attributes:
        texture: (h, w, 3) what it saw.
        seen: (h, w) bool, photographed.
        log_albedo: (h, w, 3) natural logarithm.
        specular: (h, w).
        trust: (h, w) 0..1.
    """

    texture: np.ndarray
    seen: np.ndarray
    log_albedo: np.ndarray
    specular: np.ndarray
    trust: np.ndarray


def refine(
    network: WholeFaceNetwork,
    answer: Answer,
    texture: np.ndarray,
    photographed: np.ndarray,
    mesh: Mesh,
    raster: UvRaster,
    seconds: float,
    mesostructure: TrainedMesostructure | None = None,
    camera_mm: np.ndarray = CAMERA_MM,
    largest_misfit: float = LARGEST_MISFIT,
    own: OwnSkin = OF_TRUE_SHAPES,
) -> Refined | str:
    """Take the light out of a texture, beginning with a network's answer.

    Args:
        network: with its modes.
        answer: its own.
        texture: (rows, columns, 3) linear.
        photographed: (rows, columns) bool.
        mesh: in the head frame.
        raster: the texture's.
        seconds: to search, at most; what is found by then is used.
        mesostructure: finds pores and folds in the texture's detail; all detail is skin where None.
        camera_mm: (3,) from where the texture was photographed, head frame.
        largest_misfit: of a light that is taken for the texture's.
        own: what of the texture is the skin's own.

    Returns:
        The light and the skin, or why there are none, in words.
    """
    until = time.monotonic() + seconds
    low = rasterise(mesh, *answer.seen.shape)
    here = low.covered
    weight = (answer.seen & here)[here] * answer.trust[here] ** 2
    colours = answer.texture[here].astype(float)
    skin = known_skin(network, answer, here, weight)
    fit = LightFit(LitSurface(mesh, low, camera_mm), colours, weight, own.search)
    light: Light | None = None
    found = Explained(skin.answer, np.zeros((0, 3)), 1.0)
    for _ in range(ROUNDS):
        before = skin.albedo(found.along)
        light = fit.find(before, found.gloss * skin.specular, light, until)
        begin = dataclasses.replace(found, rgb=light.rgb)
        found = _explained(fit, light, colours, weight, skin, begin)
        light = dataclasses.replace(light, rgb=found.rgb)
        change = np.abs(np.log(skin.albedo(found.along) / before)).mean()
        if change < SETTLED or time.monotonic() > until:
            break
    settled = time.monotonic() <= until
    if light is None or light.misfit > largest_misfit:
        if not settled:
            return f"{seconds:g} s were too few to find the light; give more by --refine"
        return "no light explains it"
    low_albedo = np.exp(answer.log_albedo)
    low_albedo[here] = skin.albedo(found.along)
    answer = dataclasses.replace(answer, specular=found.gloss * answer.specular)
    followed = _Followed(mesh, raster, light, fit, here, camera_mm, own.penumbra)
    each = fit.columns(light.lamps_mm)[0] * light.rgb.mean(axis=1)
    shares = np.zeros((*here.shape, each.shape[1]))
    shares[here] = each / np.maximum(each.sum(axis=1, keepdims=True), DARK_LIGHT)
    unlit, known, lit, trust, irradiance = followed.taken_out(
        texture, photographed, answer.specular, low_albedo, own.normals_off
    )
    taken = TakenOut(
        texture,
        unlit,
        known,
        lit,
        trust,
        raster.covered,
        irradiance,
        low_albedo,
        shares,
        low.normals(mesh),
        sides_mirror(network.mean_position_mm[0].permute(1, 2, 0).numpy()),
    )
    skin_own = own.own(taken)
    normals = None
    if mesostructure is not None and len(texture) >= mesostructure.least_rows:
        found_there = find(mesostructure, unlit, skin_own.skin, followed.slope, followed.level)
        unlit = np.clip(unlit * np.exp(-found_there.shading), DARKEST, 1.0)
        frame = followed.frame if followed.raster is raster else _frame(mesh, raster)
        tilts = (found_there.diffuse_tilt, found_there.specular_tilt)
        normals = (frame.tilted(tilts[0]), frame.tilted(tilts[1]))
    light = dataclasses.replace(light, rgb=light.rgb * skin_own.light_gain)
    return Refined(
        skin_own.albedo(unlit),
        skin_own.known,
        skin_own.detail_share,
        _light_set(light),
        normals,
        settled,
    )


def _explained(
    fit: LightFit,
    light: Light,
    colours: np.ndarray,
    weight: np.ndarray,
    skin: KnownSkin,
    begin: Explained,
) -> Explained:
    """Skin and lamps together, and the width of the highlights by which they fit best."""

    def under(shininess: float) -> tuple[float, Explained]:
        fit.shininess = shininess
        found = explain(colours, weight, *fit.columns(light.lamps_mm), skin, begin)
        beside = np.log(shininess / SHININESS) / SHININESS_SPREAD
        return found.cost + beside**2, found

    best, (cost, found) = fit.shininess, under(fit.shininess)
    for step in (SHININESS_STEP, 1 / SHININESS_STEP):
        while SHININESS_RANGE[0] <= best * step <= SHININESS_RANGE[1]:
            other, tried = under(best * step)
            if other >= cost:
                break
            best, cost, found = best * step, other, tried
    fit.shininess = best
    return found


def known_skin(
    network: WholeFaceNetwork, answer: Answer, here: np.ndarray, weight: np.ndarray
) -> KnownSkin:
    """The skins that people have: a network's answer, brought to the directions that it keeps.

    Args:
        network: whose answer it is.
        answer: for the texture, at the network's size.
        here: (h, w) bool, texels that are used, n of them.
        weight: (n,) how much each counts.
    """
    deviations = network.mode_deviations.numpy().astype(float)
    used = deviations > 1e-3 * deviations.max()
    modes = network.albedo_modes.permute(2, 3, 1, 0).numpy()[here].astype(float)
    mean = network.mean_log_albedo[0].permute(1, 2, 0).numpy()
    counts = np.zeros(here.shape)
    counts[here] = weight
    along = network.along_modes(to_batch(answer.log_albedo - mean), to_batch(counts)[0])
    return KnownSkin(
        mean[here].astype(float),
        modes[..., used] * deviations[used],
        along[0].numpy().astype(float)[used],
        network.mode_doubt.numpy().astype(float)[np.ix_(used, used)],
        answer.specular[here].astype(float),
    )


class _Followed:
    """A light in a texture's texels, in `LARGEST_ROWS` at most."""

    def __init__(
        self,
        mesh: Mesh,
        raster: UvRaster,
        light: Light,
        fit: LightFit,
        here: np.ndarray,
        camera_mm: np.ndarray,
        penumbra: float,
    ) -> None:
        rows, columns = raster.covered.shape
        if rows > LARGEST_ROWS:
            raster = rasterise(mesh, LARGEST_ROWS, round(columns * LARGEST_ROWS / rows))
        self._mesh, self.raster, self._light = mesh, raster, light
        covered, self._lamps_mm = raster.covered, np.array(light.lamps_mm).reshape(-1, 3)
        surface = LitSurface(mesh, raster, camera_mm)
        self._seen = surface.seen(self._lamps_mm)
        if penumbra > 0:
            self._seen = _softened(self._seen, covered, penumbra * len(covered))
        given, lobes = surface.under(self._lamps_mm, fit.shininess, self._seen)
        openness = np.zeros(here.shape)
        openness[here] = fit.openness
        openness = enlarged(openness, *covered.shape)[covered]
        self._irradiance, self._lobe = (np.zeros((*covered.shape, 3)) for _ in range(2))
        self._irradiance[covered] = given @ light.rgb[:-1] + openness[:, None] * light.rgb[-1]
        self._lobe[covered] = lobes @ light.rgb[:-1]
        self.level = self._irradiance.mean(axis=2).astype(np.float32)

    def taken_out(
        self,
        texture: np.ndarray,
        photographed: np.ndarray,
        specular: np.ndarray,
        low_albedo: np.ndarray,
        normals_off: float,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Divide a texture by its light.

        Args:
            texture: (rows, columns, 3) linear.
            photographed: (rows, columns) bool.
            specular: (h, w) albedo.
            low_albedo: (h, w, 3) diffuse albedo found so far.
            normals_off: see `OwnSkin`.

        Returns:
            `unlit`, `known`, `lit`, `trust` and `irradiance` of `TakenOut`.
        """
        rows, columns = photographed.shape
        covered = self.raster.covered
        edges = light_edges(self.level, covered)
        known = lit_enough(self.level, covered) & ~edges
        level = self.level / max(median_light(self.level, covered), DARK_LIGHT)
        images = [self._irradiance, self._lobe, self.slope, level]
        if covered.shape != (rows, columns):
            images = [enlarged(image, rows, columns) for image in images]
            known = enlarged(known.astype(np.float32), rows, columns) > 0.999
        irradiance, lobe, slope, level = images
        shine = enlarged(specular, rows, columns)[..., None] * lobe
        unlit = over_light(texture, irradiance, shine)
        skin = np.exp(enlarged(np.log(low_albedo), rows, columns))
        dark = in_the_dark(texture, photographed)
        lit = known & photographed
        known = lit & matt(texture, shine) & ~dark
        # The border of a shadow that the model does not have is an edge, too.
        edges |= cv2.resize(dark.astype(np.uint8), edges.shape[::-1]) > 0
        known &= ~misplaced(unlit / skin, edges, known)
        trust = trusted(texture, shine, level, slope, normals_off)
        return unlit, known, lit, trust, irradiance

    @functools.cached_property
    def frame(self) -> Frame:
        """Directions at each of its texels."""
        return _frame(self._mesh, self.raster)

    @functools.cached_property
    def slope(self) -> np.ndarray:
        """How the light changes with a tilt, see `slope_of`."""
        covered = self.raster.covered
        seen = np.zeros((len(self._seen), *covered.shape), np.float32)
        seen[:, covered] = self._seen
        position_mm = self.raster.interpolate(self._mesh.vertices)
        strength = self._light.rgb[:-1].mean(axis=1)
        return slope_of(self.frame, position_mm, self._lamps_mm, strength, seen, self.level)


def _softened(seen: np.ndarray, covered: np.ndarray, sigma: float) -> np.ndarray:
    """(L, n) visibility of each lamp, with shadows whose edges are so many texels wide."""
    weight = np.maximum(blurred(covered.astype(np.float32), sigma), 1e-3)
    image = np.zeros(covered.shape, np.float32)
    soft = np.empty_like(seen)
    for lamp, visible in enumerate(seen):
        image[covered] = visible
        soft[lamp] = (blurred(image, sigma) / weight)[covered]
    return soft


def _frame(mesh: Mesh, raster: UvRaster) -> Frame:
    """Directions at each texel of a mesh."""
    position_mm = raster.interpolate(mesh.vertices)
    return frame_of(raster.normals(mesh), position_mm, raster.covered)


def with_shares(unlit: np.ndarray, taken: TakenOut, own: OwnShares) -> np.ndarray:
    """(rows, columns, 3) the albedo at a texture's own size, by shares of what it shows.

    Args:
        unlit: (rows, columns, 3) texture over its light.
        taken: where that shows the skin, and how far it is trusted.
        own: the shares.
    """
    shape = taken.known.shape
    base = enlarged(np.log(taken.low_albedo), *shape)
    beside = (np.log(unlit) - base) * np.broadcast_to(taken.trust, shape)[..., None]
    filled = without_gaps(beside, taken.known, taken.covered, taken.sides)
    coarse, there = at_network_size(filled, taken.covered, taken.low_albedo.shape[:2])
    finer = filled - enlarged(coarse, *shape)
    marks = enlarged(own.marks * _marks(coarse, there), *shape)
    albedo: np.ndarray = np.exp(np.minimum(base + marks + own.detail * finer, 0.0))
    return albedo


def at_network_size(
    image: np.ndarray, known: np.ndarray, size: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Take means of an image's known texels over larger ones.

    Args:
        image: (rows, columns[, c]), 0 where it is not known.
        known: (rows, columns) bool.
        size: h and w of the larger texels.

    Returns:
        (h, w[, c]) and (h, w) bool, where enough of a texel is known; 0 elsewhere.
    """
    shape = (size[0], size[1])
    share = _shrunk(known.astype(np.float32), shape)
    there = share > LEAST_COVERED
    weight = there / np.maximum(share, LEAST_COVERED)
    coarse = _shrunk(image, shape)
    return coarse * (weight[..., None] if coarse.ndim == 3 else weight), there


def _marks(beside: np.ndarray, known: np.ndarray) -> np.ndarray:
    """(h, w, 3) what a texture shows beside a skin, less what is wider than a mark is."""
    weight = known.astype(np.float32)
    sigma = WIDEST_MARK * known.shape[0]
    wide = cv2.GaussianBlur((beside * weight[..., None]).astype(np.float32), (0, 0), sigma)
    spread = cv2.GaussianBlur(weight, (0, 0), sigma)
    found: np.ndarray = (beside - wide / np.maximum(spread, 1e-3)[..., None]) * weight[..., None]
    return found


def _shrunk(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """(rows, columns[, c]) as means over larger texels."""
    return from_batch(shrink(to_batch(image), size))


def _light_set(light: Light) -> LightSet:
    places = np.array(light.lamps_mm).reshape(-1, 3)
    return LightSet("found in the texture", places, light.rgb[:-1], light.rgb[-1])
