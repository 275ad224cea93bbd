"""A simulated person, not trained on, and photographs of them with faces found by hand."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from learning.maps import load_head
from learning.photo.config import FitConfig
from learning.photo.model import ShapeModel, shape_model
from learning.photo.shape_fit import Places, detector_places
from learning.relight import render_head, shadows_of
from lightstage.formats.mesh import read_mesh
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.template import Template, default_template_path, load_template
from processing.colour import srgb_from_linear
from tests.learning.photo.scene import KEY, SMALL, Shot, camera_at, on


@pytest.fixture(scope="session")
def template() -> Template:
    return load_template(default_template_path())


@pytest.fixture(scope="session")
def model(template: Template) -> ShapeModel:
    return shape_model(template, FitConfig())


@pytest.fixture(scope="session")
def small(template: Template) -> ShapeModel:
    """The model of `SMALL`."""
    return shape_model(template, SMALL)


@pytest.fixture(scope="session")
def places(template: Template) -> Places:
    """The detector's points, as far as the template has them."""
    found = detector_places(template)
    assert found is not None
    return found[0]


@pytest.fixture(scope="session")
def shot(
    strangers: list[Path],
    template: Template,
    places: Places,
    tmp_path_factory: pytest.TempPathFactory,
) -> Shot:
    """A person in front of a dark wall, from 15 degrees at the side."""
    person = ProcessedFolder(strangers[0])
    mesh = read_mesh(person.registered_mesh)
    head = load_head(person.root / "atlas", mesh, template)
    camera = camera_at(15.0)
    rgb, _ = render_head(head, KEY, camera, 0.02, seen=shadows_of(head, KEY))
    path = tmp_path_factory.mktemp("photo") / "person one.png"
    cv2.imwrite(str(path), np.round(255 * srgb_from_linear(rgb[..., ::-1])).astype(np.uint8))
    marks, _ = camera.project(on(places, mesh.vertices))
    return Shot(path, camera, mesh, marks)
