"""Compiled steps of the diffusion on a texture's lines: couplings, elimination, sweeps.

A line is a row or a column. LANES lines are solved side by side: a step along a line is then one
vector operation. Pivots and couplings are stored line after line, as (B, lines, LANES' groups) need
them.
"""

from __future__ import annotations

import numba
import numpy as np

from learning.render.lanes_math import ANY_ORDER

LANES = 32
"""Lines that are solved side by side."""


@numba.njit(parallel=True, cache=True, fastmath=ANY_ORDER, error_model="numpy")
def couple(
    mass: np.ndarray,
    length: np.ndarray,
    along_rows: bool,
    tau: float,
    limit: float,
    flow: np.ndarray,
    pivots: np.ndarray,
) -> None:
    """Prepare the lines of one axis.

    area / distance^2 is a texel's cross-section over distance, also where rows and columns are not
    perpendicular, and gives the right width along the line.

    Args:
        mass: (B, H, W) area of texels, 0 where no surface is.
        length: (B, H, W) distance of neighbours along the axis.
        along_rows: whether lines are rows; else columns.
        tau: half the variance of one step.
        limit: neighbours at least this far apart are on two sides of a seam.
        flow: (B, groups, steps, LANES) is filled: tau times what flows to the line's next texel.
        pivots: the same shape, is filled: one over the pivots of Gauss's elimination.
    """
    batch, height, width = mass.shape
    lines, steps = (height, width) if along_rows else (width, height)
    one, half, zero = mass.dtype.type(1.0), mass.dtype.type(0.5), mass.dtype.type(0.0)
    groups = flow.shape[1]
    for task in numba.prange(batch * groups):
        entry, group = task // groups, task % groups
        for lane in range(min(LANES, lines - group * LANES)):
            line = group * LANES + lane
            before, pivot = zero, zero
            for i in range(steps):
                row, column = (line, i) if along_rows else (i, line)
                here = mass[entry, row, column]
                after = zero
                if i + 1 < steps:
                    down, right = (line, i + 1) if along_rows else (i + 1, line)
                    there = mass[entry, down, right]
                    far = half * (length[entry, row, column] + length[entry, down, right])
                    if here > zero and there > zero and far > zero and far < limit:
                        after = tau * half * (here + there) / (far * far)
                total = here + before + after - before * before * pivot
                pivot = one / total if total > zero else zero
                flow[entry, group, i, lane] = after
                pivots[entry, group, i, lane] = pivot
                before = after


@numba.njit(fastmath=ANY_ORDER, error_model="numpy")
def eliminate(
    values: np.ndarray, weights: np.ndarray, pivots: np.ndarray, flow: np.ndarray, count: int
) -> None:
    """One implicit step of LANES lines, in place.

    Args:
        values: (count * LANES,) densities.
        weights: (count * LANES,) mass.
        pivots: (count * LANES,) of `couple`.
        flow: (count * LANES,) of `couple`.
        count: texels of a line.
    """
    for lane in range(LANES):
        values[lane] *= weights[lane] * pivots[lane]
    for i in range(1, count):
        for lane in range(LANES):
            at = i * LANES + lane
            carried = flow[at - LANES] * values[at - LANES]
            values[at] = (values[at] * weights[at] + carried) * pivots[at]
    for i in range(count - 2, -1, -1):
        for lane in range(LANES):
            at = i * LANES + lane
            values[at] += pivots[at] * flow[at] * values[at + LANES]


@numba.njit(parallel=True, cache=True, fastmath=ANY_ORDER, error_model="numpy")
def sweep(
    planes: np.ndarray,
    mass: np.ndarray,
    pivots: np.ndarray,
    flow: np.ndarray,
    along_rows: bool,
    times: int,
) -> None:
    """`times` implicit steps along the lines of (B, C, H, W) densities, in place.

    Args:
        planes: (B, C, H, W) densities.
        mass: (B, H, W).
        pivots: (B, groups, steps, LANES) of `couple`.
        flow: (B, groups, steps, LANES) of `couple`.
        along_rows: whether lines are rows.
        times: steps one after the other.
    """
    batch, channels, height, width = planes.shape
    lines, steps = (height, width) if along_rows else (width, height)
    groups = pivots.shape[1]
    for task in numba.prange(batch * groups):
        entry, group = task // groups, task % groups
        first = group * LANES
        count = min(LANES, lines - first)
        buf = np.zeros(steps * LANES, planes.dtype)
        weights = np.zeros(steps * LANES, planes.dtype)
        pivot = pivots[entry, group].reshape(-1)
        joined = flow[entry, group].reshape(-1)
        read_lines(mass[entry], first, count, along_rows, weights)
        for channel in range(channels):
            plane = planes[entry, channel]
            if not read_lines(plane, first, count, along_rows, buf):
                continue
            for _ in range(times):
                eliminate(buf, weights, pivot, joined, steps)
            write_lines(buf, first, count, along_rows, plane)


@numba.njit(error_model="numpy")
def read_lines(
    plane: np.ndarray, first: int, count: int, along_rows: bool, out: np.ndarray
) -> bool:
    """Copy lines from (H, W) into lanes; returns whether any of it is not zero."""
    some = False
    if along_rows:
        for lane in range(count):
            for i in range(plane.shape[1]):
                value = plane[first + lane, i]
                some |= value != 0
                out[i * LANES + lane] = value
    else:
        for i in range(plane.shape[0]):
            for lane in range(count):
                value = plane[i, first + lane]
                some |= value != 0
                out[i * LANES + lane] = value
    return some


@numba.njit(error_model="numpy")
def write_lines(
    buf: np.ndarray, first: int, count: int, along_rows: bool, plane: np.ndarray
) -> None:
    """Copy lanes back into lines of (H, W)."""
    if along_rows:
        for lane in range(count):
            for i in range(plane.shape[1]):
                plane[first + lane, i] = buf[i * LANES + lane]
    else:
        for i in range(plane.shape[0]):
            for lane in range(count):
                plane[i, first + lane] = buf[i * LANES + lane]
