"""Which textures have one layout, and which way up they are."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from learning.errors import MapsError
from learning.infer_checks import require_upright
from learning.whole.texture_layout import apart_mm, of_another_layout


def test_a_layout_is_another_where_texels_are_elsewhere_or_unknown() -> None:
    rng = np.random.default_rng(0)
    usual = 80 * torch.from_numpy(rng.normal(size=(1, 3, 12, 8))).float()
    heads = usual + 3 * torch.from_numpy(rng.normal(size=(5, 3, 12, 8))).float()
    assert of_another_layout(heads) == []
    heads[3] = heads[3].flip(1)
    heads[4] = float("nan")
    assert of_another_layout(heads) == [3, 4]
    assert np.isnan(apart_mm(torch.zeros_like(usual), usual))


def marked(rng: np.random.Generator) -> np.ndarray:
    """(h, w, 3) logarithm of an albedo with marks, as brows, eyes and lips are."""
    return np.repeat(rng.normal(0, 0.3, (96, 64, 1)) - 1.5, 3, axis=2)


@pytest.mark.parametrize("light", [0.1, 1.0, 10.0])
def test_a_reversed_face_is_refused_in_any_light_and_an_upright_one_is_not(light: float) -> None:
    rng = np.random.default_rng(2)
    pattern = marked(rng)
    shading = light * np.linspace(0.2, 1.0, 64)[:, None]
    texture = np.exp(pattern + rng.normal(0, 0.2, pattern.shape)) * shading
    require_upright(texture, pattern, "texture")
    with pytest.raises(MapsError, match="upside down"):
        require_upright(texture[::-1], pattern, "texture")


def test_a_few_texels_that_are_alike_by_chance_are_not_taken_for_a_reversed_face() -> None:
    for seed in range(200):
        rng = np.random.default_rng(seed)
        pattern = marked(rng)
        few = np.zeros((96, 64, 1), bool)
        few[40:56, 20:44] = True
        require_upright(np.exp(marked(rng)), pattern * few, "texture")
