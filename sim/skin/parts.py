"""A face to be painted: where each texel of a texture is on the head, worked on in strips.

A texture of 6144 x 4096 has 25 million texels, so nothing but the results is held at full size:
the painter goes from strip to strip of rows. Smooth noise is evaluated on fewer texels and
enlarged; each strip reads one more of them beyond its edges, so strips leave no trace.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator

import cv2
import numpy as np
from scipy import ndimage

from sim.errors import SimError
from sim.head.grid import (
    COLUMNS,
    MOUTH_HALF_DEG,
    ROW_MOUTH,
    ROWS,
    face_azimuth_deg,
    smoothstep,
)
from sim.head.maps import at_grid, grid_window, to_window
from sim.head.mesh import neutral_mesh, row_and_column
from sim.skin.noise import cell_noise, octaves
from sim.skin.places import PLACE_COLUMNS, PLACE_ROWS, canonical, place_masks

TILE_HEIGHT_MM = 400.0
"""About the height of the face's part of our tile, were all of it as dense."""
STRIP_TEXELS = 1 << 20
"""Texels of one strip; a map of them takes 4 MB."""


@dataclasses.dataclass(frozen=True)
class Face:
    """Where each texel is on the head.

    Attributes:
        rows: of the texture.
        columns: of the texture.
        seed: of all noise.
        texel_mm: size of a texel on the face.
        position: (rows, columns, 3) float32 mm in the head frame: noise lives on it, so that pores
            and hairs have their size in mm on that surface. None: our own tile's neutral head.
        grid_uv: (rows, columns, 2) float32 place in our vertex grid (`grid_places`): masks and all
            drawn things are looked up there. None: the texture is our own tile.
        covered: (rows, columns) bool, texels on the head. None: all.
    """

    rows: int
    columns: int
    seed: int
    texel_mm: float
    position: np.ndarray | None = None
    grid_uv: np.ndarray | None = None
    covered: np.ndarray | None = None

    def strips(self) -> Iterator[Patch]:
        """All texels in strips of whole rows, from the top."""
        height = max(8, STRIP_TEXELS // self.columns)
        for first in range(0, self.rows, height):
            yield Patch(self, first, min(first + height, self.rows))

    def positions(self, first: int, last: int, step: int) -> np.ndarray:
        """(last - first, ceil(columns / step), 3) mm on the texture shrunk by `step`."""
        rows, columns = -(-self.rows // step), -(-self.columns // step)
        if self.position is None:
            return to_window(neutral_mesh().vertices, rows, columns, first, last)
        if step == 1:
            return np.asarray(self.position[first:last])
        part = self.position[first * step : last * step]
        return np.asarray(cv2.resize(part, (columns, last - first), interpolation=cv2.INTER_AREA))


class Patch:
    """A strip of a face's rows.

    Attributes:
        rows: the slice of the texture.
        position: (h, columns, 3) float32 mm, where noise lives.
        reference: (h, columns, 3) float32 mm, the same places on our own neutral head.
        row: (h, columns) float32 row of our vertex grid.
        column: (h, columns) float32 its column.
    """

    def __init__(self, face: Face, first: int, last: int) -> None:
        self.face = face
        self.rows = slice(first, last)
        self.position = face.positions(first, last, 1)
        if face.grid_uv is None:
            self.row, self.column = grid_window(face.rows, face.columns, first, last)
            self.reference = self.position
        else:
            self.row, self.column = row_and_column(face.grid_uv[first:last])
            self.reference = at_grid(neutral_mesh().vertices, self.row, self.column)
        self._place: np.ndarray | None = None
        self._masks: dict[str, np.ndarray] = {}

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the strip."""
        return self.row.shape[0], self.row.shape[1]

    @property
    def place(self) -> np.ndarray:
        """(h, columns, 3) float32 mm on the fixed face, x not negative (`canonical`)."""
        if self._place is None:
            self._place = canonical(self.reference)
        return self._place

    def azimuth_deg(self) -> np.ndarray:
        """(h, columns) float32 how far from the middle of the face the grid's column is."""
        table = np.abs(face_azimuth_deg())
        found = np.interp(self.column, np.arange(len(table)), table)
        return np.asarray(found, np.float32)

    def mouth_inside(self) -> np.ndarray:
        """(h, columns) 0..1, what is between the lips: a line when they are closed."""
        between = smoothstep(1.05, 0.75, np.abs(self.row - ROW_MOUTH))
        if not between.any():
            return between
        return between * smoothstep(0.96, 0.86, self.azimuth_deg() / MOUTH_HALF_DEG)

    def mask(self, name: str) -> np.ndarray:
        """(h, columns) float32, one of `skin_places.place_masks`."""
        if name not in self._masks:
            x = self.column * np.float32(PLACE_COLUMNS / COLUMNS) - np.float32(0.5)
            y = self.row * np.float32(PLACE_ROWS / ROWS) - np.float32(0.5)
            source = place_masks()[name]
            self._masks[name] = cv2.remap(
                source, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
            )
        return self._masks[name]

    def noise(self, cell_mm: float, count: int, salt: int) -> np.ndarray:
        """(h, columns) smooth noise of unit deviation; `salt` separates fields."""
        return self.noise_of(lambda p: p, cell_mm, count, salt)

    def noise_of(
        self,
        points: Callable[[np.ndarray], np.ndarray],
        cell_mm: float,
        count: int,
        salt: int,
    ) -> np.ndarray:
        """The same at other points, a function of places (..., 3): stretched or bent noise."""
        finest_mm = cell_mm / 2 ** (count - 1)
        step = self._step(finest_mm / 2.8)

        def values(place: np.ndarray) -> np.ndarray:
            bent = np.ascontiguousarray(points(place), np.float32)
            return octaves(bent, cell_mm, count, self.face.seed + 1009 * salt)

        return self._enlarged(values, step)

    def on_fewer(self, values: Callable[[np.ndarray], np.ndarray], sample_mm: float) -> np.ndarray:
        """(h, columns) a smooth function of places (k, l, 3) mm to (k, l), then enlarged.

        Args:
            values: the function.
            sample_mm: how far apart it may be evaluated.
        """
        return self._enlarged(values, self._step(sample_mm))

    def cells(self, cell_mm: float, salt: int) -> tuple[np.ndarray, np.ndarray]:
        """(h, columns) distance in mm to scattered points, and a number 0..1 of each point."""
        flat = np.ascontiguousarray(self.position.reshape(-1, 3))
        distance, label = cell_noise(flat, cell_mm, self.face.seed + 1009 * salt)
        return distance.reshape(self.shape), label.reshape(self.shape)

    def pits(
        self, cell_mm: float, salt: int, shape: Callable[[np.ndarray, np.ndarray], np.ndarray]
    ) -> np.ndarray:
        """(h, columns) a smooth function of the distance and number of `cells`.

        It is evaluated on fewer texels where an eleventh of a cell allows it.
        """
        return self.pits_of(lambda p: p, cell_mm, salt, shape)

    def pits_of(
        self,
        points: Callable[[np.ndarray], np.ndarray],
        cell_mm: float,
        salt: int,
        shape: Callable[[np.ndarray, np.ndarray], np.ndarray],
    ) -> np.ndarray:
        """The same at other points, a function of places (..., 3)."""

        def values(place: np.ndarray) -> np.ndarray:
            flat = np.ascontiguousarray(points(place).reshape(-1, 3), np.float32)
            found = cell_noise(flat, cell_mm, self.face.seed + 1009 * salt)
            distance, label = (part.reshape(place.shape[:2]) for part in found)
            return shape(distance, label).astype(np.float32)

        return self.on_fewer(values, cell_mm / 11)

    def _step(self, sample_mm: float) -> int:
        ratio = sample_mm / self.face.texel_mm
        return next((step for step in (16, 8, 4, 2) if ratio >= step), 1)

    def _enlarged(self, values: Callable[[np.ndarray], np.ndarray], step: int) -> np.ndarray:
        """Values of the shrunk texture's texels, enlarged onto this strip."""
        face = self.face
        if step == 1:
            return values(self.position)
        coarse_rows, coarse_columns = -(-face.rows // step), -(-face.columns // step)
        y = (np.arange(self.rows.start, self.rows.stop) + 0.5) * (coarse_rows / face.rows) - 0.5
        first = max(int(np.floor(y[0])) - 2, 0)
        last = min(int(np.ceil(y[-1])) + 3, coarse_rows)
        found = values(face.positions(first, last, step))
        x = (np.arange(face.columns) + 0.5) * (coarse_columns / face.columns) - 0.5
        map_x, map_y = np.meshgrid(x.astype(np.float32), (y - first).astype(np.float32))
        return cv2.remap(found, map_x, map_y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)


def face_of(rows: int, columns: int, seed: int) -> Face:
    """The base head on its own tile of this size; `seed` chooses the noise."""
    return Face(rows, columns, seed, TILE_HEIGHT_MM / rows)


def face_from(
    positions_mm: np.ndarray, grid_uv: np.ndarray, covered: np.ndarray, seed: int
) -> Face:
    """A face on any head's texture, so that our skin can be painted on it.

    Two things are needed for each texel: where it is on the head that is to be painted, and
    which place of our own head that is. The first carries noise (pores stay round and of their
    size in mm), the second all masks and drawn things (lips are on the lips, hair on the scalp).
    A registration by landmarks gives the second: the place in our grid of the nearest point of our
    base head fitted to it. `sim.skin.paint.make_skin` paints the result; for normals see
    `sim.skin.relief.bend_normals`.

    Args:
        positions_mm: (rows, columns, 3), in our head frame, mm (face toward +z, y up); the neutral
            expression for every expression of a person, so that the skin stays on the face.
        grid_uv: (rows, columns, 2), the place of the same point in our vertex grid, as
            `sim.head.mesh.grid_places` has them.
        covered: (rows, columns) bool, texels that are on the head; the others are filled from the
            nearest covered texel and may hold anything, NaN too.
        seed: chooses the noise.

    Returns:
        What `make_skin` takes.

    Raises:
        SimError: shapes differ, nothing is covered, or a covered texel is not finite or is
            outside the grid by more than a thousandth.
    """
    positions, places = np.asarray(positions_mm, np.float32), np.asarray(grid_uv, np.float32)
    mask = np.asarray(covered, bool)
    shapes = (positions.shape, places.shape)
    if mask.ndim != 2 or shapes != ((*mask.shape, 3), (*mask.shape, 2)):
        raise SimError(
            "face",
            found=f"shapes {positions.shape}, {places.shape}, {mask.shape}",
            expected="(rows, columns, 3), (rows, columns, 2), (rows, columns)",
        )
    if not mask.any():
        raise SimError("face", field="covered", found="no texel", expected="a head")
    if not (np.isfinite(positions[mask]).all() and np.isfinite(places[mask]).all()):
        raise SimError("face", found="NaN in a covered texel", expected="finite places")
    if places[mask].min() < -1e-3 or places[mask].max() > 1.001:
        raise SimError(
            "face", field="grid_uv", found="outside 0..1", expected="places of our vertex grid"
        )
    if not mask.all():
        nearest = ndimage.distance_transform_edt(~mask, return_distances=False, return_indices=True)
        positions, places = positions[tuple(nearest)], places[tuple(nearest)]
    across = np.linalg.norm(np.diff(positions, axis=1), axis=-1)[mask[:, 1:] & mask[:, :-1]]
    down = np.linalg.norm(np.diff(positions, axis=0), axis=-1)[mask[1:] & mask[:-1]]
    steps = np.concatenate([across, down])
    texel_mm = float(np.median(steps)) if len(steps) else 1.0
    rows, columns = mask.shape
    return Face(rows, columns, seed, max(texel_mm, 1e-3), positions, places, mask)
