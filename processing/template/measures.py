"""Measures of a head by callipers and tape, as surveys have them, on any template's vertices.

Places are found once, on the template's mean head, by its landmarks and regions; a breadth is that
of the widest pair among them, an arc the convex outline of a plane's cut through the head, as a
tape lies. Definitions follow [Zhuang2005] as far as a surface shows what they name: sellion is the
deepest place of the nose's root, menton the lowest of the chin, tragion the front of the ear at
three fifths of its height.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull

from lightstage.formats.mesh import vertex_normals
from lightstage.formats.template import Template
from processing.errors import ProcessingError
from processing.template.surveys import NAMES

MIDDLE_MM = 2.5
"""Vertices so near to the plane between left and right are in the middle."""
ABOVE_GLABELLA_MM = 12.0
"""So far above the glabella the tape crosses the forehead."""


class HeadMeasures:
    """Places at which a template is measured."""

    def __init__(self, template: Template, mean_mm: np.ndarray) -> None:
        """Find the places.

        Args:
            template: with the region ``ears``.
            mean_mm: (n, 3) a head in its topology and in the head frame, such as the mean.

        Raises:
            ProcessingError: no ears, or no vertices at a place.
        """
        self._landmarks, self._triangles = template.landmarks, template.mesh.triangles()
        marks, used = mean_mm[template.landmarks], np.zeros(len(mean_mm), bool)
        used[self._triangles] = True
        ears, eyes = np.zeros_like(used), np.zeros_like(used)
        ears[template.regions.get("ears", np.zeros(0, int))] = True
        eyes[template.regions.get("eyes", np.zeros(0, int))] = True
        x, y, z = mean_mm.T
        self._tragions = [
            _tragion(template, template.mesh.vertices, ears & (side * x > 0)) for side in (1, -1)
        ]
        middle = used & ~eyes & (np.abs(x) < MIDDLE_MM)
        front = middle & (z > marks[36, 2] - 5)
        near = [np.linalg.norm(mean_mm - marks[each], axis=1) for each in range(len(marks))]
        normals = vertex_normals(mean_mm, self._triangles)
        sideways = normals[:, 0] * np.sign(x) > 0.75
        brow, tragion = marks[17:27, 1].mean(), mean_mm[self._tragions, 2].mean()
        places = {
            "sellion": front & (y < (marks[21, 1] + marks[27, 1]) / 2 + 4) & (y > marks[28, 1] - 2),
            "glabella": front & (np.abs(y - marks[21:23, 1].mean() - 3) < 10),
            "back": middle & (z < -20) & (y > marks[30, 1]),
            "top": used & (y > brow + 40),
            "crown": used & ~ears & (y > brow + 8),
            "cheeks": used
            & ~ears
            & (z > tragion + 15)
            & (y < marks[36, 1] + 5)
            & (y > marks[33, 1] - 5),
            "jaw": used
            & ~ears
            & (np.abs(y - marks[57, 1]) < 12)
            & (z > marks[[4, 12], 2].mean() - 8),
            "menton": middle & (near[8] < 12) & (z > marks[8, 2] - 6),
            "chin": middle
            & (y < marks[57, 1] - 6)
            & (y > marks[8, 1] - 6)
            & (z > marks[8, 2] - 12),
            "tip": middle & (near[30] < 10),
            "wings": used
            & sideways
            & (np.minimum(near[31], near[35]) < 15)
            & (np.abs(x) < 30)
            & (y > marks[33, 1] - 4),
        }
        self._places = {name: np.flatnonzero(place) for name, place in places.items()}
        lost = [name for name, place in self._places.items() if not len(place)]
        if lost:
            raise ProcessingError(
                template.name,
                field="landmarks",
                found=f"no vertices at {', '.join(lost)}",
                expected="a head with landmarks in iBUG's order, in the head frame",
            )

    def of(self, vertices: np.ndarray) -> np.ndarray:
        """(q,) measures in mm, in the order of `NAMES`, of a head of (n, 3) vertices."""
        marks, at = vertices[self._landmarks], self._places

        def extreme(place: str, axis: int, sign: float) -> np.ndarray:
            among = vertices[at[place]]
            found: np.ndarray = among[(sign * among[:, axis]).argmax()]
            return found

        def farthest(place: str, away: np.ndarray) -> np.ndarray:
            among = vertices[at[place]]
            found: np.ndarray = among[np.linalg.norm(among - away, axis=1).argmax()]
            return found

        sellion, glabella = extreme("sellion", 2, -1), extreme("glabella", 2, 1)
        back, menton = farthest("back", glabella), farthest("menton", sellion)
        subnasale, mouth = marks[33], marks[[62, 66]].mean(axis=0)
        left, right = vertices[self._tragions]
        between = (left + right) / 2
        crown = _breadth(vertices[at["crown"]])
        eyes = marks[36:42].mean(axis=0), marks[42:48].mean(axis=0)
        found = {
            "head length": _apart(glabella, back),
            "head breadth": crown,
            "head circumference": self._around(vertices, glabella, back, crown),
            "tragion to top of head": float(extreme("top", 1, 1)[1] - between[1]),
            "bizygomatic breadth": _breadth(vertices[at["cheeks"]]),
            "bigonial breadth": _breadth(vertices[at["jaw"]]),
            "menton to sellion": _apart(menton, sellion),
            "subnasale to sellion": _apart(subnasale, sellion),
            "nose protrusion": _apart(extreme("tip", 2, 1), subnasale),
            "nose breadth": _breadth(vertices[at["wings"]]),
            "lip length": _apart(marks[48], marks[54]),
            "interpupillary distance": _apart(*eyes),
            "biocular breadth": _apart(marks[36], marks[45]),
            "intercanthal breadth": _apart(marks[39], marks[42]),
            "subnasale to menton": _apart(subnasale, menton),
            "upper lip's height": _apart(subnasale, mouth),
            "upper vermilion": _apart(marks[51], marks[62]),
            "lower vermilion": _apart(marks[57], marks[66]),
            "bitragion chin arc": self._arc(vertices, left, right, extreme("chin", 2, 1)),
            "bitragion subnasale arc": self._arc(vertices, left, right, subnasale),
            "bitragion frontal arc": self._arc(
                vertices, left, right, glabella + np.array([0, ABOVE_GLABELLA_MM, 0])
            ),
            "bitragion coronal arc": self._arc(
                vertices, left, right, between + np.array([0, 150.0, 0])
            ),
        }
        return np.array([found[name] for name in NAMES])

    def gradient(self, vertices: np.ndarray, modes: np.ndarray, step: float = 0.5) -> np.ndarray:
        """(q, k) change of the measures with each of (k, n, 3) modes, mm a unit."""
        sides = [(self.of(vertices + step * m), self.of(vertices - step * m)) for m in modes]
        return np.stack([(one - other) / (2 * step) for one, other in sides], axis=1)

    def _cut(self, vertices: np.ndarray, point: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """(m, 3) where the mesh's edges cross a plane."""
        height = (vertices - point) @ normal
        ends = np.concatenate([self._triangles[:, pair] for pair in ([0, 1], [1, 2], [2, 0])])
        one, other = ends[height[ends[:, 0]] * height[ends[:, 1]] < 0].T
        share = height[one] / (height[one] - height[other])
        found: np.ndarray = vertices[one] + share[:, None] * (vertices[other] - vertices[one])
        return found

    def _around(
        self, vertices: np.ndarray, front: np.ndarray, back: np.ndarray, breadth: float
    ) -> float:
        """Circumference through two places in the middle, level from side to side, without ears."""
        along = (back - front) / np.linalg.norm(back - front)
        normal = np.cross(along, [1.0, 0.0, 0.0])
        cut = self._cut(vertices, front, normal / np.linalg.norm(normal))
        flat = np.stack([cut[:, 0], (cut - front) @ along], axis=1)
        return float(ConvexHull(flat[np.abs(flat[:, 0]) < breadth / 2 + 1]).area)

    def _arc(
        self, vertices: np.ndarray, start: np.ndarray, end: np.ndarray, through: np.ndarray
    ) -> float:
        """Length of a tape from one place to another in the plane through a third."""
        straight = np.linalg.norm(end - start)
        along = (end - start) / straight
        out = through - start - ((through - start) @ along) * along
        out = out / np.linalg.norm(out)
        cut = self._cut(vertices, start, np.cross(along, out)) - start
        flat = np.stack([cut @ along, cut @ out], axis=1)
        ends = [[0.0, 0.0], [straight, 0.0]]
        hull = ConvexHull(np.concatenate([flat[flat[:, 1] > 0], ends]))
        return float(hull.area - straight)


def _apart(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.linalg.norm(one - other))


def _breadth(points: np.ndarray) -> float:
    return float(np.ptp(points[:, 0]))


def _tragion(template: Template, vertices: np.ndarray, ear: np.ndarray) -> int:
    """The vertex at the front of an ear, (n,) bool."""
    height = vertices[ear, 1]
    if not len(height):
        raise ProcessingError(
            template.name,
            field="regions.ears",
            found="no ear on one side",
            expected="both, between which heads are measured",
        )
    share = (vertices[:, 1] - height.min()) / max(np.ptp(height), 1e-9)
    band = np.flatnonzero(ear & (share > 0.5) & (share < 0.66))
    return int(band[vertices[band, 2].argmax()])
