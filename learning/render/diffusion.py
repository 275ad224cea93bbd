"""Diffusion on the skin, in its texture: a Gaussian that is as wide in millimetres everywhere.

The heat equation, run for sigma^2 / 2, spreads a point into a Gaussian of sigma. It is solved on
the texels with the lengths that they have on the skin, so the texture may be stretched; light that
leaves one texel arrives in its neighbours, so its sum is kept, also at the texture's borders and
seams, across which nothing flows. Steps are implicit and taken along rows and columns in turn: each
is one tridiagonal system a line, whose cost does not depend on the width. Their order reads the
same backwards, which makes the whole operation symmetric, as scattering is [Hundsdorfer2003].

Rows and columns are taken as perpendicular on the skin. Where the texture is sheared by an angle t
the width is wrong along the diagonals, by a factor of at most sqrt(1 / (1 - sin t)).
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from learning.render.lanes_math import ANY_ORDER

STEPS = 4
"""Steps along each axis: kurtosis of the kernel is 3 + 3 / STEPS; a Gaussian's is 3."""
LANES = 32
"""Lines that are solved side by side."""
SEAM = 6.0
"""Neighbours this many times the median distance apart lie on two sides of a seam."""


class Diffusion:
    """The operation for one batch of surfaces, without gradient with respect to them."""

    def __init__(self, area: Tensor, edges: Tensor | None, sigma_px: float) -> None:
        """Prepare the systems.

        Args:
            area: (B, 1, H, W) of texels, 0 where no surface is.
            edges: (B, 2, H, W) distance of neighbours across and down, in the root of area's unit;
                the root of `area` where None.
            sigma_px: the kernel's standard deviation in that unit.
        """
        mass = area.detach()[:, 0]
        if edges is None:
            edges = mass.clamp_min(0).sqrt()[:, None].expand(-1, 2, -1, -1)
        self.mass = mass
        tau = sigma_px**2 / 2 / STEPS
        across = _couplings(mass, edges.detach()[:, 0], tau)
        down = _couplings(mass.mT, edges.detach()[:, 1].mT, tau)
        self.systems = (_factors(mass, across), _factors(mass.mT.contiguous(), down))

    def spread(self, planes: Tensor) -> Tensor:
        """Spread (B, C, H, W) densities; sum(area * result) = sum(area * planes)."""
        return _Spread.apply(planes, self)

    def solve(self, planes: Tensor) -> Tensor:
        """As `spread`, without a graph."""
        if planes.device.type == "cpu":
            out = planes.detach().clone(memory_format=torch.contiguous_format).numpy()
            mass = self.mass.contiguous().numpy()
            (pa, ka), (pd, kd) = self.systems
            for axis in _order():
                if axis == 0:
                    solve_rows(out, mass, pa.numpy(), ka.numpy())
                else:
                    solve_columns(out, mass, pd.numpy(), kd.numpy())
            return torch.from_numpy(out)
        return self.solve_by_scans(planes)

    def solve_by_scans(self, planes: Tensor) -> Tensor:
        """As `solve`, in torch's operations, on any device."""
        (pa, ka), (pd, kd) = self.systems
        values = planes
        for axis in _order():
            if axis == 0:
                values = _scan_solve(values, self.mass[:, None], pa[:, None], ka[:, None])
            else:
                turned = self.mass.mT[:, None]
                values = _scan_solve(values.mT, turned, pd[:, None], kd[:, None]).mT
        return values


class _Spread(torch.autograd.Function):
    """`Diffusion.solve` and its transpose: area times it over area, as it is symmetric."""

    @staticmethod
    def forward(ctx: Any, planes: Tensor, diffusion: Diffusion) -> Tensor:
        ctx.diffusion = diffusion
        return diffusion.solve(planes)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, worth: Tensor) -> tuple[Tensor, None]:
        mass = ctx.diffusion.mass[:, None]
        some = mass > 0
        spread = ctx.diffusion.solve(torch.where(some, worth / torch.where(some, mass, 1.0), 0.0))
        return torch.where(some, spread * mass, worth), None


def _order() -> list[int]:
    """Axes of the steps, a palindrome: rows, columns, columns, rows, ..."""
    return [axis for step in range(STEPS) for axis in ((0, 1) if step % 2 == 0 else (1, 0))]


def _couplings(mass: Tensor, length: Tensor, tau: float) -> Tensor:
    """(B, H, W): tau times what flows from a texel to the next one in its row; 0 at the end.

    area / distance^2 is a texel's cross-section over distance, also where rows and columns are not
    perpendicular, and gives the right width along the row.
    """
    both = (mass[:, :, :-1] > 0) & (mass[:, :, 1:] > 0)
    distance = 0.5 * (length[:, :, :-1] + length[:, :, 1:])
    some = distance[both]
    typical = some.median() if some.numel() else distance.new_ones(())
    joined = both & (distance < SEAM * typical) & (distance > 0)
    between = 0.5 * (mass[:, :, :-1] + mass[:, :, 1:])
    flow = torch.where(joined, tau * between / torch.where(joined, distance, 1.0).square(), 0.0)
    return torch.nn.functional.pad(flow, (0, 1))


