"""What polarisers before lamps and lens make of each lamp's light: two factors a pixel and lamp.

A lamp behind its polariser shines the electric field along `e`, the lens's polariser passes the
field along `a`. Both are axes in the polarisers' planes, projected across the ray.

Specular light is one reflection at a facet whose normal is the half vector h of light direction l
and view direction v. With s across the plane of l and v, and p = k x s across s and the direction
of travel k, a field (e.s, e.p) leaves as (r_s e.s, r_p e.p), r_s and r_p being Fresnel's amplitudes
at the angle between l and h; they are real outside a dielectric, so a linear polarisation stays
linear and the Mueller matrix of the facet comes down to one squared amplitude:

    factor = ((e.s) r_s (s.a) + (e.p_in) r_p (p_out.a))^2 / F,     F = (r_s^2 + r_p^2) / 2

It is what the analyser passes, relative to the unpolarised lobe D G F / (4 n.l n.v): D and G know
nothing of polarisation [Ma2007, Baek2018].

Diffuse light is refracted in at the surface, forgets its polarisation by scattering, and is
refracted out: with Fresnel's transmittances T_s, T_p at the surface's normal, s now across the
normal's own planes with l and with v,

    factor = ((e.s)^2 T_s + (e.p)^2 T_p) / mean(T_s, T_p)       on the way in
           * ((a.s)^2 T_s + (a.p)^2 T_p) / (T_s + T_p)          on the way out

which is one half where l and v are steep, and leaves it only near grazing (Baek's polarised
diffuse lobe). Surfaces' roughness is ignored in T_s : T_p alone.
"""

from __future__ import annotations

import math

import numba
import numpy as np

TINY = 1e-12
"""Squared length under which a cross product has no direction."""


@numba.njit(cache=True, inline="always")
def fresnel_amplitudes(index: float, cosine: float) -> tuple[float, float]:
    """Amplitudes (r_s, r_p) reflected outside a dielectric [CookTorrance1982].

    The sign of r_p is that of p = k x s: at normal incidence r_p = -r_s.

    Args:
        index: of refraction, above 1.
        cosine: of the angle of incidence, 0..1 (clamped).
    """
    c = min(max(cosine, 0.0), 1.0)
    inside = math.sqrt(1.0 - (1.0 - c * c) / (index * index))
    r_s = (c - index * inside) / (c + index * inside)
    r_p = (index * c - inside) / (index * c + inside)
    return r_s, r_p


@numba.njit(cache=True, inline="always")
def _dot(a: tuple, b: tuple) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@numba.njit(cache=True, inline="always")
def _cross(a: tuple, b: tuple) -> tuple[float, float, float]:
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@numba.njit(cache=True)
def _unit_or(a: tuple, other: tuple) -> tuple[float, float, float]:
    """`a` at unit length, or `other` where `a` has none."""
    length2 = _dot(a, a)
    if not length2 > TINY:
        return other
    scale = 1.0 / math.sqrt(length2)
    return (a[0] * scale, a[1] * scale, a[2] * scale)


@numba.njit(cache=True)
def _across(k: tuple) -> tuple[float, float, float]:
    """Some unit vector across the unit vector `k`."""
    if abs(k[0]) < 0.6:
        return _unit_or(_cross(k, (1.0, 0.0, 0.0)), (1.0, 0.0, 0.0))
    return _unit_or(_cross(k, (0.0, 1.0, 0.0)), (0.0, 1.0, 0.0))


@numba.njit(cache=True)
def _projected(axis: tuple, k: tuple) -> tuple[float, float, float]:
    """`axis` made perpendicular to the unit vector `k`, unit; any direction along the ray."""
    along = _dot(axis, k)
    flat = (axis[0] - along * k[0], axis[1] - along * k[1], axis[2] - along * k[2])
    return _unit_or(flat, _across(k))


@numba.njit(cache=True)
def _refracted(axis: tuple, k: tuple, normal: tuple, index: float) -> tuple[float, float, float]:
    """Transmittance of the field along `axis` and across it, and their mean, at direction `k`."""
    r_s, r_p = fresnel_amplitudes(index, _dot(normal, k))
    t_s, t_p = 1.0 - r_s * r_s, 1.0 - r_p * r_p
    share = _dot(axis, _unit_or(_cross(normal, k), axis))
    share *= share
    along = share * t_s + (1.0 - share) * t_p
    return along, t_s + t_p - along, 0.5 * (t_s + t_p)


