"""A known person of ICT's topology as a noisy scan, with landmarks: what registration is scored on.

No mode of the model reaches the method under test, so every person is outside its span.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from lightstage.formats.mesh import Mesh, vertex_normals
from lightstage.formats.template import Template
from sim.scans.ict import IctModel, ict_folder, load_ict
from sim.scans.ict_subject import LARGEST_DRAW, blend

COUNT = 11_248
"""Face, head and neck; behind them come mouth, teeth and eyes."""
FACE = 9_409
"""Of those the face; head and neck follow."""
HOLES = 12
HOLE_MM = 8.0
OUTLIER_MM = 5.0


@dataclasses.dataclass(frozen=True)
class Case:
    """A template, a scan and the truth.

    Attributes:
        template: without modes.
        truth: (n, 3) mm where each of the template's vertices should go.
        scan: noisy triangles.
        clean: the same surface without noise and holes, the truth of the surface.
        landmarks_mm: (68, 3), NaN where missing.
    """

    template: Template
    truth: np.ndarray
    scan: Mesh
    clean: Mesh
    landmarks_mm: np.ndarray


def model() -> IctModel:
    """ICT Face Model Light; ends the program with a reason where it is absent."""
    folder = ict_folder()
    if folder is None:
        raise SystemExit("ICT Face Model Light is not at ../shared/data (or LIGHTSTAGE_DATA)")
    return load_ict(folder)


def ict_template(ict: IctModel) -> Template:
    """The neutral head's skin as a template without modes."""
    faces = ict.mesh.faces
    mesh = Mesh(ict.mesh.vertices[:COUNT], faces[faces.max(axis=1) < COUNT])
    skin = np.arange(FACE)
    return Template("ict", mesh, ict.landmarks, {"skin": skin}, "", "", modes=None)


def make_case(
    ict: IctModel,
    seed: int,
    *,
    expression: str = "smile",
    noise_mm: float = 0.05,
    missing_share: float = 0.0,
    outliers: int = 0,
    holes: int = 0,
) -> Case:
    """A person of the model in a pose, scanned.

    Args:
        ict: the model.
        seed: of identity, pose, noise and what is taken away.
        expression: as `sim.scans.ict_subject.blend` names it.
        noise_mm: of the scan's vertices along their normals.
        missing_share: of the landmarks.
        outliers: so many landmarks are 5 mm off.
        holes: so many discs of 16 mm are cut from the scan.
    """
    rng = np.random.default_rng([seed, 7])
    weights = np.clip(rng.normal(size=len(ict.identity)), -LARGEST_DRAW, LARGEST_DRAW)
    person = ict.mesh.vertices + np.tensordot(weights, ict.identity, axes=1)
    person = person + blend(ict, expression, person)
    turn = Rotation.from_rotvec(np.deg2rad(8) * rng.normal(size=3)).as_matrix()
    truth = person[:COUNT] @ turn.T + 15 * rng.normal(size=3)
    template = ict_template(ict)
    clean = split(truth, template.mesh.triangles(), rng)
    normals = vertex_normals(clean.vertices, clean.faces)
    noise = noise_mm * rng.normal(size=(len(normals), 1))
    vertices, faces = clean.vertices + noise * normals, clean.faces
    centres = rng.choice(truth[:FACE], holes, replace=False) if holes else np.zeros((0, 3))
    for centre in centres:
        middle = vertices[faces].mean(axis=1)
        faces = faces[np.linalg.norm(middle - centre, axis=1) > HOLE_MM]
    marks = truth[template.landmarks].copy()
    order = rng.permutation(len(marks))
    missing = round(missing_share * len(marks))
    marks[order[:missing]] = np.nan
    for index in order[missing : missing + outliers]:
        away = rng.normal(size=3)
        marks[index] += OUTLIER_MM * away / np.linalg.norm(away)
    return Case(template, truth, Mesh(vertices, faces), clean, marks)


def split(vertices: np.ndarray, triangles: np.ndarray, rng: np.random.Generator) -> Mesh:
    """The same surface in four times as many triangles, its edges cut off their middles."""
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    unique, place = np.unique(edges, axis=0, return_inverse=True)
    share = rng.uniform(0.3, 0.7, size=(len(unique), 1))
    middle = place.reshape(-1, 3) + len(vertices)
    cut = vertices[unique[:, 0]] * (1 - share) + vertices[unique[:, 1]] * share
    a, b, c = triangles.T
    ab, bc, ca = middle.T
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    faces = np.concatenate([np.stack(part, axis=1) for part in parts])
    return Mesh(np.concatenate([vertices, cut]), faces.astype(np.int32))
