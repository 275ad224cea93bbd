"""What is no skin in a photograph is left out of the texture."""

from __future__ import annotations

import numpy as np
import pytest

from learning.checkpoint import load_whole_face, shipped_weights
from learning.photo import fit
from learning.photo.config import FitConfig
from learning.photo.fit import fit_head
from learning.photo.picture import read_photograph
from learning.photo.shape_fit import Photograph, Places
from learning.render.uv import rasterise
from lightstage.formats.template import Template
from tests.learning.photo.scene import FOCAL_PX, Shot


def test_a_hat_with_a_badge_is_left_out_of_the_texture(
    shot: Shot, template: Template, places: Places, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fit, "FIRST_SECONDS", 1.0)
    rgb, _ = read_photograph(shot.path)
    brows, _ = shot.camera.project(shot.mesh.vertices[template.landmarks[17:27]])
    brim = int(brows[:, 1].min()) - 20
    rgb[:brim] = 0.008
    rgb[: brim - 10, 130:230] = 0.8
    photograph = Photograph("hat", rgb, shot.landmarks_px, FOCAL_PX)
    network, _ = load_whole_face(shipped_weights())
    found = fit_head([photograph], template, places, network, FitConfig(rows=192, refine_seconds=1))
    raster = rasterise(found.shape.meshes[0], 192, 128)
    vertices = found.shape.meshes[0].vertices
    height = raster.interpolate(vertices)[..., 1]
    above, nose = vertices[template.landmarks[17:27], 1].max(), vertices[template.landmarks[30], 1]
    front = raster.covered & (raster.interpolate(vertices)[..., 2] > 40)
    hat = front & (height > above + 18)
    face = front & (height < above) & (height > nose)
    assert hat.sum() > 100
    assert found.seen[hat].mean() < 0.2
    assert found.seen[face].mean() > 0.6
