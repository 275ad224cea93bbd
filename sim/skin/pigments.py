"""Skin's colour from its pigments: melanin over haemoglobin, wavelength by wavelength.

Two layers after [Donner2006]: an epidermis of fixed thickness that holds melanin, over an endless
dermis that holds blood. Absorption and scattering per mm, wavelength l in nm:

    eumelanin    6.6e10 l^-3.33          base   .0244 + 8.53 exp(-(l - 154) / 66.2)
    pheomelanin  2.9e14 l^-4.75          scattering  14.74 l^-.22 + 2.2e11 l^-4, dermis half of it
    epidermis    C_m (B_m eu + (1 - B_m) ph) + (1 - C_m) base
    dermis       C_h (s HbO2 + (1 - s) Hb) + (1 - C_h) base

Haemoglobin's molar extinction is Prahl's compilation [Prahl1999] at 150 g/l of 64,500 g/mol. The
dermis reflects diffusely R_d = (a'/2)(1 + exp(-4 A q / 3)) exp(-q), q = sqrt(3 (1 - a')),
A = (1 + F) / (1 - F) [Jensen2001].

With an epidermis that only absorbs, R = R_d exp(-4 mu d), dark skin comes out far too dark in blue
and light skin too dark in red. Two corrections, each one number (`PigmentConfig`), carry the model
to the two skin patches of the classic 24-patch chart: the epidermis also scatters back
(Kubelka-Munk [KubelkaMunk1931] with K = 2 mu and S = `backscatter` x scattering), which sets a
floor that no melanin takes away; and the bloodless dermis absorbs only `dermis_base` of the base.

The spectra are our own: colour-science has none of blood and melanin, and its tables of the CIE
differ from the fit of [Wyman2013] by some hundredths, so that every simulated person would change.
"""

from __future__ import annotations

import dataclasses
import functools

import cv2
import numpy as np

WAVELENGTHS_NM = np.arange(390.0, 721.0, 10.0)

# Molar extinction, cm^-1 per mol/l, every 10 nm from 390 to 720: oxygenated and not [Prahl1999].
_OXY = np.array(
    [
        167748, 266232, 466840, 480360, 246072, 102580, 62816, 44480, 33209.2, 26629.2, 23684.4,
        20932.8, 20035.2, 24202.4, 39956.8, 53236, 43016, 32613.2, 44496, 50104, 14400.8, 3200,
        1506, 942, 610, 442, 368, 319.6, 294, 277.6, 276, 290, 314, 348,
    ]
)  # fmt: skip
_DEOXY = np.array(
    [
        167780, 223296, 303956, 407560, 528600, 413280, 103292, 23388.8, 16156.4, 14550, 16684,
        20862, 25773.6, 31589.6, 39036.4, 46592, 53412, 53788, 45072, 37020, 28324.4, 14677.2,
        9443.6, 6509.6, 5148.8, 4345.2, 3750.12, 3226.56, 2795.12, 2407.92, 2051.96, 1794.28,
        1540.48, 1325.88,
    ]
)  # fmt: skip
_HAEMOGLOBIN_G_PER_L, _HAEMOGLOBIN_G_PER_MOL = 150.0, 64_500.0
_INTERNAL_REFLECTION = 0.53
"""Diffuse light inside the skin (n = 1.4) that its surface sends back."""

# Linear sRGB from XYZ, white at D65 [IEC61966]; cone space of Bradford's adaptation [Lam1985].
_RGB_FROM_XYZ = np.array(
    [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]
)
_BRADFORD = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)
D65_XYZ = np.array([0.95047, 1.0, 1.08883])

MELANIN_RANGE = (0.001, 0.6)
BLOOD_RANGE = (0.001, 0.4)
_TABLE_MELANIN, _TABLE_BLOOD = 160, 96


