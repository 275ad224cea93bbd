"""The compiled scattering S = U + a g(a U) - a U g(a), and its gradient by hand.

With g's transpose written g', w = what S is worth:
of U: w (1 - a g(a)) + a g'(w a), and of a: w (g(a U) - U g(a)) + U g'(w a) - g'(w a U).
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from learning.render.diffusion import Diffusion
from learning.render.lanes_math import ANY_ORDER


class FusedScatter(torch.autograd.Function):
    """`subsurface.scatter` on a processor."""

    @staticmethod
    def forward(
        ctx: Any,
        diffuse: Tensor,
        irradiance: Tensor,
        translucency: Tensor,
        diffusion: Diffusion,
        weights: tuple[float, float, float],
        smallest: float,
    ) -> Tensor:
        """(B, 3, H, W), (B, 3, H, W), (B, 1, H, W); returns (B, 3, H, W)."""
        u, e, c = (_array(x) for x in (diffuse, irradiance, translucency))
        batch, _, height, width = u.shape
        kind = u.dtype.type
        shares = np.array(weights, u.dtype)
        root = np.empty_like(u)
        both = np.empty((batch, 6, height, width), u.dtype)
        prepare(u, e, c, shares, kind(smallest), root, both)
        diffusion.spread_in_place(both)
        out = np.empty_like(u)
        combine(u, root, both, out)
        ctx.save_for_backward(diffuse, irradiance, translucency)
        ctx.kept = (diffusion, shares, kind(smallest), root, both)
        return torch.from_numpy(out)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, worth: Tensor) -> tuple[Tensor | None, ...]:
        """What the three fields are worth."""
        u, e, c = (_array(x) for x in ctx.saved_tensors)
        diffusion, shares, smallest, root, both = ctx.kept
        mass = diffusion.mass.numpy()
        w = _array(worth)
        turned = np.empty_like(both)
        weigh(u, root, w, mass, turned)
        diffusion.spread_in_place(turned)
        of_u, of_e, of_c = np.empty_like(u), np.empty_like(e), np.empty_like(c)
        worths(u, e, c, shares, smallest, root, both, turned, mass, w, of_u, of_e, of_c)
        found = (torch.from_numpy(x) for x in (of_u, of_e, of_c))
        return (*found, None, None, None)


@numba.njit(parallel=True, cache=True, fastmath=ANY_ORDER, error_model="numpy")
def prepare(
    u: np.ndarray,
    e: np.ndarray,
    c: np.ndarray,
    shares: np.ndarray,
    smallest: float,
    root: np.ndarray,
    both: np.ndarray,
) -> None:
    """Fill a = root and (a U, a) = both."""
    batch, _, height, width = u.shape
    one, zero = u.dtype.type(1.0), u.dtype.type(0.0)
    least = np.sqrt(smallest)
    for line in numba.prange(batch * height):
        b, row = line // height, line % height
        for k in range(3):
            for i in range(width):
                share = c[b, 0, row, i] * (one - e[b, k, row, i])
                share = zero if share < zero else share
                share = one if share > one else share
                a = np.sqrt(share * shares[k] + smallest) - least
                root[b, k, row, i] = a
                both[b, k, row, i] = a * u[b, k, row, i]
                both[b, 3 + k, row, i] = a


@numba.njit(parallel=True, cache=True, fastmath=ANY_ORDER, error_model="numpy")
def combine(u: np.ndarray, root: np.ndarray, both: np.ndarray, out: np.ndarray) -> None:
    """Fill S."""
    batch, _, height, width = u.shape
    for line in numba.prange(batch * height):
        b, row = line // height, line % height
        for k in range(3):
            for i in range(width):
                light = u[b, k, row, i]
                spread = both[b, k, row, i] - light * both[b, 3 + k, row, i]
                out[b, k, row, i] = light + root[b, k, row, i] * spread


@numba.njit(parallel=True, cache=True, fastmath=ANY_ORDER, error_model="numpy")
def weigh(
    u: np.ndarray, root: np.ndarray, w: np.ndarray, mass: np.ndarray, turned: np.ndarray
) -> None:
    """Fill (w a, w a U) over the area: what g turns into the two transposes, over the area."""
    batch, _, height, width = u.shape
    zero = u.dtype.type(0.0)
    for line in numba.prange(batch * height):
        b, row = line // height, line % height
        for k in range(3):
            for i in range(width):
                here = mass[b, row, i]
                value = w[b, k, row, i] * root[b, k, row, i] / here if here > zero else zero
                turned[b, k, row, i] = value
                turned[b, 3 + k, row, i] = value * u[b, k, row, i]


@numba.njit(parallel=True, cache=True, fastmath=ANY_ORDER, error_model="numpy")
def worths(
    u: np.ndarray,
    e: np.ndarray,
    c: np.ndarray,
    shares: np.ndarray,
    smallest: float,
    root: np.ndarray,
    both: np.ndarray,
    turned: np.ndarray,
    mass: np.ndarray,
    w: np.ndarray,
    of_u: np.ndarray,
    of_e: np.ndarray,
    of_c: np.ndarray,
) -> None:
    """Fill what U, irradiance and translucency are worth."""
    batch, _, height, width = u.shape
    one, zero, half = u.dtype.type(1.0), u.dtype.type(0.0), u.dtype.type(0.5)
    least = np.sqrt(smallest)
    for line in numba.prange(batch * height):
        b, row = line // height, line % height
        for i in range(width):
            of_c[b, 0, row, i] = zero
        for k in range(3):
            for i in range(width):
                here, light, a = mass[b, row, i], u[b, k, row, i], root[b, k, row, i]
                first, second = here * turned[b, k, row, i], here * turned[b, 3 + k, row, i]
                q, worth = both[b, 3 + k, row, i], w[b, k, row, i]
                of_u[b, k, row, i] = worth * (one - a * q) + a * first
                of_a = worth * (both[b, k, row, i] - light * q) + light * first - second
                dark = one - e[b, k, row, i]
                share = c[b, 0, row, i] * dark
                inside = share >= zero and share <= one
                of_share = of_a * half * shares[k] / (a + least) if inside else zero
                of_e[b, k, row, i] = -of_share * c[b, 0, row, i]
                of_c[b, 0, row, i] += of_share * dark


def _array(values: Tensor) -> np.ndarray:
    return values.detach().contiguous().numpy()
