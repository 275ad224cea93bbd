"""Derivatives of the compiled shading for one block of texels and one light, by hand.

With T the way to the light, i = 1 / |T|, a, b, c the cosines at diffuse normal, specular normal and
view, r the reach |P|^2 i^2 and h the cosine at the half vector, a light gives
D = max(a, 0) r seen and S = h^s max(b, 0) r seen. Each function below is one step of the chain rule
from the gradients of D and S (u and w) back to the block's fields.

A function's `buf` is one block, (GRADIENT_ROWS * TEXELS,): rows of `TEXELS` numbers. Its `light` is
(9,), one light of `kernel_forward.pack_lights`. Its `out` is (7,), to which that light's gradients
are added: place (3), |P|^2, red, green and blue.
"""

from __future__ import annotations

import numba
import numpy as np

from learning.render import texel_blocks as rows
from learning.render.lanes_math import ANY_ORDER, exp, log
from learning.render.texel_blocks import INV, LEN, NARROWEST, ND, NS, NSV, SEEN, TEXELS, A, B, S, V

P = rows.P
GE, GL = rows.ROWS, rows.ROWS + 3  # gradients of the sums E and LOBE
GND, GNS, GV, GP = GE + 6, GE + 9, GE + 12, GE + 15
GS, GNSV = GE + 18, GE + 19
# Of one light: gradients of a, b, c, reach and visibility; D and S.
GA, GB, GC, GR, GSEEN, D, SS = GE + 20, GE + 21, GE + 22, GE + 23, GE + 24, GE + 25, GE + 26
GRADIENT_ROWS = GE + 27


@numba.njit(fastmath=ANY_ORDER, error_model="numpy")
def diffuse_gradient(buf: np.ndarray, light: np.ndarray, paper: bool) -> None:
    """Start a light: D, and the gradients of a, the reach and the visibility through it."""
    zero, one = buf.dtype.type(0.0), buf.dtype.type(1.0)
    power, red, green, blue = light[4], light[6], light[7], light[8]
    for t in range(TEXELS):
        u = red * buf[GE * TEXELS + t] + green * buf[(GE + 1) * TEXELS + t]
        u = u + blue * buf[(GE + 2) * TEXELS + t]
        a, inverse, seen = buf[A * TEXELS + t], buf[INV * TEXELS + t], buf[SEEN * TEXELS + t]
        reach = one if paper else power * inverse * inverse
        dark = a < zero and not paper
        cosine = zero if dark else a
        buf[D * TEXELS + t] = cosine * reach * seen
        buf[GA * TEXELS + t] = zero if dark else u * reach * seen
        buf[GR * TEXELS + t] = u * cosine * seen
        buf[GSEEN * TEXELS + t] = u * cosine * reach
        buf[SS * TEXELS + t] = zero
        buf[GB * TEXELS + t] = zero
        buf[GC * TEXELS + t] = zero


@numba.njit(fastmath=ANY_ORDER, error_model="numpy")
def specular_gradient(buf: np.ndarray, light: np.ndarray, paper: bool) -> None:
    """Add the lobe's part: S, and the gradients of b, c, the exponent and the rest through it."""
    zero, one, two = buf.dtype.type(0.0), buf.dtype.type(1.0), buf.dtype.type(2.0)
    narrow, tiny = buf.dtype.type(NARROWEST), buf.dtype.type(1e-30)
    lx, ly, lz, near = light[0], light[1], light[2], light[3]
    power, red, green, blue = light[4], light[6], light[7], light[8]
    for t in range(TEXELS):
        w = red * buf[GL * TEXELS + t] + green * buf[(GL + 1) * TEXELS + t]
        w = w + blue * buf[(GL + 2) * TEXELS + t]
        b, inverse, seen = buf[B * TEXELS + t], buf[INV * TEXELS + t], buf[SEEN * TEXELS + t]
        x = lx - near * buf[P * TEXELS + t]
        y = ly - near * buf[(P + 1) * TEXELS + t]
        z = lz - near * buf[(P + 2) * TEXELS + t]
        c = x * buf[V * TEXELS + t] + y * buf[(V + 1) * TEXELS + t]
        c = (c + z * buf[(V + 2) * TEXELS + t]) * inverse
        wide = two + two * c
        opposite = wide < narrow
        root = one / np.sqrt(narrow if opposite else wide)
        both = b + buf[NSV * TEXELS + t]
        half = both * root
        inside = half > zero and half < one
        half = one if half > one else half
        logarithm = log(tiny if half < tiny else half)
        exponent = buf[S * TEXELS + t]
        lobe = exp(exponent * logarithm)
        lobe = zero if half <= zero else lobe
        reach = one if paper else power * inverse * inverse
        dark = b < zero and not paper
        cosine = zero if dark else (one if paper else b)
        strength = lobe * cosine * reach
        of_reached = w * cosine * reach * seen
        of_half = of_reached * exponent * lobe / half if inside else zero
        buf[SS * TEXELS + t] = strength * seen
        buf[GS * TEXELS + t] += of_reached * lobe * logarithm
        buf[GNSV * TEXELS + t] += of_half * root
        of_cosine = zero if dark or paper else w * lobe * reach * seen
        buf[GB * TEXELS + t] = of_half * root + of_cosine
        buf[GC * TEXELS + t] = zero if opposite else -of_half * both * root * root * root
        buf[GR * TEXELS + t] += w * lobe * cosine * seen
        buf[GSEEN * TEXELS + t] += w * strength