@dataclasses.dataclass(frozen=True)
class PigmentConfig:
    """The two-layer model's constants.

    Attributes:
        epidermis_mm: its thickness.
        oxygenated: share of haemoglobin that carries oxygen.
        backscatter: share of the scattering coefficient that sends light back in the epidermis.
        dermis_base: share of the base absorption that the bloodless dermis has.
    """

    epidermis_mm: float = 0.06
    oxygenated: float = 0.75
    backscatter: float = 0.5
    dermis_base: float = 0.2


def haemoglobin(oxygenated: float) -> np.ndarray:
    """(34,) absorption per mm of whole blood at `WAVELENGTHS_NM`; share 0..1 oxygenated."""
    molar = oxygenated * _OXY + (1 - oxygenated) * _DEOXY
    return 2.303 * molar * _HAEMOGLOBIN_G_PER_L / _HAEMOGLOBIN_G_PER_MOL / 10.0


def reflectance(
    melanin: np.ndarray | float,
    blood: np.ndarray | float,
    eumelanin: float,
    config: PigmentConfig | None = None,
) -> np.ndarray:
    """Diffuse albedo of skin at `WAVELENGTHS_NM`.

    Args:
        melanin: (...) C_m, volume fraction of melanin in the epidermis, 0..1.
        blood: (...) C_h, volume fraction of blood in the dermis, 0..1.
        eumelanin: B_m, share of eumelanin in melanin, 0..1.
        config: the model's constants.

    Returns:
        (..., 34) float64, 0..1: exitant over incident for light that entered.
    """
    c = config or PigmentConfig()
    wave = WAVELENGTHS_NM
    m, h = np.asarray(melanin, float)[..., None], np.asarray(blood, float)[..., None]
    pigment = eumelanin * 6.6e10 * wave**-3.33 + (1 - eumelanin) * 2.9e14 * wave**-4.75
    base = 0.0244 + 8.53 * np.exp(-(wave - 154) / 66.2)
    scattering = 14.74 * wave**-0.22 + 2.2e11 * wave**-4.0
    upper = m * pigment + (1 - m) * base
    lower = h * haemoglobin(c.oxygenated) + (1 - h) * base * c.dermis_base
    albedo = 0.5 * scattering / (0.5 * scattering + lower)
    q = np.sqrt(3 * (1 - albedo))
    a = (1 + _INTERNAL_REFLECTION) / (1 - _INTERNAL_REFLECTION)
    dermis = 0.5 * albedo * (1 + np.exp(-4 / 3 * a * q)) * np.exp(-q)
    back = c.backscatter * scattering
    ratio = 1 + 2 * upper / back
    b = np.sqrt(ratio**2 - 1)
    depth = np.minimum(b * back * c.epidermis_mm, 300.0)
    tanh = np.tanh(depth)
    reflected = tanh / (ratio * tanh + b)
    through = b / (ratio * tanh + b) / np.cosh(depth)
    return np.asarray(reflected + through**2 * dermis / (1 - reflected * dermis))


def led_white() -> np.ndarray:
    """(34,) a white LED of good colour rendering: a blue chip, a green and a red phosphor."""
    return _lobe(452, 10, 14) + 0.4 * _lobe(525, 25, 45) + _lobe(605, 60, 45)


def _lobe(middle: float, below: float, above: float) -> np.ndarray:
    """Gaussian with another width on each side."""
    away = WAVELENGTHS_NM - middle
    return np.exp(-0.5 * (away / np.where(away < 0, below, above)) ** 2)


def matching_functions() -> np.ndarray:
    """(3, 34) CIE 1931 2-degree colour matching functions, the multi-lobe fit of [Wyman2013]."""
    x = 1.056 * _lobe(599.8, 37.9, 31.0) + 0.362 * _lobe(442.0, 16.0, 26.7)
    x -= 0.065 * _lobe(501.1, 20.4, 26.2)
    y = 0.821 * _lobe(568.8, 46.9, 40.5) + 0.286 * _lobe(530.9, 16.3, 31.1)
    z = 1.217 * _lobe(437.0, 11.8, 36.0) + 0.681 * _lobe(459.0, 26.0, 13.8)
    return np.stack([x, y, z])


