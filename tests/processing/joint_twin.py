"""The joint solve in plain float64: dense matrices, and differences in place of derivatives."""

from __future__ import annotations

import dataclasses

import numpy as np

from processing.lighting.facets import Facets
from processing.lighting.fresnel import fresnel
from processing.lighting.interface import ROUGHNESS_RANGE, Interface
from processing.lighting.lights import PatternLights, cells_of
from processing.refinement.joint import Noise

STEP = 1e-6
SKIN = ((1.4 - 1) / (1.4 + 1)) ** 2
TABLE = fresnel(0.028, np.linspace(0, 1, 257)) / 0.028


@dataclasses.dataclass(frozen=True)
class Pixel:
    """What is given of one pixel that sees every light.

    Attributes:
        rgb: (P, 3).
        point_mm, view, start: (3,).
        roughness, specular: of its gloss.
        bounced: (P, 3) irradiance by light from other skin.
        kept: (3,).
        rest: (P, 3) what wanders here from neighbours.
        mirrored: (L,) share of each lamp's mirror reflection that the camera gets.
        diffuse: (cells, P) share of each normal's diffuse light that the camera gets.
    """

    rgb: np.ndarray
    point_mm: np.ndarray
    view: np.ndarray
    start: np.ndarray
    roughness: float
    specular: float
    bounced: np.ndarray
    kept: np.ndarray
    rest: np.ndarray
    mirrored: np.ndarray
    diffuse: np.ndarray

    def reaching(self, normal: np.ndarray) -> np.ndarray:
        """(P,) share of the diffuse light of a normal that the camera gets."""
        cell = cells_of(normal[None])[0] if len(self.diffuse) > 1 else 0
        return np.asarray(self.diffuse[cell])


def entering(interface: Interface, cosine: np.ndarray, roughness: float) -> np.ndarray:
    """Share of light that enters, linearly between the table's places."""
    rows = np.linspace(*ROUGHNESS_RANGE, len(interface.table))
    grid = np.linspace(0, 1, interface.table.shape[1])
    each = np.stack([np.interp(cosine, grid, row) for row in interface.table.astype(float)])
    place = np.interp(roughness, rows, np.arange(len(rows)))
    low = min(int(place), len(rows) - 2)
    return np.asarray(each[low] * (1 - (place - low)) + each[low + 1] * (place - low))


def kept_mean(interface: Interface, roughness: float) -> float:
    rows = np.linspace(*ROUGHNESS_RANGE, len(interface.table))
    return float(np.interp(roughness, rows, interface.mean.astype(float)))


def unmasked(direction: np.ndarray, normal: np.ndarray, own: float, facets: Facets) -> np.ndarray:
    """Smith's G1 of (..., 3) directions."""
    cosine = np.maximum(direction @ normal, 1e-9)
    sideways, upward = across_of(direction, normal, normal)
    slope = own * np.sqrt((sideways * facets.stretch) ** 2 + (upward / facets.stretch) ** 2)
    if facets.tails:
        return np.asarray(2 / (1 + np.sqrt(1 + (slope / cosine) ** 2)))
    a = cosine / np.maximum(slope, 1e-15)
    fitted = (3.535 * a + 2.181 * a**2) / (1 + 2.276 * a + 2.577 * a**2)
    return np.asarray(np.where(a < 1.6, fitted, 1.0))


