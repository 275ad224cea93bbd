"""What is no skin in a photograph is left out of the texture."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from learning.checkpoint import load_whole_face, shipped_weights
from learning.errors import MapsError
from learning.infer import Inferred
from learning.photo import fit
from learning.photo.config import FitConfig
from learning.photo.fit import fit_head
from learning.photo.picture import read_photograph
from learning.photo.shape_fit import Photograph, Places
from learning.render.uv import rasterise
from learning.whole.infer import infer_whole_face
from lightstage.formats.template import Template
from tests.learning.photo.scene import FOCAL_PX, SMALL, Shot


def test_a_hat_is_left_out_where_no_light_explains_the_photograph(
    shot: Shot, template: Template, places: Places, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unexplained(*given: Any, **more: Any) -> Inferred:
        # As where the light of a photograph is not found: the network's answer alone.
        return infer_whole_face(*given, **{**more, "refine_seconds": 0.0})

    monkeypatch.setattr(fit, "infer_whole_face", unexplained)
    rgb = read_photograph(shot.path).rgb_linear
    brows, _ = shot.camera.project(shot.mesh.vertices[template.landmarks[17:27]])
    brim = int(brows[:, 1].min()) - 20
    rgb[:brim] = 0.008
    rgb[: brim - 10, 130:230] = 0.8
    photograph = Photograph("hat", rgb, shot.landmarks_px, FOCAL_PX)
    network, _ = load_whole_face(shipped_weights())
    found = fit_head([photograph], template, places, network, FitConfig(rows=192, refine_seconds=0))
    raster = rasterise(found.shape.meshes[0], 192, 128)
    vertices = found.shape.meshes[0].vertices
    height = raster.interpolate(vertices)[..., 1]
    above, nose = vertices[template.landmarks[17:27], 1].max(), vertices[template.landmarks[30], 1]
    front = raster.covered & (raster.interpolate(vertices)[..., 2] > 40)
    hat = front & (height > above + 18)
    face = front & (height < above) & (height > nose)
    assert hat.sum() > 100
    # By the network's albedo alone 59 %: it takes the hat for a shadow.
    assert found.seen[hat].mean() < 0.35
    assert found.seen[face].mean() > 0.6


def test_a_later_photograph_in_hardly_any_light_gives_the_shape_alone(
    shot: Shot, template: Template, places: Places
) -> None:
    rgb = read_photograph(shot.path).rgb_linear
    good, dark = (
        Photograph(name, light * rgb, shot.landmarks_px, FOCAL_PX)
        for name, light in (("good", 1.0), ("dark", 1e-3))
    )
    network, _ = load_whole_face(shipped_weights())
    config = dataclasses.replace(SMALL, rows=192, refine_seconds=0.0)
    found = fit_head([good, dark], template, places, network, config)
    assert any("dark gives the shape alone, no texture" in note for note in found.notes)
    assert set(np.unique(found.source)) == {-1, 0}
    with pytest.raises(MapsError, match="dark"):
        fit_head([dark, good], template, places, network, config)
