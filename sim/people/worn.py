"""Hair, beard and glasses as geometry: what shadows skin, hides it, and is none."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from lightstage.formats.mesh import Mesh, vertex_normals
from sim.errors import SimError
from sim.people.subject import Subject

SIDES = 6
"""Number of sides of a tube's cross-section."""
BROWS, EYES, EARS = range(17, 27), (range(36, 42), range(42, 48)), (0, 16)
CHIN, BRIDGE, LOWER_LIP = 8, 27, 57
"""Numbers among the landmarks."""
STRANDS = 140
STRAND_MM = 0.9
"""Radius of a lock of hair."""
HAIR_OFF_MM = 4.0
"""Between the skin and the middle of the hair."""
HAIR_SPREAD_MM = 1.5
HAIR_TOP_MM, HAIR_END_MM = 45.0, 12.0
"""Above the brows: where locks begin and where they end."""
BELOW_LIP_MM = 6.0
BEARD_HAIRS = 900
BEARD_HAIR_MM = 0.4
FRAME_MM = 1.2
"""Radius of a frame's wire."""
LENS_MM = (25.0, 19.0)
"""Half width and half height of a frame."""
FRAME_OFF_MM = 14.0
"""In front of the eyes."""
POINTS = 36


def fringe(subject: Subject, seed: int) -> Mesh:
    """Locks of hair that hang over a subject's own forehead; mm, world.

    Raises:
        SimError: a subject without landmarks.
    """
    to_head = _motion(subject)
    points = _to_head(subject.mesh.vertices, to_head)
    brows = _to_head(subject.landmarks_mm[list(BROWS)], to_head)
    front = points[points[:, 2] > np.median(points[:, 2])]
    rng = np.random.default_rng([seed, 51])
    half = float(np.abs(brows[:, 0]).max())
    middle, level = brows[:, 0].mean(), float(np.median(brows[:, 1]))
    flats = []
    for x in rng.uniform(-half, half, STRANDS):
        high = np.linspace(HAIR_TOP_MM, HAIR_END_MM + rng.uniform(-4, 8), 16)
        side = x + rng.normal(0, 3) * np.linspace(0, 1, len(high)) ** 2
        flats.append(np.stack([middle + side, level + high], axis=1))
    return _to_world(tubes(_hung(front, flats, rng), STRAND_MM), to_head)


def hair_over_ear(subject: Subject, seed: int) -> Mesh:
    """Locks that hang over the ear on a subject's left; mm, world.

    Raises:
        SimError: a subject without landmarks.
    """
    to_head = _motion(subject)
    points = _to_head(subject.mesh.vertices, to_head)
    marks = _to_head(subject.landmarks_mm[list(EARS)], to_head)
    beside = marks[np.argmax(marks[:, 0])]
    rng = np.random.default_rng([seed, 52])
    flats = []
    # The ear is behind where the jaw's line begins.
    for z in rng.uniform(beside[2] - 45, beside[2] + 5, STRANDS):
        high = np.linspace(45, -30 + rng.uniform(-6, 10), 16)
        back = z + rng.normal(0, 3) * np.linspace(0, 1, len(high)) ** 2
        flats.append(np.stack([back, beside[1] + high], axis=1))
    turned = points[points[:, 0] > np.median(points[:, 0])][:, ::-1]
    paths = [path[:, ::-1] for path in _hung(turned, flats, rng)]
    return _to_world(tubes(paths, STRAND_MM), to_head)


def beard(subject: Subject, seed: int) -> Mesh:
    """Hairs that stand off chin and jaw; mm, world.

    Raises:
        SimError: a subject without landmarks.
    """
    to_head = _motion(subject)
    vertices = _to_head(subject.mesh.vertices, to_head)
    normals = vertex_normals(vertices, subject.mesh.triangles())
    marks = _to_head(subject.landmarks_mm, to_head)
    high = marks[LOWER_LIP, 1] - BELOW_LIP_MM
    there = (vertices[:, 1] < high) & (vertices[:, 1] > marks[CHIN, 1] - 5)
    there &= vertices[:, 2] > marks[CHIN, 2] - 60
    there &= np.abs(vertices[:, 0] - marks[CHIN, 0]) < 55
    rng = np.random.default_rng([seed, 53])
    roots = rng.choice(np.flatnonzero(there), BEARD_HAIRS)
    along = np.linspace(0, 1, 4)[:, None]
    paths = []
    for root in roots:
        start = vertices[root] + rng.normal(0, 0.4, 3) - 0.5 * normals[root]
        out = normals[root] * rng.uniform(4, 9)
        fall = np.array([rng.normal(0, 1.5), -rng.uniform(3, 8), 0.0])
        paths.append(start + along * out + along**2 * fall)
    return _to_world(tubes(paths, BEARD_HAIR_MM), to_head)


def _hung(
    surface: np.ndarray, flats: Sequence[np.ndarray], rng: np.random.Generator
) -> list[np.ndarray]:
    """Paths (k, 3) that lie off a surface's (n, 3) points along its third axis.

    Args:
        surface: points that bulge along the third axis.
        flats: (k, 2) paths in the first two.
        rng: of how far each lies off.
    """
    tree = cKDTree(surface[:, :2])
    paths = []
    for flat in flats:
        # The outermost of some neighbours: a lock does not dip into the skin.
        depth = surface[tree.query(flat, k=12)[1], 2].max(axis=1)
        off = HAIR_OFF_MM + rng.normal(0, HAIR_SPREAD_MM / 2)
        paths.append(np.column_stack([flat, depth + max(off, 2 * STRAND_MM)]))
    return paths