def across_of(
    direction: np.ndarray, normal: np.ndarray, base: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Parts of (..., 3) directions along and across base's horizontal tangent, made orthogonal."""
    unit = normal / np.linalg.norm(normal)
    tangent = np.cross([0.0, 1.0, 0.0], base)
    tangent -= (tangent @ unit) * unit
    tangent /= np.linalg.norm(tangent)
    return direction @ tangent, direction @ np.cross(unit, tangent)


def spread(
    half: np.ndarray, normal: np.ndarray, base: np.ndarray, m: float, facets: Facets
) -> np.ndarray:
    """Pi times the distribution, times m^2 cos^4, of (..., 3) half vectors."""
    nh2 = (half @ normal) ** 2
    if facets.stretch == 1:
        steep = (1 - nh2) / (nh2 * m**2)
    else:
        sideways, upward = across_of(half, normal, base)
        steep = (sideways / facets.stretch) ** 2 + (upward * facets.stretch) ** 2
        steep = steep / (nh2 * m**2)
    return np.asarray(1 / (1 + steep) ** 2 if facets.tails else np.exp(-steep))


@dataclasses.dataclass(frozen=True)
class Light:
    """E and B of one pixel as functions of the normal and the lobe's width.

    What passes the interface and the lobe's shadowing stay those of `base` and of the pixel's
    width: a small turn changes them little, and the solve leaves that out.
    """

    lights: PatternLights
    pixel: Pixel
    interface: Interface
    base: np.ndarray

    def parts(self, normal: np.ndarray, roughness: float) -> tuple[np.ndarray, np.ndarray]:
        """(P,) E and (P,) B."""
        lights, pixel, own = self.lights, self.pixel, self.pixel.roughness
        to_light = lights.position_mm - pixel.point_mm
        distance = np.linalg.norm(to_light, axis=1)
        to_light = to_light / distance[:, None]
        base_nl = to_light @ self.base
        strength = lights.strength * (lights.radius_mm / distance) ** 2 * (base_nl > 0)
        base_nv = max(float(self.base @ pixel.view), 0.05)
        leaving = entering(self.interface, np.array(base_nv), own) / kept_mean(self.interface, own)
        enters = leaving * entering(self.interface, np.maximum(base_nl, 0), own)
        e = strength @ (enters * (to_light @ normal)) * pixel.reaching(self.base)
        half = to_light + pixel.view
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        base_nh = half @ self.base
        facets = self.interface.facets
        widest = own * max(facets.stretch, 1 / facets.stretch)
        inside = (base_nh > 0) & (facets.tails | ((1 - base_nh**2) <= 9.0 * widest**2 * base_nh**2))
        nh2 = (half @ normal) ** 2
        # Only the way to the camera turns the cosine that the lobe is divided by.
        nv = base_nv + float((normal - self.base) @ pixel.view)
        lobe = spread(half, normal, self.base, roughness, facets)
        lobe = lobe / (4 * roughness**2 * nh2**2 * nv)
        shadows = unmasked(pixel.view, self.base, own, facets)
        shadows = shadows * unmasked(to_light, self.base, own, facets)
        table = TABLE if facets.rises else np.ones_like(TABLE)
        fresnel = np.interp(half @ pixel.view, np.linspace(0, 1, 257), table)
        lobe = np.where(inside, lobe * shadows * fresnel, 0)
        return e, strength @ (lobe * pixel.mirrored)

    def across(self) -> np.ndarray:
        """(2, 3) two unit directions across the base."""
        helper = np.eye(3)[0 if abs(self.base[0]) < 0.6 else 1]
        first = np.cross(self.base, helper)
        first /= np.linalg.norm(first)
        return np.stack([first, np.cross(self.base, first)])

    def slopes(self, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(P,) changes of E and B with a turn toward a direction."""
        ahead = self.parts(self.base + STEP * direction, self.pixel.roughness)
        behind = self.parts(self.base - STEP * direction, self.pixel.roughness)
        return (ahead[0] - behind[0]) / (2 * STEP), (ahead[1] - behind[1]) / (2 * STEP)

    def slope_of_width(self) -> np.ndarray:
        """(P,) change of B with the lobe's width."""
        m = self.pixel.roughness
        ahead, behind = (self.parts(self.base, m + d)[1] for d in (STEP, -STEP))
        return np.asarray((ahead - behind) / (2 * STEP))

    def bounced(self) -> np.ndarray:
        """(P, 3) what the light from other skin adds to the irradiance."""
        nv = np.array(max(float(self.base @ self.pixel.view), 0.05))
        inside = entering(self.interface, nv, self.pixel.roughness)
        return np.asarray(inside * self.pixel.reaching(self.base)[:, None] * self.pixel.bounced)


def albedo_of(diffuse: np.ndarray, rgb: np.ndarray, mirror: np.ndarray) -> np.ndarray:
    """(3,) least squares with (P,) mirror light taken off."""
    return np.asarray((diffuse * (rgb - mirror[:, None])).sum(axis=0) / (diffuse**2).sum(axis=0))


def inverse_covariance(rgb: np.ndarray, shade: np.ndarray, noise: Noise) -> np.ndarray:
    """(3 P, 3 P): each reading's own variance, and what errs in a pattern's channels together."""
    bright = np.maximum(rgb, 0)
    variance = noise.sensor**2 * (noise.floor + bright) + noise.model**2 * bright**2
    full = np.diag(variance.ravel())
    for k in range(len(rgb)):
        place = slice(3 * k, 3 * k + 3)
        full[place, place] += noise.shade**2 * np.outer(shade[k], shade[k])
    return np.linalg.inv(full)


@dataclasses.dataclass(frozen=True)
class Linear:
    """The model about one normal.

    Attributes:
        jacobian: (3 P, 5) over two turns and three albedos.
        residual: (3 P,).
        weight: (3 P, 3 P) inverse covariance.
        gloss: (3 P, 2) over specular albedo and lobe width.
    """

    jacobian: np.ndarray
    residual: np.ndarray
    weight: np.ndarray
    gloss: np.ndarray


def linear(light: Light, noise: Noise) -> Linear:
    """The model of a pixel's readings about a light's base normal."""
    pixel, s = light.pixel, light.pixel.specular
    e, b = light.parts(light.base, pixel.roughness)
    diffuse = np.maximum(pixel.kept * e[:, None] + pixel.rest, 0) + light.bounced()
    rho = albedo_of(diffuse, pixel.rgb, s * b)
    columns = []
    for direction in light.across():
        de, db = light.slopes(direction)
        columns.append((rho * pixel.kept * de[:, None] + s * db[:, None]).ravel())
    for channel in range(3):
        columns.append((diffuse * np.eye(3)[channel]).ravel())
    shade = rho * diffuse
    white = np.ones(3)
    return Linear(
        np.stack(columns, axis=1),
        (pixel.rgb - shade - s * b[:, None]).ravel(),
        inverse_covariance(pixel.rgb, shade, noise),
        np.stack(
            [np.outer(b, white).ravel(), np.outer(s * light.slope_of_width(), white).ravel()],
            axis=1,
        ),
    )


def step(
    lights: PatternLights, pixel: Pixel, interface: Interface, noise: Noise
) -> dict[str, np.ndarray | float]:
    """One step of Gauss-Newton: what `joint.solve_jointly` returns of one pixel."""
    light = Light(lights, pixel, interface, pixel.start)
    model = linear(light, noise)
    normal_matrix = model.jacobian.T @ model.weight @ model.jacobian
    found = np.linalg.solve(normal_matrix, model.jacobian.T @ model.weight @ model.residual)
    turn = found[:2] * min(1.0, 0.15 / np.linalg.norm(found[:2]))
    normal = pixel.start + turn @ light.across()
    normal /= np.linalg.norm(normal)
    moved = normal - pixel.start
    e, b = light.parts(pixel.start, pixel.roughness)
    de, db = light.slopes(moved)
    e, b = e + de, b + db
    diffuse = np.maximum(pixel.kept * e[:, None] + pixel.rest, 0) + light.bounced()
    rho = albedo_of(diffuse, pixel.rgb, pixel.specular * b)
    shade = rho * diffuse
    left = (pixel.rgb - shade - pixel.specular * b[:, None]).ravel()
    weight = inverse_covariance(pixel.rgb, shade, noise)
    covariance = np.linalg.inv(normal_matrix)[:2, :2]
    return {
        "normal": normal,
        "albedo": rho,
        "power": (diffuse**2).sum(axis=0),
        "irradiance": e,
        "misfit": float(left @ weight @ left) / (3 * len(e) - 5),
        "certainty": 1 / float(np.linalg.eigvalsh(covariance)[-1]),
    }


def matte(
    lights: PatternLights, pixel: Pixel, interface: Interface, noise: Noise
) -> tuple[np.ndarray, float]:
    """(3,) unit normal from chroma about the start, and the mean squared turn noise gives it."""
    light = Light(lights, pixel, interface, pixel.start)
    # E is linear in the normal for a fixed horizon: its values along the axes are its slope.
    slopes = np.stack([light.slopes(axis)[0] for axis in np.eye(3)], axis=1)
    e, b = light.parts(light.base, pixel.roughness)
    diffuse = np.maximum(pixel.kept * e[:, None] + pixel.rest, 0) + light.bounced()
    rho = albedo_of(diffuse, pixel.rgb, pixel.specular * b)
    hue = (pixel.rgb - pixel.rgb.mean(axis=1, keepdims=True)).sum(axis=0)
    hue /= np.linalg.norm(hue)
    signal = (pixel.rgb - rho * light.bounced() - pixel.specular * b[:, None]) @ hue
    found = np.linalg.lstsq(slopes, signal, rcond=None)[0]
    length = np.linalg.norm(found)
    bright = np.maximum(pixel.rgb, 0)
    variance = (noise.sensor**2 * (noise.floor + bright) + noise.model**2 * bright**2) @ hue**2
    covariance = np.linalg.inv(slopes.T @ slopes) * variance.mean()
    across = np.eye(3) - np.outer(found, found) / length**2
    turn2 = np.trace(across @ covariance @ across) / length**2
    return np.asarray(found / length), float(turn2)


def held_out(
    lights: PatternLights, pixel: Pixel, interface: Interface, noise: Noise, groups: np.ndarray
) -> np.ndarray:
    """(G,) of `joint.held_out`: each group predicted from a fit of the others, and its variance."""
    model = linear(Light(lights, pixel, interface, pixel.start), noise)
    of_reading = np.repeat(groups, 3)
    out = []
    for group in range(groups.max() + 1):
        own, others = of_reading == group, of_reading != group
        fit, asked = model.jacobian[others], model.jacobian[own]
        weight = model.weight[np.ix_(others, others)]
        covariance = np.linalg.inv(fit.T @ weight @ fit)
        step = covariance @ fit.T @ weight @ model.residual[others]
        off = model.residual[own] - asked @ step
        spread = np.linalg.inv(model.weight[np.ix_(own, own)]) + asked @ covariance @ asked.T
        out.append(float(off @ np.linalg.solve(spread, off)) / own.sum())
    return np.array(out)


def evidence(lights: PatternLights, pixel: Pixel, interface: Interface, noise: Noise) -> np.ndarray:
    """(5,) of `joint.gloss_evidence`, by projection onto what turns and albedos cannot explain."""
    model = linear(Light(lights, pixel, interface, pixel.start), noise)
    whitening = np.linalg.cholesky(model.weight).T
    basis, _ = np.linalg.qr(whitening @ model.jacobian)

    def unexplained(columns: np.ndarray) -> np.ndarray:
        white = whitening @ columns
        return np.asarray(white - basis @ (basis.T @ white))

    gloss, left = unexplained(model.gloss), unexplained(model.residual)
    outside = float(left @ left) / (len(left) - 7)
    trust = 1 / (1 + outside / 9) ** 2
    both = gloss.T @ gloss
    pulls = gloss.T @ left
    return trust * np.array([both[0, 0], both[0, 1], both[1, 1], pulls[0], pulls[1]])
