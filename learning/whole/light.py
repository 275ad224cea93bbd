"""The light in a texture: a few lamps and light from everywhere, found through the renderer.

Under known albedo a texture is linear in the lamps' colours, which non-negative least squares
finds; the lamps' places are searched, as shadows have no useful slope. A dome of lamps gives
the start.
"""

from __future__ import annotations

import dataclasses
import time
from typing import Protocol

import numpy as np
import torch
from scipy.optimize import nnls

from learning.maps import SHININESS, skin_maps_from
from learning.render.environments import Environment
from learning.render.light_dome import even_directions
from learning.render.occlusion import ShadowCaster
from learning.render.shading import ShadeOptions, direct
from learning.render.uv import UvRaster
from lightstage.formats.mesh import Mesh

DOME_MM = 1000.0 * even_directions(128)
"""Lamps all round; the light from everywhere is their mean."""
NEAREST_MM, FARTHEST_MM = 500.0, 4000.0
"""Lamps are searched between these distances; a farther one looks the same."""
FIRST_STEP, LAST_STEP = 0.25, 0.015
"""Steps of the search: a lamp's move over its distance, halved where no move helps."""
ADDED_AT = 0.97
"""Another lamp stays where the misfit falls below this share of that without it."""
NEIGHBOURHOOD = 0.8
"""Cosine within which lamps of the dome are taken for one."""
FAINT = 0.02
"""Share of the dome's light below which no lamp is sought."""
DARK = 0.05
"""Added to a texture's value before errors are weighed by it: dark texels are mostly noise."""
ROBUST_ROUNDS = 4
SHADING = ShadeOptions("ggx")
"""Facets with Fresnel's rise: what mirrors light at grazing angles is no skin."""
F0 = 0.028
"""Skin's reflectance at normal incidence, on which Fresnel's rise is based."""
AMBIENT_SHINE = 1.3
"""What a face mirrors of light from everywhere, over the specular albedo: Fresnel's reflectance at
n = 1.4 over F0 in the mean over directions up to 60 degrees from the normal."""

SEARCH_SECONDS = 120.0
"""For a search of which the user states no time. It ends by itself within 10 seconds of a quiet
machine: what is found does not depend on how busy a machine is that is not ten times slower."""

Lamps = tuple[tuple[float, float, float], ...]
"""Places of lamps, mm, head frame."""


@dataclasses.dataclass(frozen=True)
class LightSearch:
    """Settings of the search for a texture's light.

    Attributes:
        most_lamps: beside light from everywhere.
        half_at: deviation in natural logarithms at which a texel weighs half in the misfit.
    """

    most_lamps: int = 4
    half_at: float = 0.1


SEARCH = LightSearch()


class Surface(Protocol):
    """Texels, and what a lamp anywhere gives them; see `LitSurface`."""

    def seen(self, lamps_mm: np.ndarray) -> np.ndarray:
        """(L, n) share of each lamp that each texel sees."""

    def under(
        self, lamps_mm: np.ndarray, shininess: float = ..., seen: np.ndarray | None = ...
    ) -> tuple[np.ndarray, np.ndarray]:
        """(n, L) irradiance and lobe."""

    def openness(self, dome: np.ndarray | None = ...) -> np.ndarray:
        """(n,) share of even light."""