def glasses(subject: Subject) -> Mesh:
    """A thin frame before a subject's own eyes, with bridge and temples; mm, world.

    Raises:
        SimError: a subject without landmarks.
    """
    to_head = _motion(subject)
    marks = _to_head(subject.landmarks_mm, to_head)
    eyes, front, rims = _rims(marks)
    paths, ears = list(rims), sorted((marks[ear] for ear in EARS), key=lambda ear: ear[0])
    for eye, ear in zip(eyes, ears, strict=True):
        outward = np.sign(ear[0])
        hinge = np.array([eye[0] + outward * LENS_MM[0], eye[1] + 4, front])
        # Past the widest place of the head, to above the ear.
        behind = np.array([ear[0] + 5 * outward, eye[1] + 4, ear[2] - 15])
        bend = np.array([behind[0], hinge[1], hinge[2] - 6])
        paths.append(np.stack([hinge, bend, behind]))
    inner = [eyes[0] + (LENS_MM[0], 0, 0), eyes[1] - (LENS_MM[0], 0, 0)]
    bow = np.linspace(0, 1, 9)[:, None]
    bridge = (1 - bow) * inner[0] + bow * inner[1]
    bridge[:, 1] += 4 * np.sin(np.pi * bow[:, 0])
    bridge[:, 2] = np.maximum(front, marks[BRIDGE, 2] + 3)
    return _to_world(tubes([*paths, bridge], FRAME_MM), to_head)


def dark_lenses(subject: Subject) -> Mesh:
    """Opaque discs in the rims of `glasses`; mm, world.

    Raises:
        SimError: a subject without landmarks.
    """
    to_head = _motion(subject)
    _, _, rims = _rims(_to_head(subject.landmarks_mm, to_head))
    rims = rims[:, :-1]
    middles = rims.mean(axis=1, keepdims=True)
    vertices = np.concatenate([rims, middles], axis=1).reshape(-1, 3)
    at = np.arange(POINTS)
    fan = np.stack([np.full(POINTS, POINTS), at, (at + 1) % POINTS], axis=1)
    faces = np.concatenate([fan, fan + POINTS + 1]).astype(np.int32)
    return _to_world(Mesh(vertices, faces), to_head)


def _rims(marks: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
    """(2, 3) eyes by x, the lenses' plane before them, (2, POINTS + 1, 3) closed rims; head."""
    eyes = np.array(sorted((marks[list(eye)].mean(axis=0) for eye in EYES), key=lambda eye: eye[0]))
    front = float(eyes[:, 2].max()) + FRAME_OFF_MM
    turn = np.linspace(0, 2 * np.pi, POINTS + 1)
    rim = np.stack([LENS_MM[0] * np.cos(turn), LENS_MM[1] * np.sin(turn), 0 * turn], axis=1)
    middles = np.column_stack([eyes[:, 0], eyes[:, 1] - 3, np.full(2, front)])
    return eyes, front, rim + middles[:, None]


def tubes(paths: Sequence[np.ndarray], radius_mm: float) -> Mesh:
    """Tubes along paths, closed at both ends, their faces outward.

    Args:
        paths: (k, 3) mm each, k at least 2, no two neighbours in one place.
        radius_mm: of all.
    """
    vertices, faces, count = [], [], 0
    turn = 2 * np.pi * np.arange(SIDES) / SIDES
    for path in paths:
        along = np.gradient(np.asarray(path, float), axis=0)
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        # Across the whole path's least extent, so that the cross-section does not twist.
        away = np.linalg.svd(path - path.mean(axis=0))[2][-1]
        first = np.cross(along, away)
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        second = np.cross(along, first)
        ring = np.cos(turn)[:, None, None] * first + np.sin(turn)[:, None, None] * second
        rings = path[:, None] + radius_mm * np.moveaxis(ring, 0, 1)
        vertices += [rings.reshape(-1, 3), path[[0, -1]]]
        last, at = len(path) - 1, np.arange(SIDES)
        near = (np.arange(last)[:, None] * SIDES + at).ravel() + count
        beside = (np.arange(last)[:, None] * SIDES + (at + 1) % SIDES).ravel() + count
        faces += [
            np.stack([near, beside, beside + SIDES], axis=1),
            np.stack([near, beside + SIDES, near + SIDES], axis=1),
        ]
        end = count + last * SIDES
        caps = count + (last + 1) * SIDES
        for start, middle, order in ((count, caps, -1), (end, caps + 1, 1)):
            cap = np.stack([start + at, start + (at + 1) % SIDES, np.full(SIDES, middle)], axis=1)
            faces.append(cap[:, ::order])
        count = caps + 2
    return Mesh(np.concatenate(vertices), np.concatenate(faces).astype(np.int32))


def _motion(subject: Subject) -> np.ndarray:
    if not np.isfinite(subject.landmarks_mm).all():
        raise SimError(f"subject {subject.name}", found="no landmarks", expected="the 68 of a face")
    return subject.head_from_world


def _to_head(points_mm: np.ndarray, to_head: np.ndarray) -> np.ndarray:
    return np.asarray(points_mm @ to_head[:, :3].T + to_head[:, 3])


def _to_world(mesh: Mesh, to_head: np.ndarray) -> Mesh:
    return Mesh((mesh.vertices - to_head[:, 3]) @ to_head[:, :3], mesh.faces)
