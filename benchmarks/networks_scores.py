"""Figures of found maps against true ones, and how those of many textures become one."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np

from lightstage.formats.environment import LightSet
from processing.colour import srgb_from_linear

PATCHES = 12
"""Patches a texture's rows hold; detail is what varies within them."""
PATCH_SKIN = 0.9
CONFIDENCE_TEXELS = 3000


@dataclasses.dataclass(frozen=True)
class Albedo:
    """Of one texture's diffuse albedo over its skin.

    Attributes:
        raw: mean square error, sRGB-encoded.
        gain: the same after the best gain a channel, which nobody knows of a real person.
        detail: product and norms of what patches show beyond their mean, for a correlation.
    """

    raw: float
    gain: float
    detail: tuple[float, float]


@dataclasses.dataclass(frozen=True)
class Other:
    """Of one texture's other maps.

    Attributes:
        specular: squared error of the specular albedo, sum and sum of squares of the true one,
            and how many texels these sums have.
        normal_deg: mean error of the found diffuse and specular normals and, in the same order, of
            the mesh's own.
        relit: mean square error of the head in each new light, sRGB-encoded.
        confidence: (n, 2) of some texels: confidence and mean error of the albedo, sRGB-encoded.
        light_deg: from the strongest lamp found to the strongest there is.
    """

    specular: tuple[float, float, float, float]
    normal_deg: tuple[float, float, float, float]
    relit: tuple[float, ...]
    confidence: np.ndarray
    light_deg: float


def albedo_score(found: np.ndarray, true: np.ndarray, skin: np.ndarray) -> Albedo:
    """Score a (rows, columns, 3) linear albedo over (rows, columns) skin."""
    gain = (found * true)[skin].sum(0) / np.maximum((found**2)[skin].sum(0), 1e-12)
    return Albedo(
        squared(found[skin], true[skin]),
        squared((found * gain)[skin], true[skin]),
        detail(found, true, skin),
    )


def squared(found: np.ndarray, true: np.ndarray) -> float:
    """Mean square error of sRGB-encoded colours."""
    return float(np.square(srgb_from_linear(found) - srgb_from_linear(true)).mean())


def detail(found: np.ndarray, true: np.ndarray, skin: np.ndarray) -> tuple[float, float]:
    """Product and norms of what patches show beyond their mean, for a correlation."""
    product = 0.0
    squares = np.zeros(2)
    side = max(1, skin.shape[0] // PATCHES)
    for row in range(0, skin.shape[0] - side + 1, side):
        for column in range(0, skin.shape[1] - side + 1, side):
            here = (slice(row, row + side), slice(column, column + side))
            known = skin[here]
            if known.mean() < PATCH_SKIN:
                continue
            both = [srgb_from_linear(image[here][known]) for image in (found, true)]
            both = [values - values.mean(axis=0) for values in both]
            product += float((both[0] * both[1]).sum())
            squares += [float((values**2).sum()) for values in both]
    return product, float(np.sqrt(squares.prod()))


def specular_sums(found: np.ndarray, true: np.ndarray) -> tuple[float, float, float, float]:
    """See `Other.specular`; both (n,)."""
    error = np.square(found.astype(float) - true).sum()
    return float(error), float(true.sum()), float(np.square(true, dtype=float).sum()), len(true)


def angle_deg(one: np.ndarray, other: np.ndarray) -> float:
    """Mean angle between (n, 3) unit vectors."""
    cosine = np.clip((one * other).sum(axis=1, dtype=float), -1, 1)
    return float(np.degrees(np.arccos(cosine)).mean())


def light_deg(found: LightSet | None, true: LightSet) -> float:
    """Angle at the origin between the strongest lamp that was found and the strongest there is."""
    if found is None or not len(found.rgb):
        return 180.0
    places = [s.position_mm[s.rgb.sum(axis=1).argmax()] for s in (found, true)]
    one, other = (place / np.linalg.norm(place) for place in places)
    return float(np.degrees(np.arccos(np.clip(one @ other, -1, 1))))


def db(squares: Iterable[float]) -> float:
    """PSNR of the mean of mean square errors; NaN of none."""
    values = list(squares)
    return -10 * float(np.log10(max(float(np.mean(values)), 1e-12))) if values else float("nan")


def correlation(parts: Iterable[tuple[float, float]]) -> float:
    """Of `detail` over many textures."""
    product, norms = np.sum(list(parts), axis=0)
    return float(product / max(norms, 1e-12))


def specular_share(sums: Iterable[tuple[float, float, float, float]]) -> float:
    """Error of the specular albedo over that of the constant that is best for all textures."""
    error, total, squares, count = np.sum(list(sums), axis=0)
    constant = squares - total**2 / max(count, 1)
    return float(np.sqrt(error / max(constant, 1e-30)))


def deciles(confidence: np.ndarray) -> list[float]:
    """Mean error of each tenth, the least sure first, of (n, 2) confidences and errors."""
    order = np.argsort(confidence[:, 0], kind="stable")
    return [float(part.mean()) for part in np.array_split(confidence[order, 1], 10)]
