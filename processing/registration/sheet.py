"""A mesh prepared for non-rigid ICP: the template, or its coarse form at coarse stiffnesses."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial import cKDTree

from processing.registration.coarse import Coarse
from processing.registration.config import GateConfig, PlateConfig
from processing.registration.matches import Matcher
from processing.registration.plate import Plate, Springs
from processing.registration.target import Target


@dataclasses.dataclass(frozen=True)
class Sheet:
    """A mesh, its plate and its matcher.

    Attributes:
        rest: (n, 3) mm.
        target: the scan.
        plate: on `rest`.
        matcher: of `rest` on the scan.
        allowed: (n,) bool, vertices that may follow the scan.
        hidden: (n,) bool, vertices that follow cavities of it only.
        stiff: (n,) bool, vertices that follow its coarse shape only.
        marks: (m,) indices of the landmarks' vertices.
        settings: of plate and gates.
    """

    rest: np.ndarray
    target: Target
    plate: Plate
    matcher: Matcher
    allowed: np.ndarray
    hidden: np.ndarray
    stiff: np.ndarray
    marks: np.ndarray
    settings: tuple[PlateConfig, GateConfig]

    @classmethod
    def of(
        cls,
        rest: np.ndarray,
        triangles: np.ndarray,
        target: Target,
        marks: np.ndarray,
        plate: PlateConfig,
        gate: GateConfig,
        *,
        allowed: np.ndarray,
        hidden: np.ndarray,
        stiff: np.ndarray,
    ) -> Sheet:
        """Prepare a mesh, (n, 3) mm and (t, 3); the rest as in the attributes."""
        far = np.asarray(cKDTree(rest[marks]).query(rest)[0]) if len(marks) else None
        return cls(
            rest,
            target,
            Plate(rest, triangles, plate),
            Matcher(triangles, target, hidden, gate, far),
            allowed,
            hidden,
            stiff,
            marks,
            (plate, gate),
        )

    def coarsened(self, coarse: Coarse) -> Sheet:
        """The same with the vertices of `coarse` alone."""
        some = coarse.chosen
        return Sheet.of(
            self.rest[some],
            coarse.triangles,
            self.target,
            coarse.patch[self.marks],
            *self.settings,
            allowed=self.allowed[some],
            hidden=self.hidden[some],
            stiff=self.stiff[some],
        )

    def carried(self, coarse: Coarse, moved: np.ndarray, cell_mm: float) -> np.ndarray:
        """Displacements of this mesh from those of its coarse vertices: its plate, held there.

        Args:
            coarse: of this mesh.
            moved: (k, 3) mm of the coarse vertices.
            cell_mm: their distance.

        Returns:
            (n, 3) mm.
        """
        springs = Springs.none(len(self.rest))
        # Each represents its patch, so all are held alike.
        held = cell_mm**2 * np.tile(np.eye(3), (len(coarse.chosen), 1, 1))
        springs.add(coarse.chosen, held, moved)
        self.plate.stiffen(cell_mm / 2, springs)
        return self.plate.solve(springs, moved[coarse.patch])
