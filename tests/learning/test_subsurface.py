from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from learning.render.subsurface import KEPT, SCATTERED, blur, scatter, scatter_paper


def dense_kernel(rows: int, columns: int, sigma: float) -> np.ndarray:
    """(n, n) float64: the kernel between all texels, cut and normalised as the fast one."""
    radius = max(1, int(np.ceil(3.5 * sigma)))
    total = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2).sum()
    r, c = (a.ravel().astype(float) for a in np.mgrid[:rows, :columns])

    def along(x: np.ndarray) -> np.ndarray:
        d = x[:, None] - x[None]
        return np.exp(-0.5 * (d / sigma) ** 2) * (np.abs(d) <= radius) / total

    return along(r) * along(c)


def random_field(rng: np.random.Generator, rows: int = 9, columns: int = 7) -> list[torch.Tensor]:
    diffuse = rng.uniform(0, 1, (1, 3, rows, columns))
    irradiance = rng.uniform(0, 1.3, (1, 3, rows, columns))
    translucency = rng.uniform(0, 1, (1, 1, rows, columns))
    area = rng.uniform(0, 2, (1, 1, rows, columns)) * (
        rng.uniform(size=(1, 1, rows, columns)) > 0.2
    )
    return [torch.tensor(a) for a in (diffuse, irradiance, translucency, area)]


@pytest.mark.parametrize("sigma", [0.4, 1.7, 5.0])
def test_blur_equals_a_dense_kernel(sigma: float) -> None:
    image = torch.tensor(np.random.default_rng(0).normal(size=(2, 3, 9, 7)))
    expected = image.reshape(6, -1).numpy() @ dense_kernel(9, 7, sigma).T
    np.testing.assert_allclose(blur(image, sigma).reshape(6, -1), expected, atol=1e-12)


def test_blur_in_blocks_equals_blur_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    image = torch.tensor(np.random.default_rng(1).normal(size=(1, 2, 53, 41)))
    whole = blur(image, 2.2)
    monkeypatch.setattr("learning.render.subsurface.BLOCK_ROWS", 8)
    torch.testing.assert_close(blur(image, 2.2), whole)


def test_scatter_equals_a_dense_twin() -> None:
    diffuse, irradiance, translucency, area = random_field(np.random.default_rng(2))
    found = scatter(diffuse, irradiance, translucency, area, 1.3)[0].reshape(3, -1).numpy()
    kernel = dense_kernel(9, 7, 1.3) * area.numpy().ravel()[None]
    for channel in range(3):
        u = diffuse[0, channel].numpy().ravel()
        share = translucency.numpy().ravel() * (1 - irradiance[0, channel].numpy().ravel())
        a = np.sqrt(np.clip(share, 1e-6, 1) * SCATTERED[channel])
        expected = u + a * (kernel @ (a * u)) - a * u * (kernel @ a)
        np.testing.assert_allclose(found[channel], expected, atol=1e-12)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), sigma=st.floats(0.2, 6), scale=st.sampled_from([1e-6, 1.0, 1e6]))
def test_scatter_keeps_the_light_that_enters(seed: int, sigma: float, scale: float) -> None:
    diffuse, irradiance, translucency, area = random_field(np.random.default_rng(seed))
    found = scatter(scale * diffuse, irradiance, translucency, area, sigma)
    before = (area * scale * diffuse).sum(dim=(2, 3))
    torch.testing.assert_close((area * found).sum(dim=(2, 3)), before, rtol=1e-10, atol=0)


def test_uniform_light_on_uniform_skin_stays_uniform() -> None:
    ones = torch.ones(1, 1, 40, 40, dtype=torch.float64)
    diffuse = 0.4 * ones.repeat(1, 3, 1, 1)
    found = scatter(diffuse, 0.5 * ones.repeat(1, 3, 1, 1), ones, ones, 2.0)
    torch.testing.assert_close(found, diffuse)


def test_light_bleeds_over_a_shadow_edge_by_millimetres_at_any_resolution() -> None:
    # What a step loses: 0.5 (light) * 0.5 (red's share) * sigma / sqrt(2 pi), sigma = 1.4 mm.
    expected = 0.25 * 1.4 / np.sqrt(2 * np.pi)
    for texels in (60, 240):
        lit = (torch.arange(texels) >= texels // 2).double().expand(1, 3, texels, texels)
        ones = torch.ones(1, 1, texels, texels, dtype=torch.float64)
        # Low light everywhere, so that the share of scattering is the same on both sides.
        found = scatter(0.5 * lit, 0.0 * lit, ones, ones, 1.4 * texels / 60)
        red = found[0, 0, texels // 2]
        dark = red[: texels // 2]
        assert float(dark.sum()) * 60 / texels == pytest.approx(expected, rel=0.06)


def test_nothing_scatters_from_where_no_surface_is() -> None:
    diffuse, irradiance, translucency, area = random_field(np.random.default_rng(4))
    outside = (area == 0).expand_as(diffuse)
    brighter = torch.where(outside, 1e3, diffuse)
    kept = ~outside
    args = (irradiance, translucency, area, 1.5)
    torch.testing.assert_close(scatter(diffuse, *args)[kept], scatter(brighter, *args)[kept])


def test_paper_mode_is_the_printed_formula_and_loses_red_in_full_light() -> None:
    diffuse, irradiance, translucency, area = random_field(np.random.default_rng(5))
    area = torch.ones_like(area)
    found = scatter_paper(diffuse, irradiance, translucency, area, 1.3)[0].reshape(3, -1).numpy()
    kernel = dense_kernel(9, 7, 1.3)
    for channel in range(3):
        u = diffuse[0, channel].numpy().ravel()
        share = translucency.numpy().ravel() * (1 - irradiance[0, channel].numpy().ravel())
        expected = (1 - share) * KEPT[channel] * u + share * SCATTERED[channel] * (kernel @ u)
        np.testing.assert_allclose(found[channel], expected, atol=1e-12)
    full = torch.ones_like(diffuse)
    half = scatter_paper(diffuse, full, translucency, area, 1.3)
    torch.testing.assert_close(half[:, 0], 0.5 * diffuse[:, 0])


def test_gradients_are_exact_and_finite_where_no_light_scatters() -> None:
    fields = [f.requires_grad_() for f in random_field(np.random.default_rng(6), 4, 3)[:3]]
    area = torch.ones(1, 1, 4, 3, dtype=torch.float64)
    for kernel in (scatter, scatter_paper):
        assert torch.autograd.gradcheck(lambda *f, k=kernel: k(*f, area, 1.1), fields, atol=1e-6)
    bright = torch.full((1, 3, 4, 3), 2.0, dtype=torch.float64, requires_grad=True)
    scatter(bright, bright, torch.zeros_like(area), area, 1.0).sum().backward()
    assert bright.grad is not None
    assert torch.isfinite(bright.grad).all()