def _factors(mass: Tensor, flow: Tensor) -> tuple[Tensor, Tensor]:
    """One over the pivots of every row's system, and the couplings; on the mass's device."""
    weights, couplings = mass.contiguous().cpu().numpy(), flow.contiguous().cpu().numpy()
    pivots = np.zeros_like(weights)
    factorise(weights, couplings, pivots)
    return torch.from_numpy(pivots).to(mass), flow.contiguous()


@numba.njit(parallel=True, cache=True, fastmath=ANY_ORDER, error_model="numpy")
def factorise(mass: np.ndarray, flow: np.ndarray, pivots: np.ndarray) -> None:
    """One over the pivots of Gauss's elimination along rows; 0 where no surface is."""
    batch, height, width = mass.shape
    for line in numba.prange(batch * height):
        entry, row = line // height, line % height
        before, pivot = mass.dtype.type(0.0), mass.dtype.type(0.0)
        for i in range(width):
            after = flow[entry, row, i]
            total = mass[entry, row, i] + before + after - before * before * pivot
            pivot = mass.dtype.type(1.0) / total if total > 0 else mass.dtype.type(0.0)
            pivots[entry, row, i] = pivot
            before = after


@numba.njit(fastmath=ANY_ORDER, error_model="numpy")
def eliminate(values: np.ndarray, pivots: np.ndarray, flow: np.ndarray, count: int) -> None:
    """Solve LANES tridiagonal systems side by side; (count * LANES,) arrays, in place."""
    for lane in range(LANES):
        values[lane] *= pivots[lane]
    for i in range(1, count):
        for lane in range(LANES):
            at = i * LANES + lane
            values[at] = (values[at] + flow[at - LANES] * values[at - LANES]) * pivots[at]
    for i in range(count - 2, -1, -1):
        for lane in range(LANES):
            at = i * LANES + lane
            values[at] += pivots[at] * flow[at] * values[at + LANES]


@numba.njit(parallel=True, cache=True, fastmath=ANY_ORDER, error_model="numpy")
def solve_rows(planes: np.ndarray, mass: np.ndarray, pivots: np.ndarray, flow: np.ndarray) -> None:
    """One implicit step along the rows of (B, C, H, W), in place; the rest (B, H, W)."""
    batch, channels, height, width = planes.shape
    groups = (height + LANES - 1) // LANES
    for group in numba.prange(batch * groups):
        entry, first = group // groups, (group % groups) * LANES
        count = min(LANES, height - first)
        buf = np.zeros(width * LANES, planes.dtype)
        pivot = np.zeros(width * LANES, planes.dtype)
        joined = np.zeros(width * LANES, planes.dtype)
        for lane in range(count):
            for i in range(width):
                pivot[i * LANES + lane] = pivots[entry, first + lane, i]
                joined[i * LANES + lane] = flow[entry, first + lane, i]
        for channel in range(channels):
            for lane in range(count):
                for i in range(width):
                    weight = mass[entry, first + lane, i]
                    buf[i * LANES + lane] = planes[entry, channel, first + lane, i] * weight
            eliminate(buf, pivot, joined, width)
            for lane in range(count):
                for i in range(width):
                    planes[entry, channel, first + lane, i] = buf[i * LANES + lane]


@numba.njit(parallel=True, cache=True, fastmath=ANY_ORDER, error_model="numpy")
def solve_columns(
    planes: np.ndarray, mass: np.ndarray, pivots: np.ndarray, flow: np.ndarray
) -> None:
    """One implicit step along the columns; `pivots` and `flow` are (B, W, H)."""
    batch, channels, height, width = planes.shape
    groups = (width + LANES - 1) // LANES
    for group in numba.prange(batch * groups):
        entry, first = group // groups, (group % groups) * LANES
        count = min(LANES, width - first)
        buf = np.zeros(height * LANES, planes.dtype)
        pivot = np.zeros(height * LANES, planes.dtype)
        joined = np.zeros(height * LANES, planes.dtype)
        for lane in range(count):
            for i in range(height):
                pivot[i * LANES + lane] = pivots[entry, first + lane, i]
                joined[i * LANES + lane] = flow[entry, first + lane, i]
        for channel in range(channels):
            for i in range(height):
                for lane in range(count):
                    weight = mass[entry, i, first + lane]
                    buf[i * LANES + lane] = planes[entry, channel, i, first + lane] * weight
            eliminate(buf, pivot, joined, height)
            for i in range(height):
                for lane in range(count):
                    planes[entry, channel, i, first + lane] = buf[i * LANES + lane]


def _scan_solve(planes: Tensor, mass: Tensor, pivots: Tensor, flow: Tensor) -> Tensor:
    """One step along the rows by doubling: the recurrences of all texels at once, for a GPU."""
    ahead = torch.nn.functional.pad(flow[..., :-1], (1, 0)) * pivots
    solved = _recurrence(planes * mass * pivots, ahead.expand_as(planes))
    back = (pivots * flow).expand_as(planes)
    return _recurrence(solved.flip(-1), back.flip(-1)).flip(-1)


def _recurrence(values: Tensor, factor: Tensor) -> Tensor:
    """x_i = values_i + factor_i x_(i-1) along the last axis, in log2 of its length steps."""
    step = 1
    while step < values.shape[-1]:
        shifted = torch.nn.functional.pad(values[..., :-step], (step, 0))
        values = values + factor * shifted
        factor = factor * torch.nn.functional.pad(factor[..., :-step], (step, 0))
        step *= 2
    return values
