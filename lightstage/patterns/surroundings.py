"""Light from everywhere, as the stage's lights can show it: each gets what its directions send."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lightstage.errors import PatternError
from lightstage.formats.environment import read_lights
from lightstage.formats.panorama import SUFFIXES, read_panorama
from lightstage.formats.srgb import LUMINANCE
from lightstage.patterns.weights import shared_directions, solid_angles_sr
from lightstage.rig import Rig

SAMPLES_PER_LIGHT = 2000
"""So that a cell's edge, drawn by whole points, is off by a few per cent of its area."""
MOST_SAMPLES = 2_000_000


def surroundings_flux(path: Path, rig: Rig, rotate_deg: float = 0.0) -> np.ndarray:
    """What each lamp of the stage must send for the stage to resemble these surroundings.

    A latitude-longitude picture's luminance is summed over each light's Voronoi cell, the
    directions nearest to it; lights in one direction share it. Nothing of the picture is lost:
    the sum over the lights is that over the picture. Row 0 looks up (+y), the middle column along
    +z, and columns grow toward +x. A light set (`lightstage.environment/1`) gives each of its
    lights to the cell it is in, and its ambient light to all by their solid angles.

    A stage that shows the light of a place: [Debevec2002].

    Args:
        path: .exr or .hdr, twice as wide as high; or a light set, .json.
        rig: the lights.
        rotate_deg: turn of the surroundings about +y, +z toward +x.

    Returns:
        (n,) luminance times steradians, at least 0.

    Raises:
        PatternError: another kind of file; a light set without light.
        FormatError: a picture that `read_panorama` refuses, or a malformed light set.
    """
    kind = path.suffix.lower()
    if kind not in (*SUFFIXES, ".json"):
        raise PatternError(path, found=kind or "no suffix", expected=".exr, .hdr or .json")
    alone, cell = shared_directions(rig)
    if kind == ".json":
        lights = read_lights(path)
        places = lights.position_mm / np.linalg.norm(lights.position_mm, axis=1, keepdims=True)
        # A diffuser that faces a light of this much reads 1 / pi of what falls on it.
        flux, ambient = np.pi * lights.rgb @ LUMINANCE, float(lights.ambient_rgb @ LUMINANCE)
    else:
        radiance = read_panorama(path)
        wanted = min(SAMPLES_PER_LIGHT * len(alone), MOST_SAMPLES)
        flux, places = _samples(radiance @ LUMINANCE, wanted)
        ambient = 0.0
    seen: np.ndarray = np.zeros(len(alone))
    if len(places):
        turn = np.radians(rotate_deg)
        x, y, z = places.T
        turned = np.stack(
            [x * np.cos(turn) + z * np.sin(turn), y, z * np.cos(turn) - x * np.sin(turn)], axis=1
        )
        from scipy.spatial import cKDTree

        nearest = cKDTree(alone).query(turned)[1]
        seen = np.bincount(nearest, weights=flux, minlength=len(alone))
    total = seen[cell] / np.bincount(cell)[cell] + ambient * solid_angles_sr(rig)
    if not total.any():
        raise PatternError(path, found="no light at all", expected="surroundings that shine")
    return np.asarray(total)


def _samples(luminance: np.ndarray, wanted: int) -> tuple[np.ndarray, np.ndarray]:
    """A (h, 2 h) picture as points of light: (k,) luminance times steradians, (k, 3) directions.

    Texels are cut into so many alike parts, or gathered into so many blocks, that there are
    `wanted` points, `MOST_SAMPLES` at most; a block's point is where its light is, so that a
    small sun stays in its own cell.
    """
    rows = len(luminance)
    cut = int(np.ceil(np.sqrt(max(1.0, wanted / luminance.size))))
    gather = int(np.ceil(np.sqrt(luminance.size / MOST_SAMPLES)))
    if cut > 1:
        luminance = np.repeat(np.repeat(luminance, cut, axis=0), cut, axis=1)
        rows *= cut
    edges = np.cos(np.pi * np.arange(rows + 1) / rows)
    texel_sr = (edges[:-1] - edges[1:]) * np.pi / rows
    polar = np.pi * (np.arange(rows) + 0.5) / rows
    azimuth = 2 * np.pi * ((np.arange(2 * rows) + 0.5) / (2 * rows) - 0.5)
    fluxes, places = [], []
    begins = np.arange(0, 2 * rows, gather)
    for top in range(0, rows, gather):
        part = slice(top, top + gather)
        flux = luminance[part] * texel_sr[part, None]
        sine = np.sin(polar[part])[:, None]
        parts = [flux, flux * sine * np.sin(azimuth), flux * np.cos(polar[part])[:, None]]
        parts.append(flux * sine * np.cos(azimuth))
        sums = np.stack([np.add.reduceat(p.sum(axis=0), begins) for p in parts], axis=1)
        sums = sums[sums[:, 0] > 0]
        length = np.linalg.norm(sums[:, 1:], axis=1, keepdims=True)
        fluxes.append(sums[:, 0])
        places.append(sums[:, 1:] / np.where(length > 0, length, 1.0))
    return np.concatenate(fluxes), np.concatenate(places)