@numba.njit(cache=True, parallel=True)
def factors_kernel(
    position: np.ndarray,
    normal: np.ndarray,
    view: np.ndarray,
    lamps: np.ndarray,
    lamp_axes: np.ndarray,
    analyser: np.ndarray,
    index: float,
    lamp_share: float,
    leak: float,
    diffuse: np.ndarray,
    specular: np.ndarray,
) -> None:
    """Fill `diffuse` and `specular` (n, k); see `polarised_factors`."""
    for i in numba.prange(len(position)):
        n = (float(normal[i, 0]), float(normal[i, 1]), float(normal[i, 2]))
        v = (float(view[i, 0]), float(view[i, 1]), float(view[i, 2]))
        a = _projected((analyser[0], analyser[1], analyser[2]), v)
        b = _cross(v, a)
        out_a, out_b, out_mean = _refracted(a, v, n, index)
        # A grazing ray brings nothing out; the shading there is zero whatever the factor.
        leaves = 0.5 * (out_a + leak * out_b) / max(out_mean, TINY)
        for k in range(len(lamps)):
            ray = (
                lamps[k, 0] - position[i, 0],
                lamps[k, 1] - position[i, 1],
                lamps[k, 2] - position[i, 2],
            )
            to = _unit_or(ray, v)
            e = _projected((lamp_axes[k, 0], lamp_axes[k, 1], lamp_axes[k, 2]), to)
            f = _cross(to, e)
            in_e, in_f, in_mean = _refracted(e, to, n, index)
            enters = (lamp_share * in_e + (1.0 - lamp_share) * in_f) / max(in_mean, TINY)
            diffuse[i, k] = enters * leaves
            # Light straight back has no plane of incidence, and every one gives the same.
            s = _unit_or(_cross(to, v), _across(v))
            p_in = _cross((-to[0], -to[1], -to[2]), s)
            p_out = _cross(v, s)
            r_s, r_p = fresnel_amplitudes(index, math.sqrt(max(0.5 * (1.0 + _dot(to, v)), 0.0)))
            s_a, p_a = r_s * _dot(s, a), r_p * _dot(p_out, a)
            s_b, p_b = r_s * _dot(s, b), r_p * _dot(p_out, b)
            s_e, p_e, s_f, p_f = _dot(e, s), _dot(e, p_in), _dot(f, s), _dot(f, p_in)
            of_e = (s_e * s_a + p_e * p_a) ** 2 + leak * (s_e * s_b + p_e * p_b) ** 2
            of_f = (s_f * s_a + p_f * p_a) ** 2 + leak * (s_f * s_b + p_f * p_b) ** 2
            through = lamp_share * of_e + (1.0 - lamp_share) * of_f
            specular[i, k] = 2.0 * through / (r_s * r_s + r_p * r_p)


def polarised_factors(
    position: np.ndarray,
    normal: np.ndarray,
    view: np.ndarray,
    lamps_mm: np.ndarray,
    lamp_axes: np.ndarray,
    analyser: np.ndarray,
    index: float,
    lamp_extinction: float,
    analyser_extinction: float,
) -> tuple[np.ndarray, np.ndarray]:
    """What polarisers make of each lamp's diffuse and specular light at each point.

    Args:
        position: (n, 3) mm.
        normal: (n, 3) unit, that shade.
        view: (n, 3) unit, to the camera.
        lamps_mm: (k, 3).
        lamp_axes: (k, 3) unit: the field that each lamp's polariser passes.
        analyser: (3,) unit: the field that the lens's polariser passes.
        index: of refraction of the skin, above 1.
        lamp_extinction: how many times more of the wanted field than of the other one leaves a
            lamp; 1 is no polariser.
        analyser_extinction: the same of the lens's; the wanted field passes whole.

    Returns:
        (n, k) float32 factors of the diffuse, and (n, k) of the specular light that the same lamp,
        equally strong without polarisation, would send into a lens without one. Finite everywhere
        that the input is; a point at a lamp or of no normal gets some finite factor.
    """
    shape = (len(position), len(lamps_mm))
    diffuse, specular = np.empty(shape, np.float32), np.empty(shape, np.float32)
    factors_kernel(
        *(np.ascontiguousarray(a, np.float32) for a in (position, normal, view)),
        *(np.ascontiguousarray(a, np.float64) for a in (lamps_mm, lamp_axes, analyser)),
        float(index),
        1.0 / (1.0 + 1.0 / lamp_extinction),
        1.0 / analyser_extinction,
        diffuse,
        specular,
    )
    return diffuse, specular
