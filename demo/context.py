"""What the report's sections share: folders, the frontal camera, crops to the face, figures."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from demo.steps import Layout
from lightstage.formats.exr import read_exr
from lightstage.formats.files import read_json
from lightstage.formats.mesh import read_obj
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import Session, load_session
from lightstage.formats.values import read_lines
from lightstage.rig import Camera
from processing.evaluation.maps import angle_deg, picture_errors
from processing.evaluation.texels import evaluate_maps, texel_of, truth_in_atlas
from processing.rays import MeshRays
from processing.report import display_error

FRONT = "cam0"
MARGIN = 0.12
LARGEST = {
    "diffuse_albedo": 0.1,
    "ambient_occlusion": 0.3,
    "specular_albedo": 0.015,
    "diffuse_normal": 15.0,
    "specular_normal": 15.0,
}
"""The value of the brightest colour of a difference; degrees for normals."""


@dataclasses.dataclass(frozen=True)
class Relit:
    """One light set: the project's picture, the truth's, where they compare, and how."""

    name: str
    found: np.ndarray
    true: np.ndarray
    mask: np.ndarray
    errors: dict[str, float]


@dataclasses.dataclass(frozen=True)
class Demo:
    """A finished demo, read.

    Attributes:
        at: where its parts are.
        session: the simulated capture.
        coarse: views' maps before the mesh was known.
        found: the processed folder.
        truth: the truth.
        true_atlas: the truth's maps in the processed folder's atlas.
        coarse_errors: evaluation of `coarse`.
        errors: evaluation of `found`.
        inference: errors of the network's maps.
        input_errors: errors of taking the lit texture for the albedo.
        metrics: lines that the training wrote; the last holds the scores of the person held out.
        relit: one entry a light set.
        source: who made the person shown.
    """

    at: Layout
    session: Session
    coarse: ProcessedFolder
    found: ProcessedFolder
    truth: ProcessedFolder
    true_atlas: dict[str, np.ndarray]
    coarse_errors: dict[str, Any]
    errors: dict[str, Any]
    inference: dict[str, float]
    input_errors: dict[str, float]
    metrics: list[dict[str, Any]]
    relit: tuple[Relit, ...]
    source: str

    @property
    def camera(self) -> Camera:
        """The frontal camera."""
        return self.session.rig.camera(FRONT)

    def crop(self, camera: str) -> tuple[slice, slice]:
        """Rows and columns of a camera's picture around the face skin, with a margin."""
        mask = self.truth.read_mask(camera)
        rows, columns = np.nonzero(mask.any(axis=1))[0], np.nonzero(mask.any(axis=0))[0]
        if not len(rows):
            return slice(None), slice(None)
        room = int(MARGIN * (rows[-1] - rows[0] + 1))
        return (
            slice(max(0, rows[0] - room), rows[-1] + room + 1),
            slice(max(0, columns[0] - room), columns[-1] + room + 1),
        )


def read_demo(root: Path) -> Demo:
    """Read a finished demo and compute the figures that no step computed.

    Raises:
        LightstageError: a part is missing or damaged.
    """
    at = Layout(root)
    truth = ProcessedFolder(at.truth)
    session = load_session(at.session)
    skin = truth.read_mask(FRONT)
    shown = skin & captured_pixels(ProcessedFolder(at.processed), session.rig.camera(FRONT))
    true_atlas = truth_in_atlas(at.processed, at.truth)
    relit = []
    for lights in at.light_sets():
        found = read_exr(at.relit / f"{lights.stem}.exr", finite=True)
        true = read_exr(lights.with_suffix(".exr"), finite=True)
        errors = picture_errors(found, true, shown)
        errors["coverage_share"] = float(shown.sum() / skin.sum())
        relit.append(Relit(lights.stem, found, true, shown, errors))
    return Demo(
        at=at,
        session=session,
        coarse=ProcessedFolder(at.coarse),
        found=ProcessedFolder(at.processed),
        truth=truth,
        true_atlas=true_atlas,
        coarse_errors=read_json(at.coarse / "evaluation.json"),
        errors=read_json(at.processed / "evaluation.json"),
        inference=evaluate_maps(at.inferred, true_atlas),
        input_errors=_input_errors(at.baked, true_atlas),
        metrics=read_lines(at.training / "metrics.jsonl"),
        relit=tuple(relit),
        source=str(read_json(at.truth / "report.json").get("source", "")),
    )


def captured_pixels(found: ProcessedFolder, camera: Camera) -> np.ndarray:
    """(h, w) bool: pixels in which a camera sees a texel of the atlas that was captured."""
    mesh = read_obj(found.registered_mesh)
    seen = found.read_atlas("confidence") > 0
    hits = MeshRays(mesh.vertices, mesh.triangles()).cast_camera(camera)
    there = hits.face >= 0
    assert mesh.uvs is not None  # registration writes the template's
    corners = mesh.uvs[mesh.triangle_uvs()[hits.face[there]]]
    uv = np.einsum("nck,nc->nk", corners, hits.barycentric[there])
    out = np.zeros(len(there), bool)
    out[there] = seen[texel_of(uv, *seen.shape)]
    return out.reshape(camera.height_px, camera.width_px)


def _input_errors(baked: Path, truth: Mapping[str, np.ndarray]) -> dict[str, float]:
    """What the lit texture itself would score as a diffuse albedo."""
    skin = truth["confidence"] > 0
    return picture_errors(read_exr(baked, finite=True), truth["diffuse_albedo"], skin)


def show_difference(name: str, found: np.ndarray, true: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """The error of a map in colours, up to `LARGEST`."""
    if name.endswith("_normal"):
        error = angle_deg(found.reshape(-1, 3), true.reshape(-1, 3)).reshape(mask.shape)
    else:
        error = abs(found - true).reshape(*mask.shape, -1).mean(axis=2)
    return display_error(error, LARGEST[name], mask)
