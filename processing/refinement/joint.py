"""Normal, diffuse albedo and specular albedo of a pixel, solved together from all its readings.

What pattern k and channel c read is modelled as rho_c E_k(n) + s B_k(n, m). Gauss-Newton on it
needs, beside E and B, how both turn with the normal; the relief moves the highlight between
patterns, so that gloss found with the normal held fast is wrong. Readings are weighted by their
noise.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from processing.lanes import LANES
from processing.lighting.interface import Interface
from processing.lighting.lights import PatternLights, Shadows, compiled
from processing.lighting.lobe import fresnel_table
from processing.refinement.joint_equations import Spread
from processing.refinement.joint_kernels import (
    Pixels,
    Solved,
    fitted_kernel,
    solve_kernel,
)
from processing.refinement.joint_light import Lamps, chunks_of

NOISE_APART = 2.0
"""So many standard deviations of its noise a matte normal may be from that of all readings where
these are as well explained as they can be."""
MOST_MISFIT = 256.0
"""A larger misfit leaves no less of that distance."""


@dataclasses.dataclass(frozen=True)
class Noise:
    """Variance of a reading I is sensor^2 (floor + I) + (model I)^2, and shade's beside it.

    Attributes:
        sensor: root of the shot noise's variance for a reading of 1.
        model: what a channel's reading is wrong by, as a share of it.
        shade: what a pattern's irradiance is wrong by, as a share of it, in all channels alike:
            shadows, bounces and lamps that are not quite as modelled. Colour still shows gloss.
        floor: the noise without light over the shot noise's variance for a reading of 1.
    """

    sensor: float = 0.001
    model: float = 0.003
    shade: float = 0.01
    floor: float = 0.25


@dataclasses.dataclass(frozen=True)
class Place:
    """Places of n pixels on the mesh.

    Attributes:
        points_mm: (n, 3).
        views: (n, 3) unit, toward the camera.
        shadows: lights that each sees.
        bounced: (V, P, 3) float32 irradiance at the shadows' vertices by light from other skin;
            (0, P, 3) where there is none.
        mirrored: (4, L) of `polarisers.mirrored_of_lamps`.
        diffuse: (cells, P) share of the diffuse light of each normal, by the cells of the
            octahedral grid, that reaches the camera; (1, P) where it is the same for all.
    """

    points_mm: np.ndarray
    views: np.ndarray
    shadows: Shadows
    bounced: np.ndarray
    mirrored: np.ndarray
    diffuse: np.ndarray


@dataclasses.dataclass(frozen=True)
class Scattered:
    """Light that leaves the skin elsewhere than it entered.

    What leaves in channel c under pattern k is kept_c E_k + rest_kc: its own part turns with the
    pixel's normal, the neighbours' does not.

    Attributes:
        kept: (3,) float64 share of each channel that leaves where it entered; 1 without scattering.
        rest: (n, P, 3) float32 what comes from neighbours; zero without.
    """

    kept: np.ndarray
    rest: np.ndarray


@dataclasses.dataclass(frozen=True)
class Given:
    """n pixels, and all that is held fast while they are solved.

    Attributes:
        rgb: (n, P, 3) readings in the lights' own colour.
        lights: of P patterns; polarised ones need no colour to show what is mirrored.
        place: of the n pixels.
        normals: (n, 3) unit, to start from; zero where there is none.
        roughness: (n,) m of the facets.
        specular: (n,) reflectance at normal incidence.
        interface: that light passes on its way into the diffuse layer and out, and its facets.
        scattered: inside the skin.
        noise: of the readings.
    """

    rgb: np.ndarray
    lights: PatternLights
    place: Place
    normals: np.ndarray
    roughness: np.ndarray
    specular: np.ndarray
    interface: Interface
    scattered: Scattered
    noise: Noise


def solve_jointly(given: Given, rounds: int = 2) -> Solved:
    """Normals and albedo of pixels whose gloss is known, by Gauss-Newton from given normals.

    Args:
        given: see there.
        rounds: steps.
    """
    count = len(given.rgb)
    normal, matte, lit, power = np.zeros((4, count, 3), np.float32)
    out = Solved(
        normal,
        matte,
        lit,
        power,
        misfit=np.zeros(count, np.float32),
        irradiance=np.zeros(given.rgb.shape[:2], np.float32),
        certainty=np.zeros(count, np.float32),
        matte_turn2=np.zeros(count, np.float32),
    )
    solve_kernel(*_compiled(given), rounds, not given.lights.polarised, out)
    return out


def solve_searching(given: Given, apart_deg: float) -> Solved:
    """One step of `solve_jointly` while the gloss is still searched: normals stay `near_matte`.

    Polarised light shows what is mirrored without its colour: there they need not.
    """
    solved = solve_jointly(given, rounds=1)
    return solved if given.lights.polarised else near_matte(solved, apart_deg)


def near_matte(solved: Solved, apart_deg: float) -> Solved:
    """Normals of all readings, turned back to the matte ones where gloss explains no such distance.

    While the gloss is not known, what is mirrored beside what the model has of it turns the normal
    of all readings, of dark and shiny skin by 10 degrees and more; about such normals evidence of
    gloss leads astray. Chroma holds no gloss, so that the matte normal errs by noise alone. The
    larger the misfit, the less the normal of all readings is believed.

    Args:
        solved: of which light that shows what is mirrored by its colour.
        apart_deg: what the two may be apart without noise: light that wanders turns the matte one.

    Returns:
        The same with other normals; where there is no matte one the normal stays.
    """
    normal, matte = solved.normal.astype(float), solved.matte.astype(float)
    both = (np.einsum("nk,nk->n", matte, matte) > 0.5) & (solved.matte_turn2 >= 0)
    cosine = np.einsum("nk,nk->n", normal, matte)
    aside = normal - cosine[:, None] * matte
    sine = np.linalg.norm(aside, axis=1)
    noise = np.sqrt(np.maximum(solved.matte_turn2, 0))
    noise *= NOISE_APART / np.clip(solved.misfit, 1, MOST_MISFIT) ** 0.25
    most = np.minimum(np.radians(apart_deg) + noise, np.pi)
    far = both & (sine > 0) & (np.arctan2(sine, cosine) > most)
    aside /= np.where(sine > 0, sine, 1)[:, None]
    turned = np.cos(most)[:, None] * matte + np.sin(most)[:, None] * aside
    return solved._replace(normal=np.where(far[:, None], turned, normal).astype(np.float32))


def gloss_evidence(given: Given) -> np.ndarray:
    """Each pixel's evidence of its specular albedo and roughness, normal and albedo left free.

    Args:
        given: see there; the lobe is taken as linear about its roughness and specular albedo.

    Returns:
        (n, 5) float32: information on s, on s and m together, on m; its product with the offsets
        of s and of m from the given ones that fit best. Sums over pixels of one gloss are that
        gloss's. Zero where a pixel cannot be solved; outliers count little.
    """
    out = np.zeros((len(given.rgb), 5), np.float32)
    fitted_kernel(*_compiled(given), np.zeros(0, np.int64), out)
    return out


def held_out(given: Given, groups: np.ndarray) -> np.ndarray:
    """How far each group of patterns is from what a pixel's other patterns predict.

    Normal and albedo are fitted to the other patterns alone; the squared error of the prediction is
    divided by its variance, which holds the readings' noise and what the others leave open.

    Args:
        given: see there; the model is taken as linear about the normals.
        groups: (P,) number of each pattern's group; -1 is never left out.

    Returns:
        (n, G) float32 mean over a group's readings, at least 0; 0 where a pixel has no normal to
        begin with, no number where the others fix none.
    """
    out = np.zeros((len(given.rgb), int(groups.max()) + 1), np.float32)
    fitted_kernel(*_compiled(given), np.ascontiguousarray(groups, np.int64), out)
    return out


def _compiled(given: Given) -> tuple[Pixels, Lamps, Spread]:
    """What both kernels take."""

    def single(values: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(values, np.float32)

    place, scattered = given.place, given.scattered
    pixels = Pixels(
        rgb=single(given.rgb),
        points=single(place.points_mm),
        starts=single(given.normals),
        views=single(place.views),
        roughness=single(given.roughness),
        specular=single(given.specular),
        corners=place.shadows.corners,
        weights=place.shadows.weights,
        rests=single(scattered.rest),
    )
    lamps = lamps_of(given.lights, place, given.interface)
    return pixels, lamps, spread_of(given.noise, scattered)


def spread_of(noise: Noise, scattered: Scattered) -> Spread:
    """What compiled code takes of the readings' noise, and of what light stays where it entered."""
    kept = np.ascontiguousarray(scattered.kept, np.float64)
    shot2 = float(noise.sensor) ** 2
    return Spread(
        shot2 * float(noise.floor), shot2, float(noise.model) ** 2, float(noise.shade) ** 2, kept
    )


