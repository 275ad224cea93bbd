"""What the text of a camera's setting means: makers spell one setting in many ways.

A text that none of these functions understands compares by itself, without case and spaces.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable

MANUAL = ("m", "manual", "manual exposure", "manual mode")
MANUAL_FOCUS = ("m", "mf", "manual", "manual focus", "off")
RAW_NAMES = r"raw|craw|nef|nrw|cr2|cr3|arw|dng|raf|pef|orf|rw2"
SMALL_RAW = (
    r"\b[sm]\s?raw\d?\b|\braw\s?[sm]\b|\b(?:small|medium) raw\b|\braw \((?:small|medium|[sm])\)"
)
"""Reduced RAWs are no mosaic of the sensor."""
JPEG_NAMES = r"jpe?g|fine|normal|basic|large|medium|small|[lms]"
SAME_BALANCE = (
    ("daylight", "sunny", "direct sunlight", "sunlight"),
    ("tungsten", "incandescent"),
    ("fluorescent", "flourescent", "white fluorescent"),
    ("shade", "shadow"),
    ("color temperature", "colour temperature", "choose color temperature", "kelvin", "k"),
    ("preset", "preset manual", "manual", "custom"),
)
SAME_EXPOSURE = 0.01
STANDARD = 0.07
"""A marked time and the true one of its place in the series differ by up to 1/15 (60 for 64)."""
SAME_APERTURE = 0.03
"""f/11 means 11.3 and f/22 means 22.6, the powers of the square root of 2."""


def same_value(name: str, one: str, other: str) -> bool:
    """Whether two texts of one setting mean the same.

    Args:
        name: of Summary.
        one: a text, as a camera or a person writes it.
        other: another.
    """
    if _plain(one) == _plain(other):
        return True
    compare = SAME.get(name)
    return compare is not None and compare(one, other)


def is_manual(text: str) -> bool:
    """Whether an exposure mode is the manual one."""
    return _plain(text) in MANUAL


def is_manual_focus(text: str) -> bool:
    """Whether a focus mode leaves the lens alone; Nikon has ``MF (fixed)``, ``MF (selection)``."""
    return _plain(text) in MANUAL_FOCUS or _plain(text).startswith("mf (")


def is_auto_balance(text: str) -> bool:
    """Whether a white balance is chosen anew for each picture."""
    return bool(re.search(r"\b(auto\d?|automatic|awb|ambience|white priority)\b", _plain(text)))


def format_kinds(text: str) -> frozenset[str]:
    """What files a shot makes: of ``raw``, ``small raw``, ``jpeg``, ``tiff``, ``heif``.

    Args:
        text: such as ``RAW``, ``NEF (Raw)``, ``NEF+Fine``, ``RAW + Large Fine JPEG``, ``mRAW``.
    """
    plain = _plain(text)
    kinds = set()
    if re.search(SMALL_RAW, plain):
        kinds.add("small raw")
        plain = re.sub(SMALL_RAW, " ", plain)
    raw = re.search(rf"\b(?:{RAW_NAMES})\b", plain)
    if raw:
        kinds.add("raw")
        plain = re.sub(rf"\b(?:{RAW_NAMES})\b|\blossless\b|\bcompressed\b", " ", plain)
    for kind, names in (("jpeg", JPEG_NAMES), ("tiff", "tiff?"), ("heif", "hei[fc]")):
        if re.search(rf"\b(?:{names})\d?\b", plain):
            kinds.add(kind)
    return frozenset(kinds)


def exposure_s(text: str) -> tuple[float, float] | None:
    """A shutter's marked time and how far the text may be off it; None: no time (``Bulb``).

    Args:
        text: such as ``1/60``, ``0.0166s`` (cut after four places), ``300/10``, ``2"``.

    Returns:
        Seconds, and the weight of the last of three or more decimal places (else 0).
    """
    plain = re.sub(r'\s*(?:s|sec|seconds?|"|″)$', "", _plain(text))
    match = re.fullmatch(r"(\d{1,6}(?:\.\d{1,15})?)(?:\s?/\s?(\d{1,6}(?:\.\d{1,9})?))?", plain)
    if not match or float(match[1]) <= 0 or float(match[2] or 1) <= 0:
        return None
    places = len(match[1].partition(".")[2])
    last = 10.0**-places if places > 2 and not match[2] else 0.0
    return float(match[1]) / float(match[2] or 1), last


def aperture_number(text: str) -> float | None:
    """The f-number of ``f/8``, ``F8.0``, ``8``; None where there is none."""
    match = re.fullmatch(r"(?:f\s?/?\s?)?(\d{1,3}(?:\.\d{1,4})?)", _plain(text))
    return float(match[1]) if match and float(match[1]) > 0 else None


def iso_number(text: str) -> float | None:
    """The number of ``100`` or ``ISO 100``; None for ``Auto``."""
    match = re.fullmatch(r"(?:iso\s?)?(\d{1,8})(?:\.0+)?", _plain(text))
    return float(match[1]) if match and float(match[1]) > 0 else None


def true_exposures_s(marked_s: float) -> tuple[float, ...]:
    """Times for which a marked one may stand: of the series in thirds and in halves of a stop.

    Shutters count in powers of 2: what is marked 1/60 lasts 1/64 s, 1/15 lasts 1/16 s
    (Tv = -log2 t, [CIPA2019] annex C). None within 7 % of the marked time: no mark of the series.
    """
    return tuple(sorted({t for t in _near_powers(marked_s) if abs(t / marked_s - 1) <= STANDARD}))


def same_exposure(one_s: float, other_s: float, off_s: float = 0.0) -> bool:
    """Whether two times are of one setting: equal, or marks of one place in the series.

    Marks of neighbouring places are 9 % apart or more, but for a few (3 and 3.2, 1.5 and 1.6 s).

    Args:
        one_s: positive.
        other_s: positive.
        off_s: how far the texts may be off.
    """

    def near(a: float, b: float) -> bool:
        return abs(a - b) <= SAME_EXPOSURE * max(a, b) + off_s

    if near(one_s, other_s):
        return True
    mine = [one_s, *true_exposures_s(one_s)]
    theirs = [other_s, *true_exposures_s(other_s)]
    return any(near(a, b) for a in mine for b in theirs)


def same_aperture(one: float, other: float) -> bool:
    """Whether two f-numbers are of one setting."""
    return abs(one - other) <= SAME_APERTURE * max(one, other)


def _near_powers(marked_s: float) -> list[float]:
    found = []
    for steps in (3, 2):
        place = round(steps * math.log2(marked_s))
        found += [2.0 ** ((place + by) / steps) for by in (-1, 0, 1)]
    return found


def _plain(text: str) -> str:
    return " ".join(text.replace("_", " ").casefold().split())


def _same_shutter(one: str, other: str) -> bool:
    a, b = exposure_s(one), exposure_s(other)
    if a is None or b is None:
        return False
    off_s = 0.0 if a[1] == b[1] else max(a[1], b[1])  # alike cut texts differ by what they show
    return same_exposure(a[0], b[0], off_s)


def _same_aperture(one: str, other: str) -> bool:
    a, b = aperture_number(one), aperture_number(other)
    return a is not None and b is not None and same_aperture(a, b)


def _same_iso(one: str, other: str) -> bool:
    a, b = iso_number(one), iso_number(other)
    return a is not None and a == b


def _same_balance(one: str, other: str) -> bool:
    a, b = _plain(one), _plain(other)
    return any(a in names and b in names for names in SAME_BALANCE)


def _same_format(one: str, other: str) -> bool:
    kinds = format_kinds(one)
    return bool(kinds) and kinds == format_kinds(other)


SAME: dict[str, Callable[[str, str], bool]] = {
    "mode": lambda one, other: is_manual(one) and is_manual(other),
    "focus": lambda one, other: is_manual_focus(one) and is_manual_focus(other),
    "shutter": _same_shutter,
    "aperture": _same_aperture,
    "iso": _same_iso,
    "white_balance": _same_balance,
    "image_format": _same_format,
}
"""How the texts of a setting are compared."""
