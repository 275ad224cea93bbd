"""The compiled scattering S = U + a g(a U) - a U g(a), and its gradient by hand.

With g's transpose written g', w = the gradient with respect to S:
of U: w (1 - a g(a)) + a g'(w a), and of a: w (g(a U) - U g(a)) + U g'(w a) - g'(w a U).

Arrays of a tuple are given names before a parallel loop: numba drops writes through a tuple's
attribute inside one.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from learning.render.diffusion import Diffusion
from learning.render.fused import array_of
from learning.render.lanes_math import ANY_ORDER


class Fields(NamedTuple):
    """The three inputs, or the gradients with respect to them.

    Attributes:
        u: (B, 3, H, W) diffuse light.
        e: (B, 3, H, W) irradiance.
        c: (B, 1, H, W) translucency.
    """

    u: np.ndarray
    e: np.ndarray
    c: np.ndarray


class Shares(NamedTuple):
    """How much of each channel scatters: (3,), and what is added to keep slopes of roots finite."""

    weights: np.ndarray
    smallest: float


class Spread(NamedTuple):
    """a, and (g(a U), g(a)): (B, 3, H, W) and (B, 6, H, W)."""

    root: np.ndarray
    both: np.ndarray


class OutputGradient(NamedTuple):
    """Gradient of S (B, 3, H, W), a texel's area (B, H, W), and g of (w a, w a U) / area."""

    w: np.ndarray
    mass: np.ndarray
    turned: np.ndarray


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
        fields = Fields(array_of(diffuse), array_of(irradiance), array_of(translucency))
        batch, channels, height, width = fields.u.shape
        kind = fields.u.dtype
        shares = Shares(np.array(weights, kind), kind.type(smallest))
        both = np.empty((batch, 2 * channels, height, width), kind)
        spread = Spread(np.empty_like(fields.u), both)
        prepare(fields, shares, spread)
        diffusion.spread_in_place(both)
        out = np.empty_like(fields.u)
        combine(fields.u, spread, out)
        ctx.save_for_backward(diffuse, irradiance, translucency)
        ctx.kept = (diffusion, shares, spread)
        return torch.from_numpy(out)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        """Gradients of the three fields."""
        fields = Fields(*(array_of(x) for x in ctx.saved_tensors))
        diffusion, shares, spread = ctx.kept
        backward_state = OutputGradient(
            array_of(gradient), diffusion.mass.numpy(), np.empty_like(spread.both)
        )
        weigh(fields.u, spread.root, backward_state)
        diffusion.spread_in_place(backward_state.turned)
        of = Fields(*(np.empty_like(x) for x in fields))
        gradients(fields, shares, spread, backward_state, of)
        return (*(torch.from_numpy(x) for x in of), None, None, None)


@numba.njit(parallel=True, cache=True, fastmath=ANY_ORDER, error_model="numpy")
def prepare(fields: Fields, shares: Shares, spread: Spread) -> None:
    """Fill a and (a U, a)."""
    u, e, c = fields
    root, both = spread
    batch, channels, height, width = u.shape
    one, zero = u.dtype.type(1.0), u.dtype.type(0.0)
    least = np.sqrt(shares.smallest)
    for line in numba.prange(batch * height):
        b, row = line // height, line % height
        for k in range(channels):
            for i in range(width):
                share = c[b, 0, row, i] * (one - e[b, k, row, i])
                share = zero if share < zero else share
                share = one if share > one else share
                a = np.sqrt(share * shares.weights[k] + shares.smallest) - least
                root[b, k, row, i] = a
                both[b, k, row, i] = a * u[b, k, row, i]
                both[b, channels + k, row, i] = a


@numba.njit(parallel=True, cache=True, fastmath=ANY_ORDER, error_model="numpy")
def combine(u: np.ndarray, spread: Spread, out: np.ndarray) -> None:
    """Fill `out`, S (B, 3, H, W), from U (B, 3, H, W)."""
    batch, channels, height, width = u.shape
    root, both = spread
    for line in numba.prange(batch * height):
        b, row = line // height, line % height
        for k in range(channels):
            for i in range(width):
                light = u[b, k, row, i]
                gained = both[b, k, row, i] - light * both[b, channels + k, row, i]
                out[b, k, row, i] = light + root[b, k, row, i] * gained


@numba.njit(parallel=True, cache=True, fastmath=ANY_ORDER, error_model="numpy")
def weigh(u: np.ndarray, root: np.ndarray, gradient: OutputGradient) -> None:
    """Fill (w a, w a U) / area, which g turns into the two transposes over the area."""
    w, mass, turned = gradient
    batch, channels, height, width = u.shape
    zero = u.dtype.type(0.0)
    for line in numba.prange(batch * height):
        b, row = line // height, line % height
        for k in range(channels):
            for i in range(width):
                here = mass[b, row, i]
                value = w[b, k, row, i] * root[b, k, row, i] / here if here > zero else zero
                turned[b, k, row, i] = value
                turned[b, channels + k, row, i] = value * u[b, k, row, i]


@numba.njit(parallel=True, cache=True, fastmath=ANY_ORDER, error_model="numpy")
def gradients(
    fields: Fields, shares: Shares, spread: Spread, gradient: OutputGradient, of: Fields
) -> None:
    """Fill the gradients of U, irradiance and translucency."""
    u, e, c = fields
    root, both = spread
    w, mass, turned = gradient
    of_u, of_e, of_c = of
    batch, channels, height, width = u.shape
    one, zero, half = u.dtype.type(1.0), u.dtype.type(0.0), u.dtype.type(0.5)
    least = np.sqrt(shares.smallest)
    for line in numba.prange(batch * height):
        b, row = line // height, line % height
        of_c[b, 0, row] = zero
        for k in range(channels):
            for i in range(width):
                here, light, a = mass[b, row, i], u[b, k, row, i], root[b, k, row, i]
                first = here * turned[b, k, row, i]
                second = here * turned[b, channels + k, row, i]
                q, of_s = both[b, channels + k, row, i], w[b, k, row, i]
                of_u[b, k, row, i] = of_s * (one - a * q) + a * first
                of_a = of_s * (both[b, k, row, i] - light * q) + light * first - second
                dark = one - e[b, k, row, i]
                share = c[b, 0, row, i] * dark
                inside = share >= zero and share <= one
                of_share = of_a * half * shares.weights[k] / (a + least) if inside else zero
                of_e[b, k, row, i] = -of_share * c[b, 0, row, i]
                of_c[b, 0, row, i] += of_share * dark
