"""What of a captured atlas is skin: eyes, teeth and hair stay out, with any template's regions."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.template import Template, default_template_path, load_template
from processing.atlas.config import AtlasConfig
from processing.atlas.geometry import Geometry
from processing.atlas.skin import skin_vertices
from processing.atlas.stage import atlas
from processing.dataset import build_store, open_store
from tests.processing.test_atlas_stage import capture

ROWS = 384
MARGIN_MM = AtlasConfig().skin_margin_mm


@pytest.fixture(scope="module")
def template() -> Template:
    return load_template(default_template_path())


def with_regions(template: Template, names: tuple[str, ...]) -> Template:
    kept = {name: chosen for name, chosen in template.regions.items() if name in names}
    return dataclasses.replace(template, regions=kept)


@pytest.mark.parametrize(
    "names",
    [("skin", "lips", "eyes", "ears", "hair"), ("lips", "eyes", "ears", "hair"), ("eyes",), ()],
)
def test_eyes_and_the_opening_of_the_mouth_are_no_skin_whatever_regions_a_template_names(
    template: Template, names: tuple[str, ...]
) -> None:
    skin = skin_vertices(with_regions(template, names), MARGIN_MM)
    assert not skin[template.regions["eyes"]].any()
    assert not skin[template.landmarks[36:48]].any()
    assert not skin[template.landmarks[60:68]].any()
    if "hair" in names:
        assert not skin[template.regions["hair"]].any()
    assert skin[template.regions["skin"]].mean() > 0.97
    assert skin[template.regions["lips"]].mean() > 0.6


def test_the_margin_holds_in_millimetres_on_the_templates_mesh(template: Template) -> None:
    skin = skin_vertices(template, 5.0)
    eyes = template.mesh.vertices[template.regions["eyes"]]
    left = template.mesh.vertices[skin]
    nearest = min(np.linalg.norm(eyes - point, axis=1).min() for point in left)
    assert 5.0 < nearest < 8.0


def test_a_triangle_with_one_corner_in_an_eye_shows_no_skin(template: Template) -> None:
    shape = Geometry.of(template.mesh, ROWS)
    whole = shape.whole(skin_vertices(template, 0.0))
    eyes = np.zeros(len(shape.vertices))
    eyes[template.regions["eyes"]] = 1
    assert whole.any()
    assert not shape.at(eyes[:, None])[whole].any()


def test_eyes_of_a_captured_person_are_not_measured_skin_in_the_store(tmp_path) -> None:
    session, out, template = capture(tmp_path)
    front = np.argsort(-template.mesh.vertices[:, 2])[:40]
    skin = np.setdiff1d(template.regions["skin"], front)
    template = dataclasses.replace(template, regions={"skin": skin, "eyes": front})
    atlas(session, out.root, template, AtlasConfig(rows=96))
    assert isinstance(out, ProcessedFolder)
    out.head_pose.write_text('{"head_from_world": [[1,0,0,0],[0,1,0,0],[0,0,1,0]]}')
    (out.root / "report.json").write_text('{"subject": "s", "expression": "neutral"}')
    store = open_store(build_store([out.root], tmp_path / "store"))
    stored = store.read(0, "confidence", slice(None), slice(None))[:, :, 0]
    shown = out.read_atlas("confidence")
    masked = (stored == 0) & (shown > 0)
    distance = np.linalg.norm(
        out.read_atlas("position")[:, :, None] - template.mesh.vertices[front], axis=3
    ).min(axis=2)
    assert masked[(distance < 1.0) & (shown > 0)].all()
    assert 0.001 < masked.mean() < 0.2
    assert stored[~masked].max() == pytest.approx(shown.max(), rel=1e-3)