@numba.njit(fastmath=ANY_ORDER, error_model="numpy")
def normal_gradient(buf: np.ndarray, light: np.ndarray) -> None:
    """Add a light's share to the gradients of the two normals."""
    lx, ly, lz, near = light[0], light[1], light[2], light[3]
    for t in range(TEXELS):
        inverse = buf[INV * TEXELS + t]
        x = (lx - near * buf[P * TEXELS + t]) * inverse
        y = (ly - near * buf[(P + 1) * TEXELS + t]) * inverse
        z = (lz - near * buf[(P + 2) * TEXELS + t]) * inverse
        a, b = buf[GA * TEXELS + t], buf[GB * TEXELS + t]
        buf[GND * TEXELS + t] += a * x
        buf[(GND + 1) * TEXELS + t] += a * y
        buf[(GND + 2) * TEXELS + t] += a * z
        buf[GNS * TEXELS + t] += b * x
        buf[(GNS + 1) * TEXELS + t] += b * y
        buf[(GNS + 2) * TEXELS + t] += b * z


@numba.njit(fastmath=ANY_ORDER, error_model="numpy")
def place_gradient(buf: np.ndarray, light: np.ndarray, paper: bool, out: np.ndarray) -> None:
    """Add a light's share to the gradients of position and view, and the light's own to out."""
    zero, two = buf.dtype.type(0.0), buf.dtype.type(2.0)
    lx, ly, lz, near, power, least = light[0], light[1], light[2], light[3], light[4], light[5]
    gx, gy, gz, of_power = zero, zero, zero, zero
    for t in range(TEXELS):
        x = lx - near * buf[P * TEXELS + t]
        y = ly - near * buf[(P + 1) * TEXELS + t]
        z = lz - near * buf[(P + 2) * TEXELS + t]
        inverse = buf[INV * TEXELS + t]
        a, b, c = buf[GA * TEXELS + t], buf[GB * TEXELS + t], buf[GC * TEXELS + t]
        ux = a * buf[ND * TEXELS + t] + b * buf[NS * TEXELS + t] + c * buf[V * TEXELS + t]
        uy = a * buf[(ND + 1) * TEXELS + t] + b * buf[(NS + 1) * TEXELS + t]
        uy = uy + c * buf[(V + 1) * TEXELS + t]
        uz = a * buf[(ND + 2) * TEXELS + t] + b * buf[(NS + 2) * TEXELS + t]
        uz = uz + c * buf[(V + 2) * TEXELS + t]
        reach = zero if paper else buf[GR * TEXELS + t]
        of_inverse = ux * x + uy * y + uz * z + two * power * inverse * reach
        pull = inverse * inverse * inverse * of_inverse
        pull = zero if x * x + y * y + z * z < least else pull
        ux = ux * inverse - pull * x
        uy = uy * inverse - pull * y
        uz = uz * inverse - pull * z
        buf[GP * TEXELS + t] -= near * ux
        buf[(GP + 1) * TEXELS + t] -= near * uy
        buf[(GP + 2) * TEXELS + t] -= near * uz
        c = c * inverse
        buf[GV * TEXELS + t] += c * x
        buf[(GV + 1) * TEXELS + t] += c * y
        buf[(GV + 2) * TEXELS + t] += c * z
        gx += ux
        gy += uy
        gz += uz
        of_power += reach * inverse * inverse
    out[0] += gx
    out[1] += gy
    out[2] += gz
    out[3] += of_power


@numba.njit(fastmath=ANY_ORDER, error_model="numpy")
def colour_gradient(buf: np.ndarray, out: np.ndarray) -> None:
    """Add the gradient of a light's red, green and blue to out[4:7]."""
    for k in range(3):
        total = buf.dtype.type(0.0)
        for t in range(TEXELS):
            total += buf[(GE + k) * TEXELS + t] * buf[D * TEXELS + t]
            total += buf[(GL + k) * TEXELS + t] * buf[SS * TEXELS + t]
        out[4 + k] += total


@numba.njit(fastmath=ANY_ORDER, error_model="numpy")
def through_unit(buf: np.ndarray, vector: int, length: int, gradient: int) -> None:
    """Turn the gradient of a unit vector into that of the vector as given."""
    zero = buf.dtype.type(0.0)
    for t in range(TEXELS):
        x = buf[vector * TEXELS + t]
        y = buf[(vector + 1) * TEXELS + t]
        z = buf[(vector + 2) * TEXELS + t]
        gx = buf[gradient * TEXELS + t]
        gy = buf[(gradient + 1) * TEXELS + t]
        gz = buf[(gradient + 2) * TEXELS + t]
        scale = buf[length * TEXELS + t]
        # A negative scale marks a vector too short for a direction: it was only multiplied.
        along = zero if scale < zero else gx * x + gy * y + gz * z
        scale = abs(scale)
        buf[gradient * TEXELS + t] = (gx - along * x) * scale
        buf[(gradient + 1) * TEXELS + t] = (gy - along * y) * scale
        buf[(gradient + 2) * TEXELS + t] = (gz - along * z) * scale


@numba.njit(fastmath=ANY_ORDER, error_model="numpy")
def finish_block(buf: np.ndarray) -> None:
    """After all lights: specular normal . view, then the three vectors as they were given."""
    for k in range(3):
        for t in range(TEXELS):
            of_dot = buf[GNSV * TEXELS + t]
            buf[(GNS + k) * TEXELS + t] += of_dot * buf[(V + k) * TEXELS + t]
            buf[(GV + k) * TEXELS + t] += of_dot * buf[(NS + k) * TEXELS + t]
    through_unit(buf, ND, LEN, GND)
    through_unit(buf, NS, LEN + 1, GNS)
    through_unit(buf, V, LEN + 2, GV)