class LitSurface:
    """The texels of a head, and what a lamp anywhere gives them."""

    def __init__(self, mesh: Mesh, raster: UvRaster, camera_mm: np.ndarray) -> None:
        """A head in the head frame, and from where its highlights are seen."""
        covered = raster.covered
        ones = np.ones(covered.shape, np.float32)
        normal, position = raster.normals(mesh), raster.interpolate(mesh.vertices)
        maps = {"diffuse_albedo": np.repeat(ones[..., None], 3, axis=2), "specular_albedo": ones}
        maps |= {"diffuse_normal": normal, "specular_normal": normal, "position": position}
        self.covered = covered
        self._skin = skin_maps_from(maps, covered, SHININESS * ones, 0 * ones)
        self._camera_mm = torch.from_numpy(np.asarray(camera_mm, np.float32))
        self._caster = ShadowCaster(
            mesh.vertices, raster.triangles, position[covered], normal[covered]
        )
        self._normal = normal[covered]

    def seen(self, lamps_mm: np.ndarray) -> np.ndarray:
        """(L, n) share of each of (L, 3) lamps that each texel sees."""
        return self._caster.seen(lamps_mm, np.zeros(len(lamps_mm), bool))

    def under(
        self,
        lamps_mm: np.ndarray,
        shininess: float = SHININESS,
        seen: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """(n, L) irradiance and (n, L) lobe of white lamps of strength 1, with cast shadows.

        Args:
            lamps_mm: (L, 3).
            shininess: Blinn-Phong's exponent of the lobe.
            seen: (L, n) of the method `seen`, where it is known already.
        """
        if not len(lamps_mm):
            nothing = np.zeros((len(self._normal), 0))
            return nothing, nothing
        visible = np.zeros((len(lamps_mm), 1, *self.covered.shape), np.float32)
        visible[:, 0, self.covered] = self.seen(lamps_mm) if seen is None else seen
        count = len(lamps_mm)
        each = Environment(
            torch.from_numpy(np.asarray(lamps_mm, np.float32))[:, None],
            torch.ones(count, 1, 3),
            torch.zeros(count, 3),
            torch.zeros(count, 1, dtype=torch.bool),
            self._camera_mm.expand(count, 3),
        )
        exponent = torch.full_like(self._skin.shininess, shininess)
        skin = dataclasses.replace(self._skin, shininess=exponent)
        with torch.inference_mode():
            given, lobe, rim = direct(skin, each, SHADING, torch.from_numpy(visible))
            assert rim is not None
            both = (given, lobe + rim / F0)
        irradiance, shine = (x[:, 0].numpy()[:, self.covered].T.astype(float) for x in both)
        return irradiance, shine

    def openness(self, dome: np.ndarray | None = None) -> np.ndarray:
        """(n,) share of even light from all round that reaches a texel, weighted by the cosine.

        Args:
            dome: (L, n) of the method `seen` for `DOME_MM`, where it is known already.
        """
        dome = self.seen(DOME_MM) if dome is None else dome
        cosine = np.clip(self._normal @ (DOME_MM / np.linalg.norm(DOME_MM[0])).T, 0, None)
        return (dome.T * cosine).sum(axis=1) / np.maximum(cosine.sum(axis=1), 1e-6)


@dataclasses.dataclass(frozen=True)
class Light:
    """Lamps and light from everywhere.

    Attributes:
        lamps_mm: places of the lamps, head frame.
        rgb: (L + 1, 3) of the lamps and, last, of the light from everywhere; units as
            `learning.render.environments`.
        misfit: 0 where all texels fit; a texel that is off by `half_at` adds log 2.
    """

    lamps_mm: Lamps
    rgb: np.ndarray
    misfit: float


class LightFit:
    """A texture, and the search for its light."""

    def __init__(
        self,
        surface: Surface,
        texture: np.ndarray,
        weight: np.ndarray,
        search: LightSearch = SEARCH,
    ) -> None:
        """A head's n texels: (n, 3) linear texture, (n,) how much each counts; lamps sought.

        `openness` is (n,), see `LitSurface.openness`; `shininess` of its highlights may be changed.
        """
        self._surface, self._search = surface, search
        counted = weight > 0
        self._counted = slice(None) if counted.all() else counted
        # A channel after the other, and only what counts: the search solves for lamps often.
        self._texture, self._weight = texture[counted].T.copy(), weight[counted]
        self._scale = 1 / (self._texture.mean(axis=0) + DARK)
        self._log = np.log(np.maximum(self._texture, 1e-3)).mean(axis=0)
        seen = surface.seen(DOME_MM)
        self.openness, self.shininess = surface.openness(seen), SHININESS
        self._seen: dict[tuple[float, float, float], np.ndarray] = {}
        self._known: dict[
            tuple[tuple[float, float, float], float], tuple[np.ndarray, np.ndarray]
        ] = {}
        self._dome = surface.under(DOME_MM, seen=seen)

    def find(
        self, albedo: np.ndarray, specular: np.ndarray, begin: Light | None, until: float
    ) -> Light:
        """Find the light under which a skin gives the texture.

        Args:
            albedo: (n, 3) diffuse.
            specular: (n,) specular albedo.
            begin: an earlier answer, whose lamps are moved; else they are sought one by one.
            until: monotonic seconds at which the search stops with what it has.
        """
        skin = (albedo, specular)
        if begin is not None:
            return self._moved(skin, begin.lamps_mm, LAST_STEP * 4, until)
        best = self._lit(skin, ())
        sought = self._peaks(skin)
        for count in range(1, len(sought) + 1):
            if time.monotonic() > until:
                break
            # Of two lamps at opposite sides one alone may be no better than none.
            whole = len(best.lamps_mm) == count - 1
            before = best.lamps_mm if whole else sought[: count - 1]
            found = self._moved(skin, (*before, sought[count - 1]), FIRST_STEP, until)
            if found.misfit <= ADDED_AT * best.misfit:
                best = found
        return best

    def _peaks(self, skin: tuple[np.ndarray, np.ndarray]) -> Lamps:
        """Places where the light of a dome of lamps is strongest, `most_lamps` places at most."""
        around = self.openness, AMBIENT_SHINE * self.openness
        irradiance, lobe = map(np.column_stack, zip(self._dome, around, strict=True))
        rgb, _ = self._solved(skin, irradiance, lobe, steady=1e-3)
        peaks = rgb[:-1].sum(axis=1)
        distance = np.linalg.norm(DOME_MM[0])
        direction = DOME_MM / distance
        floor = FAINT * peaks.sum()
        found: Lamps = ()
        while len(found) < self._search.most_lamps and peaks.max() > floor:
            near = direction @ direction[peaks.argmax()] > NEIGHBOURHOOD
            toward = (peaks * near) @ direction
            place = distance * toward / np.linalg.norm(toward)
            found = (*found, (float(place[0]), float(place[1]), float(place[2])))
            peaks = np.where(near, 0, peaks)
        return found

    def _moved(
        self, skin: tuple[np.ndarray, np.ndarray], lamps: Lamps, step: float, until: float
    ) -> Light:
        """Move lamps, one at a time, as long as the misfit falls."""
        best = self._lit(skin, lamps)
        while step > LAST_STEP and lamps:
            before = best
            for index in range(len(lamps)):
                for moved in _moves(best.lamps_mm, index, step):
                    if time.monotonic() > until:
                        return best
                    found = self._lit(skin, moved)
                    if found.misfit < best.misfit - 1e-5:
                        best = found
                        break
            if best is before:
                step /= 2
        return best

    def _lit(self, skin: tuple[np.ndarray, np.ndarray], lamps: Lamps) -> Light:
        rgb, misfit = self._solved(skin, *self.columns(lamps))
        return Light(lamps, rgb, misfit)

    def columns(self, lamps: Lamps) -> tuple[np.ndarray, np.ndarray]:
        """(n, L + 1) irradiance and lobe of lamps of strength 1, light from everywhere last."""
        unseen = [lamp for lamp in lamps if lamp not in self._seen]
        if unseen:
            self._seen.update(zip(unseen, self._surface.seen(np.array(unseen)), strict=True))
        missing = [lamp for lamp in lamps if (lamp, self.shininess) not in self._known]
        if missing:
            seen = np.stack([self._seen[lamp] for lamp in missing])
            irradiance, lobe = self._surface.under(np.array(missing), self.shininess, seen)
            for index, lamp in enumerate(missing):
                self._known[lamp, self.shininess] = irradiance[:, index], lobe[:, index]
        each = [self._known[lamp, self.shininess] for lamp in lamps]
        around = self.openness, AMBIENT_SHINE * self.openness
        irradiance, lobe = (
            np.stack([*(parts[i] for parts in each), ambient]).T for i, ambient in enumerate(around)
        )
        return irradiance, lobe

    def _solved(
        self,
        skin: tuple[np.ndarray, np.ndarray],
        irradiance: np.ndarray,
        lobe: np.ndarray,
        steady: float = 1e-6,
    ) -> tuple[np.ndarray, float]:
        """(L, 3) colours of lamps, not negative, and the misfit; texels far off lose weight."""
        albedo, specular = (np.ascontiguousarray(v.T[..., self._counted]) for v in skin)
        shine = lobe.T[:, self._counted] * specular
        rows = albedo[:, None] * irradiance.T[:, self._counted] + shine
        weight = self._weight
        for _ in range(ROBUST_ROUNDS):
            root = np.sqrt(weight) * self._scale
            rgb = _steady_nnls(rows, self._texture, root, steady)
            red, green, blue = np.maximum(rgb[:, None] @ rows, 1e-3)[:, 0]
            off = np.abs(np.log(red * green * blue) / 3 - self._log)
            middle = float(np.median(off)) if off.size else 0.0
            weight = self._weight / (1 + (off / max(1.5 * 1.4826 * middle, 0.05)) ** 2)
        total = max(float(self._weight.sum()), 1e-9)
        return rgb.T, float(
            (self._weight * np.log1p((off / self._search.half_at) ** 2)).sum() / total
        )


def _steady_nnls(
    rows: np.ndarray, right: np.ndarray, root: np.ndarray, steady: float
) -> np.ndarray:
    """Non-negative least squares through the normal equations, with a small Tikhonov term.

    Args:
        rows: (3, L, n) what each unknown adds, by channel.
        right: (3, n) what they should add up to.
        root: (n,) square root of each equation's weight.
        steady: the term, of the mean of the normal equations' diagonal.

    Returns:
        (3, L).
    """
    weighted = rows * root
    normal = weighted @ weighted.transpose(0, 2, 1)
    size = np.maximum(np.trace(normal, axis1=1, axis2=2) / rows.shape[1], 1e-30)
    normal += (steady * size)[:, None, None] * np.eye(rows.shape[1])
    projected = weighted @ (right * root)[:, :, None]
    found: np.ndarray = np.linalg.solve(normal, projected)[:, :, 0]
    # Where no unknown is negative by itself, this is the answer.
    for channel in np.flatnonzero((found < 0).any(axis=1)):
        lower = np.linalg.cholesky(normal[channel])
        given = np.linalg.solve(lower, projected[channel, :, 0])
        found[channel] = nnls(lower.T, given, maxiter=100 * len(lower))[0]
    return found


def _moves(lamps: Lamps, index: int, step: float) -> list[Lamps]:
    """The lamps with one of them moved sideways, up, down, away or nearer."""
    place = np.array(lamps[index])
    distance = float(np.linalg.norm(place))
    toward = place / distance
    side = np.cross(toward, (0.0, 1.0, 0.1))
    side /= max(float(np.linalg.norm(side)), 1e-6)
    up = np.cross(toward, side)
    found = []
    for turn in (side, -side, up, -up):
        moved = toward + step * turn
        found.append(distance * moved / np.linalg.norm(moved))
    found += [place * (1 + 2 * step), place / (1 + 2 * step)]
    near = [p for p in found if NEAREST_MM <= float(np.linalg.norm(p)) <= FARTHEST_MM]
    return [
        (*lamps[:index], (float(p[0]), float(p[1]), float(p[2])), *lamps[index + 1 :]) for p in near
    ]
