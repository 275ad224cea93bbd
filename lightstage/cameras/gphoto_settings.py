"""What makers call a setting, and what is made of their answers; pure, libgphoto2 is not needed.

Names are those of libgphoto2 2.5's PTP driver (Nikon's first where both have one of their own).
"""

from __future__ import annotations

import math

NAMES = {
    "serial": ("eosserialnumber", "serialnumber"),
    "firmware": ("firmwareversion", "deviceversion"),
    "mode": ("expprogram", "autoexposuremodedial", "autoexposuremode", "expprogram2"),
    "iso": ("iso",),
    "shutter": ("shutterspeed2", "shutterspeed"),
    "aperture": ("f-number", "aperture"),
    "white_balance": ("whitebalance",),
    "image_format": ("imagequality", "imageformat", "imageformatsd", "imageformatcf"),
    "focus": ("focusmode", "focusmode2"),
    "battery_percent": ("batterylevel",),
    "clock_offset_s": ("datetimeutc", "datetime"),
    "owner": ("ownername",),
    "artist": ("artist",),
    "copyright": ("copyright",),
    "lens": ("lensname",),
}
"""Field of Summary to names, the better one first. No camera reports if it writes its place."""

TEXTS = tuple(name for name in NAMES if name not in ("serial", "battery_percent", "clock_offset_s"))
"""Fields that are passed on as the camera reports them."""
MAY_BE_EMPTY = ("owner", "artist", "copyright")
"""Fields for which an empty text is an answer."""
AUTO_ISO = ("isoauto", "autoiso")
"""Where it is on, the ISO that is reported is only where the camera begins."""
TARGET, CARD = "capturetarget", "card"
"""Where photographs go, and what the wanted choice has in its name."""


def files_of_a_shot(image_format: str | None) -> int:
    """How many files one shot makes: ``RAW + Large Fine JPEG``, ``NEF+Fine`` make two."""
    return 2 if image_format is not None and "+" in image_format else 1


def percent(text: str) -> float | None:
    """Charge from ``75%`` or ``75``; None from words such as ``Low``."""
    try:
        value = float(text.strip().removesuffix("%"))
    except ValueError:
        return None
    return value if math.isfinite(value) and 0.0 <= value <= 100.0 else None


def is_on(text: str) -> bool:
    """Whether a switch is on, in makers' words."""
    return text.strip().lower() in ("on", "1", "true", "yes")