@functools.cache
def rgb_weights() -> np.ndarray:
    """(3, 34) linear RGB of a reflectance under the LEDs; a perfect white gives 1, 1, 1.

    The LEDs' white is adapted to D65 by Bradford's method, as a camera's colour chart does it.
    """
    weights = matching_functions() * led_white()
    weights = weights / weights[1].sum()
    scale = (_BRADFORD @ D65_XYZ) / (_BRADFORD @ weights.sum(axis=1))
    adapted = np.linalg.inv(_BRADFORD) @ np.diag(scale) @ _BRADFORD @ weights
    rgb = _RGB_FROM_XYZ @ adapted
    return np.asarray(rgb / rgb.sum(axis=1, keepdims=True))


def skin_rgb(
    melanin: np.ndarray | float,
    blood: np.ndarray | float,
    eumelanin: float,
    config: PigmentConfig | None = None,
) -> np.ndarray:
    """(..., 3) linear RGB of skin, exact; arguments as `reflectance`."""
    return np.asarray(reflectance(melanin, blood, eumelanin, config) @ rgb_weights().T)


@functools.lru_cache(maxsize=8)
def _table(eumelanin: float, config: PigmentConfig) -> np.ndarray:
    """(melanin, blood, 3) float32 colours at places even in the logarithm of both."""
    melanin = np.geomspace(*MELANIN_RANGE, _TABLE_MELANIN)
    blood = np.geomspace(*BLOOD_RANGE, _TABLE_BLOOD)
    return skin_rgb(melanin[:, None], blood[None], eumelanin, config).astype(np.float32)


def paint_pigments(
    melanin: np.ndarray,
    blood: np.ndarray,
    eumelanin: float,
    config: PigmentConfig | None = None,
) -> np.ndarray:
    """Colour of many texels, looked up in a table of `skin_rgb` (to .2 % of the albedo).

    Args:
        melanin: (rows, columns) float32 C_m, clamped to `MELANIN_RANGE`; NaN gives its lower end.
        blood: (rows, columns) float32 C_h, clamped to `BLOOD_RANGE`.
        eumelanin: B_m of the person, 0..1.
        config: the model's constants.

    Returns:
        (rows, columns, 3) float32 linear.
    """
    y = _steps(melanin, MELANIN_RANGE, _TABLE_MELANIN)
    x = _steps(blood, BLOOD_RANGE, _TABLE_BLOOD)
    table = _table(round(float(eumelanin), 3), config or PigmentConfig())
    return cv2.remap(table, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _steps(values: np.ndarray, span: tuple[float, float], count: int) -> np.ndarray:
    """Places in the table, 0..count - 1."""
    low, high = span
    clean = np.fmin(np.fmax(np.asarray(values, np.float32), np.float32(low)), np.float32(high))
    logs = np.log(clean)
    return np.asarray(
        (logs - np.float32(np.log(low))) * np.float32((count - 1) / np.log(high / low))
    )


def lab(rgb: np.ndarray) -> np.ndarray:
    """(..., 3) CIE L* a* b* under D65 of linear RGB (..., 3)."""
    xyz = np.asarray(rgb, float) @ np.linalg.inv(_RGB_FROM_XYZ).T / D65_XYZ
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.stack(
        [116 * f[..., 1] - 16, 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])], -1
    )


def tone_angle_deg(rgb: np.ndarray) -> np.ndarray:
    """Individual typology angle atan((L* - 50) / b*) of linear RGB (..., 3) [Chardon1991].

    Above 55 degrees skin is called very light, below -30 dark.
    """
    colour = lab(rgb)
    return np.degrees(np.arctan2(colour[..., 0] - 50, colour[..., 2]))
