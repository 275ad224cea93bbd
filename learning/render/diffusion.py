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

import numpy as np
import torch
from torch import Tensor

from learning.render.diffusion_kernel import LANES, couple, sweep

STEPS = 4
"""Steps along each axis: kurtosis of the kernel is 3 + 3 / STEPS; a Gaussian's is 3."""
SEAM = 6.0
"""Neighbours this many times the median distance apart are on two sides of a seam."""
SAMPLE = 7
"""The median distance is taken over every so manieth texel."""


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
        self.mass = area.detach()[:, 0].contiguous()
        mass = self.mass.cpu().numpy()
        if edges is None:
            length = np.sqrt(np.maximum(mass, 0))
            lengths = [length, length]
        else:
            known = edges.detach().cpu()
            lengths = [known[:, axis].contiguous().numpy() for axis in (0, 1)]
        tau = mass.dtype.type(sigma_px**2 / 2 / STEPS)
        self.systems = [
            _system(mass, length, axis == 0, tau) for axis, length in enumerate(lengths)
        ]

    def spread(self, planes: Tensor) -> Tensor:
        """Spread (B, C, H, W) densities; sum(area * result) = sum(area * planes).

        On processors it has no gradient (see `scattering`).
        """
        if planes.device.type != "cpu":
            return self.spread_by_scans(planes)
        out = planes.detach().clone(memory_format=torch.contiguous_format)
        self.spread_in_place(out.numpy())
        return out

    def spread_in_place(self, planes: np.ndarray) -> None:
        """As `spread`, of a (B, C, H, W) array, in place."""
        mass = self.mass.numpy()
        for axis, times in _order():
            pivots, flow = self.systems[axis]
            sweep(planes, mass, pivots, flow, axis == 0, times)

    def spread_by_scans(self, planes: Tensor) -> Tensor:
        """As `spread`, in torch's operations, with a gradient, on any device."""
        values, mass = planes, self.mass[:, None]
        lines = [[_by_lines(x, planes, axis) for x in self.systems[axis]] for axis in (0, 1)]
        for axis, times in _order():
            pivots, flow = lines[axis]
            for _ in range(times):
                if axis == 0:
                    values = _scan_solve(values, mass, pivots, flow)
                else:
                    values = _scan_solve(values.mT, mass.mT, pivots, flow).mT
        return values


def _order() -> list[tuple[int, int]]:
    """Axes of the steps and how many in a row: rows, columns twice, rows twice, ... , rows."""
    axes = [axis for step in range(STEPS) for axis in ((0, 1) if step % 2 == 0 else (1, 0))]
    out: list[tuple[int, int]] = []
    for axis in axes:
        if out and out[-1][0] == axis:
            out[-1] = (axis, out[-1][1] + 1)
        else:
            out.append((axis, 1))
    return out


def _system(
    mass: np.ndarray, length: np.ndarray, along_rows: bool, tau: float
) -> tuple[np.ndarray, np.ndarray]:
    """One over the pivots, and the couplings, of one axis: (B, groups, steps, LANES)."""
    batch, height, width = mass.shape
    lines, steps = (height, width) if along_rows else (width, height)
    flow = np.zeros((batch, -(-lines // LANES), steps, LANES), mass.dtype)
    pivots = np.zeros_like(flow)
    some = length.reshape(-1)[::SAMPLE][mass.reshape(-1)[::SAMPLE] > 0]
    if not some.size:
        some = length[mass > 0]
    limit = SEAM * float(np.median(some)) if some.size else 0.0
    couple(mass, length, along_rows, tau, mass.dtype.type(limit), flow, pivots)
    return pivots, flow


def _by_lines(values: np.ndarray, like: Tensor, axis: int) -> Tensor:
    """(B, 1, lines, steps) of (B, groups, steps, LANES)."""
    batch, groups, steps, _ = values.shape
    lines = like.shape[-2] if axis == 0 else like.shape[-1]
    turned = values.transpose(0, 1, 3, 2).reshape(batch, 1, groups * LANES, steps)
    return torch.from_numpy(np.ascontiguousarray(turned[:, :, :lines])).to(like)


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
