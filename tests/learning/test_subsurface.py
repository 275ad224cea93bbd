from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from learning.render.diffusion import SAMPLE, SEAM, STEPS, Diffusion
from learning.render.environments import Environment
from learning.render.shading import shade
from learning.render.skin import SkinMaps
from learning.render.subsurface import KEPT, SCATTERED, SMALLEST, blur, scatter, scatter_paper


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


def dense_steps(area: np.ndarray, edges: np.ndarray, sigma: float) -> np.ndarray:
    """(n, n) float64: implicit steps of the heat equation, each a dense matrix inverted."""
    rows, columns = area.shape
    count, mass = rows * columns, area.ravel()
    index = np.arange(count).reshape(rows, columns)
    links = []
    for axis in (0, 1):
        pairs = [(index[:, :-1], index[:, 1:]), (index[:-1], index[1:])][axis]
        links.append(np.stack([p.ravel() for p in pairs], axis=1))
    steps = []
    for axis in (0, 1):
        flow = np.diag(mass.copy())
        length = edges[axis].ravel()
        limit = SEAM * np.median(length[::SAMPLE][mass[::SAMPLE] > 0])
        for a, b in links[axis]:
            distance = 0.5 * (length[a] + length[b])
            if not (mass[a] and mass[b]) or distance >= limit:
                continue
            k = sigma**2 / 2 / STEPS * 0.5 * (mass[a] + mass[b]) / distance**2
            flow[a, a] += k
            flow[b, b] += k
            flow[a, b] -= k
            flow[b, a] -= k
        some = mass > 0
        step = np.zeros((count, count))
        step[np.ix_(some, some)] = np.linalg.inv(flow[np.ix_(some, some)]) * mass[some]
        steps.append(step)
    whole = np.eye(count)
    for n in range(STEPS):
        for axis in (0, 1) if n % 2 == 0 else (1, 0):
            whole = steps[axis] @ whole
    return whole


