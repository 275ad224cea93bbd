"""What is no skin in a photograph is left out of the texture."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from learning.checkpoint import load_whole_face, shipped_weights
from learning.errors import MapsError
from learning.infer import Inferred
from learning.photo import look
from learning.photo.config import FitConfig
from learning.photo.fit import fit_head
from learning.photo.picture import read_photograph
from learning.photo.shape_fit import Photograph, Places
from learning.photo.skin_mask import in_no_light
from learning.render.uv import rasterise
from learning.whole.infer import infer_whole_face
from lightstage.formats.template import Template
from tests.learning.photo.scene import FOCAL_PX, SMALL, Shot


def test_a_hat_decides_neither_light_nor_tone_where_no_light_explains_the_photograph(
    shot: Shot, template: Template, places: Places, monkeypatch: pytest.MonkeyPatch
) -> None:
    sees: list[np.ndarray] = []

    def unexplained(*given: Any, **more: Any) -> Inferred:
        sees.append(more["network_sees"])
        # As where the light of a photograph is not found: the network's answer alone.
        return infer_whole_face(*given, **{**more, "refine_seconds": 0.0})

    monkeypatch.setattr(look, "infer_whole_face", unexplained)
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
    assert sees[-1][hat].mean() < 0.35
    assert sees[-1][face].mean() > 0.6


def test_a_later_photograph_in_hardly_any_light_gives_the_shape_alone(
    shot: Shot, template: Template, places: Places, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(look, "SEARCH_SECONDS", 0.0)  # no light is searched for
    rgb = read_photograph(shot.path).rgb_linear
    good, dark = (
        Photograph(name, light * rgb, shot.landmarks_px, FOCAL_PX)
        for name, light in (("good", 1.0), ("dark", 1e-3))
    )
    network, _ = load_whole_face(shipped_weights())
    # What is no texture is decided after the shape, here that of the landmarks alone.
    config = dataclasses.replace(SMALL, rows=192, refine_seconds=0.0, pixel_rounds=0)
    found = fit_head([good, dark], template, places, network, config)
    assert any("dark gives the shape alone, no texture" in note for note in found.notes)
    assert set(np.unique(found.source)) == {-1, 0}
    with pytest.raises(MapsError, match="dark"):
        fit_head([dark, good], template, places, network, config)


@settings(max_examples=30, deadline=None)
@given(
    fill=st.sampled_from([0.0, -1.0, np.nan, np.inf, 1e-6, 1e6]),
    share=st.floats(0, 1),
    scale=st.sampled_from([1e-6, 1.0, 1e6]),
    flat=st.booleans(),
)
def test_any_texture_gives_a_mask_of_what_no_light_explains(
    fill: float, share: float, scale: float, flat: bool
) -> None:
    rng = np.random.default_rng(0)
    size = (48, 32)
    normal = rng.normal(size=(*size, 3))
    if flat:
        normal[:] = 0, 0, 1
    texture = scale * rng.uniform(0.2, 0.4, (*size, 3))
    lost = rng.random(size) < share
    texture[lost] = fill
    seen, keep = np.ones(size, bool), np.zeros(size, bool)
    keep[:5] = True
    found = in_no_light(texture, np.full((*size, 3), 0.3), normal, seen, keep)
    assert found.shape == size
    assert found.dtype == bool
    assert not found[keep].any()


def test_a_black_hat_is_explained_by_no_soft_light_and_a_lit_forehead_is() -> None:
    size = (96, 64)
    across = np.linspace(-0.9, 0.9, size[1]) * np.ones(size)
    normal = np.stack([across, np.zeros(size), np.sqrt(1 - across**2)], axis=2)
    albedo = np.full((*size, 3), 0.3)
    texture = albedo * (0.5 + 0.4 * normal[..., :1])
    seen, keep = np.ones(size, bool), np.zeros(size, bool)
    assert not in_no_light(texture, albedo, normal, seen, keep).any()
    texture[:20] = 0.008
    found = in_no_light(texture, albedo, normal, seen, keep)
    assert found[:20].all()
    assert not found[26:].any()
