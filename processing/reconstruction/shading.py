"""Photometric normals again, now that the mesh shows which lights each point sees.

Coarse normals take all lights for seen: beside the nose, around the lids and between the lips,
where they are not, normals turn by ten degrees and more. With the shadows of the first mesh the
same readings give normals that are right there, too [Woodham1980].
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lightstage.formats.mesh import Mesh
from processing.lighting.interface import skin_interface
from processing.lighting.lights import PatternLights, Shadows, fix_normals, irradiance_vectors
from processing.normals import solve_normals
from processing.parallel import over_views, workers
from processing.rays import MeshRays
from processing.reconstruction.second_depth import Sighted
from processing.reconstruction.views import Level, View, block_sum

ROUNDS = 2
"""Solves, each with the horizon of the last one's normals."""
COLOUR_SPREAD = 0.1
"""Lights whose colours differ by more leave highlights in what chroma takes for scattered."""
WITHIN = 0.5
"""Least cosine to the mesh's normal: what turns farther is no normal of this surface."""
PIXEL_BYTES = 400
"""That a pixel of a view takes, at most."""


def mended_normals(
    level: Level,
    times: int,
    views: Sequence[View],
    seen: Sequence[Sighted],
    mesh: Mesh,
    rays: MeshRays,
    normals: np.ndarray,
    lights: PatternLights,
) -> np.ndarray | None:
    """The level's normals, solved again under the shadows that a mesh casts.

    Args:
        level: whose normals are mended.
        times: 2 where the views are twice as fine as the level, else 1.
        views: with signals.
        seen: what the views see of the mesh.
        mesh: mm, world.
        rays: of the mesh.
        normals: (v, 3) of its vertices.
        lights: of the patterns that the signals are of.

    Returns:
        (views, h, w, 3) float32 unit, as they were where there is no signal or no mesh; None where
        the patterns light from fewer than three directions, or in colours of their own.
    """
    if lights.colour_spread > COLOUR_SPREAD or not fix_normals(lights):
        return None
    visible = rays.visible(mesh.vertices, normals, lights.position_mm).astype(np.uint8)
    out = level.normals.copy()

    def mend(index: int) -> None:
        view, sight = views[index], seen[index]
        if view.signal is None or not len(sight.rows):
            return
        signal = _at(view.signal, times, sight)
        given = np.isfinite(signal).all(axis=1)
        at = sight.rows[given], sight.columns[given]
        corners = mesh.faces[sight.hits.face[given]].astype(np.int32)
        weights = sight.hits.barycentric[given].astype(np.float32)
        points = np.einsum("nck,nc->nk", mesh.vertices[corners], weights)
        first = sight.normals[at]
        shadows, found = Shadows(corners, weights, visible), first
        for _ in range(ROUNDS):
            vectors = irradiance_vectors(lights, points, found, shadows, skin_interface())
            solved = solve_normals(signal[given], vectors)
            near = np.einsum("nk,nk->n", solved, first) > WITHIN
            found = np.where(near[:, None], solved, first)
        out[index][at] = np.where(near[:, None], found, out[index][at])

    at_once = workers(PIXEL_BYTES * level.masks[0].size)
    for _ in over_views(mend, range(len(views)), at_once):
        pass
    return out


def _at(signal: np.ndarray, times: int, sight: Sighted) -> np.ndarray:
    """(n, P) signals of a sight's pixels; NaN where there is none."""
    if times == 2:
        some = np.isfinite(signal[None, :, :, :1])
        count = block_sum(some.astype(np.float32))
        mean = block_sum(np.where(some, signal[None], 0)) / np.maximum(count, 1)
        signal = np.where(count > 0, mean, np.nan)[0]
    # Views of unlike size are padded to the largest.
    height, width = signal.shape[:2]
    inside = (sight.rows < height) & (sight.columns < width)
    out = np.full((len(sight.rows), signal.shape[2]), np.nan, np.float32)
    out[inside] = signal[sight.rows[inside], sight.columns[inside]]
    return out