def test_scatter_equals_a_dense_twin() -> None:
    rng = np.random.default_rng(2)
    diffuse, irradiance, translucency, area = random_field(rng)
    edges = torch.tensor(rng.uniform(0.5, 1.5, (1, 2, 9, 7)))
    found = scatter(diffuse, irradiance, translucency, area, 1.3, edges)[0].reshape(3, -1).numpy()
    kernel = dense_steps(area[0, 0].numpy(), edges[0].numpy(), 1.3)
    for channel in range(3):
        u = diffuse[0, channel].numpy().ravel()
        share = translucency.numpy().ravel() * (1 - irradiance[0, channel].numpy().ravel())
        a = np.sqrt(np.clip(share, 0, 1) * SCATTERED[channel] + SMALLEST) - np.sqrt(SMALLEST)
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
    # Four implicit steps have more at the centre and in the tails than a Gaussian of their width,
    # the more so where a texel is as wide as the kernel.
    for texels, off in ((60, 0.12), (240, 0.05)):
        lit = (torch.arange(texels) >= texels // 2).double().expand(1, 3, texels, texels)
        ones = torch.ones(1, 1, texels, texels, dtype=torch.float64)
        # Low light everywhere, so that the share of scattering is the same on both sides.
        found = scatter(0.5 * lit, 0.0 * lit, ones, ones, 1.4 * texels / 60)
        red = found[0, 0, texels // 2]
        dark = red[: texels // 2]
        assert float(dark.sum()) * 60 / texels == pytest.approx(expected, rel=off)


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


def plane(
    rows: int, columns: int, stretch: float
) -> tuple[torch.Tensor, torch.Tensor, np.ndarray, np.ndarray]:
    """A flat sheet, 60 mm square, whose texture is stretched: area, edges, x and y in mm."""

    def along(count: int) -> tuple[np.ndarray, np.ndarray]:
        u = (np.arange(count) + 0.5) / count
        u0, u1 = np.arange(count) / count, np.arange(1, count + 1) / count

        def place(t: np.ndarray) -> np.ndarray:
            return 60 * (t + stretch * np.sin(2 * np.pi * t) / (2 * np.pi))

        return place(u), place(u1) - place(u0)

    (x, wide), (y, high) = along(columns), along(rows)
    area = torch.tensor(high[:, None] * wide[None])[None, None]
    edges = np.stack(np.broadcast_arrays(wide[None], high[:, None]))
    return area, torch.tensor(edges)[None], x, y


@pytest.mark.parametrize("stretch", [0.0, 0.6])
def test_the_kernel_is_as_wide_in_millimetres_where_the_texture_is_stretched(
    stretch: float,
) -> None:
    area, edges, x, y = plane(128, 96, stretch)
    for row, column in ((64, 48), (40, 30), (90, 60)):
        dot = torch.zeros_like(area)
        dot[0, 0, row, column] = 1
        found = (area * Diffusion(area, edges, 1.4).spread(dot))[0, 0].numpy()
        found /= found.sum()
        for share, place in ((found.sum(axis=0), x - x[column]), (found.sum(axis=1), y - y[row])):
            mean = share @ place
            assert mean == pytest.approx(0, abs=0.05)
            assert np.sqrt(share @ (place - mean) ** 2) == pytest.approx(1.4, rel=0.02)


def test_without_the_stretch_the_kernel_would_be_wrong() -> None:
    area, edges, x, _ = plane(128, 96, 0.6)
    dot = torch.zeros_like(area)
    dot[0, 0, 64, 48] = 1
    even = torch.full_like(area, 60 * 60 / 96 / 128)
    found = Diffusion(even, edges.mean(dim=(2, 3), keepdim=True).expand_as(edges), 1.4).spread(dot)
    share = found[0, 0].sum(dim=0).numpy()
    share /= share.sum()
    assert np.sqrt(share @ (x - x[48]) ** 2) < 0.7 * 1.4


def test_the_kernel_is_a_gaussian_to_two_percent_of_a_shadow_edge() -> None:
    count = 240
    ones = torch.ones(1, 1, 4, count, dtype=torch.float64)
    lit = (torch.arange(count) >= count // 2).double().expand_as(ones)
    found = Diffusion(ones, None, 8.0).spread(lit)[0, 0, 0].numpy()
    at = torch.arange(count).double() + 0.5 - count / 2
    exact = 0.5 * (1 + torch.erf(at / 8.0 / 2**0.5)).numpy()
    assert 0.005 < np.abs(found - exact).max() < 0.02


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), sigma=st.floats(0.2, 30), scale=st.sampled_from([1e-6, 1, 1e6]))
def test_diffusion_is_symmetric_keeps_sums_and_constants(
    seed: int, sigma: float, scale: float
) -> None:
    rng = np.random.default_rng(seed)
    area = random_field(rng)[3] * scale
    edges = torch.tensor(rng.uniform(0.3, 3, (1, 2, 9, 7))) * scale**0.5
    one, other = (torch.tensor(rng.normal(size=(1, 1, 9, 7))) for _ in range(2))
    step = Diffusion(area, edges, sigma * scale**0.5)
    here, there = (
        float((area * a * step.spread(b)).sum()) for a, b in ((one, other), (other, one))
    )
    size = float((area * one.abs() * other.abs()).sum()) + 1e-300
    assert abs(here - there) <= 1e-9 * size
    constant = step.spread(torch.ones_like(area))[area > 0]
    torch.testing.assert_close(constant, torch.ones_like(constant))


def test_the_solver_of_other_devices_gives_the_same() -> None:
    rng = np.random.default_rng(8)
    area, edges = random_field(rng)[3], torch.tensor(rng.uniform(0.5, 2, (1, 2, 9, 7)))
    planes = torch.tensor(rng.normal(size=(1, 2, 9, 7)))
    step = Diffusion(area, edges, 2.0)
    torch.testing.assert_close(step.spread_by_scans(planes), step.spread(planes))


def test_scattering_of_other_devices_gives_the_same_picture_and_gradients() -> None:
    fields = random_field(np.random.default_rng(10))
    leaves = [f.requires_grad_() for f in fields[:3]]
    worth = torch.tensor(np.random.default_rng(11).normal(size=(1, 3, 9, 7)))
    found = []
    for fused in (True, False):
        picture = scatter(*leaves, fields[3], 1.7, None, fused)
        found.append([picture, *torch.autograd.grad((worth * picture).sum(), leaves)])
    for a, b in zip(*found, strict=True):
        torch.testing.assert_close(a, b)


def test_inputs_are_not_changed() -> None:
    fields = random_field(np.random.default_rng(9))
    before = [f.clone() for f in fields]
    scatter(*fields, 1.3)
    scatter_paper(*fields, 1.3)
    for f, b in zip(fields, before, strict=True):
        assert torch.equal(f, b)


def lit_plane(rows: int, columns: int, seen: torch.Tensor) -> tuple[torch.Tensor, SkinMaps]:
    """A stretched sheet, 60 mm square, under dim light from ahead: its picture, red in full."""
    area, edges, _, _ = plane(rows, columns, 0.6)
    texel = float(area.mean()) ** 0.5
    one = torch.ones(1, 1, rows, columns)
    up = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1) * one
    skin = SkinMaps(
        one.expand(-1, 3, -1, -1),
        0 * one,
        up,
        up,
        one,
        one,
        0 * up,
        (area / texel**2).float(),
        texel,
        one,
        (edges / texel).float(),
    )
    # So dim that shadow and light scatter the same share.
    lights = Environment(
        torch.tensor([[[0.0, 0.0, 1.0]]]),
        torch.full((1, 1, 3), 1e-4),
        torch.zeros(1, 3),
        torch.ones(1, 1, dtype=torch.bool),
        torch.tensor([[0.0, 0.0, 1e3]]),
    )
    return 1e4 * shade(skin, lights, None, seen), skin


@pytest.mark.parametrize(("rows", "off"), [(96, 0.12), (192, 0.06), (384, 0.04)])
def test_a_shadow_edge_bleeds_by_millimetres_at_any_resolution_under_stretch(
    rows: int, off: float
) -> None:
    columns = rows * 2 // 3
    *_, x, _ = plane(rows, columns, 0.6)
    seen = torch.tensor(x >= 21.0).float().expand(1, 1, rows, columns)
    picture, skin = lit_plane(rows, columns, seen)
    assert skin.edges is not None
    wide = (skin.edges[0, 0] * skin.texel_mm)[rows // 2]
    dark = (picture[0, 0, rows // 2] * wide)[x < 21.0].sum()
    # Half of the red scatters; a step that spreads by sigma loses sigma / sqrt(2 pi). In the
    # coarsest a texel is as wide as the kernel; in the finest its pointed shape takes 3.5 %.
    assert float(dark) == pytest.approx(0.5 * 1.4 / np.sqrt(2 * np.pi), rel=off)


@pytest.mark.parametrize("stripe_texels", [1, 3, 16])
def test_the_mean_light_stays_across_shadow_edges_and_stripes(stripe_texels: int) -> None:
    rows, columns = 120, 80
    at = torch.arange(rows)[:, None] + 2 * torch.arange(columns)[None]
    for field in (at // stripe_texels % 2, (at >= 140).long()):
        seen = field.float()[None, None]
        picture, skin = lit_plane(rows, columns, seen)
        before = (skin.area * seen).sum()
        assert float(before) > 0
        for channel in range(3):
            after = (skin.area[0, 0] * picture[0, channel]).sum()
            assert float(after / before) == pytest.approx(1.0, abs=5e-5)
        assert float((picture - seen).abs().max()) > 0.05