def lamps_of(lights: PatternLights, place: Place, interface: Interface) -> Lamps:
    """What `joint_light.gather` takes of the stage."""
    stray = lights.stray
    seen = compiled(lights, place.shadows)
    count = len(seen.weight)
    missing = max(0, LANES - count)

    def padded(values: np.ndarray) -> np.ndarray:
        """(.., L) with lights of no weight added to fill a vector."""
        added = [(0, 0)] * (values.ndim - 1) + [(0, missing)]
        return np.ascontiguousarray(np.pad(values, added) if missing else values)

    strength = lights.weight * lights.radius_mm**2
    group = np.repeat(np.arange(len(seen.group_end)), np.diff(seen.group_end, prepend=0))
    return Lamps(
        visible=padded(seen.visible),
        position=padded(seen.position.T),
        strength=padded(strength.astype(np.float32)),
        radius=padded(seen.radius),
        levels=seen.levels,
        chunks=chunks_of(seen.group_end),
        group=group,
        exponent=seen.exponent,
        diffuse=np.ascontiguousarray(place.diffuse, np.float32),
        mirrored=padded(place.mirrored.astype(np.float32)),
        stray=(stray if stray.any() else stray[:0]).astype(np.float32),
        bounced=place.bounced,
        table=fresnel_table(interface.facets.rises).astype(np.float32),
        through=interface.table,
        mean=interface.mean,
        shape=interface.facets.shape,
    )
