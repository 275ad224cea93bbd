"""What one photograph shows by itself."""

from __future__ import annotations

from lightstage.checks.config import ChecksConfig
from lightstage.checks.photo_measures import Photo
from lightstage.counting import counted
from lightstage.errors import FormatError
from lightstage.findings import Finding, Severity, two_digits
from lightstage.rig import Camera

COLOURS = ("red", "green", "blue")
DARK_SIGMA = 6.0
"""Deviations of a coarse cell's noise above which light in a dark photograph is light."""
UNLIT_SIGMA = 5.0


def where(pattern: str, camera_id: str) -> str:
    """A photograph's name in findings."""
    return f"{camera_id}, pattern {pattern}"


def unreadable(error: FormatError, pattern: str, camera_id: str) -> Finding:
    """What a file that cannot be measured makes."""
    return Finding(
        "retake",
        "unreadable",
        where(pattern, camera_id),
        error.found or str(error),
        error.expected or "a photograph",
        error.hint or "Retake it; if the fault returns, check this camera's card and cable.",
        pattern,
        camera_id,
    )


def photo_findings(
    photo: Photo, pattern: str, camera: Camera, lit: float, config: ChecksConfig
) -> list[Finding]:
    """Size, numbers, clipping, exposure and dark of one photograph.

    Args:
        photo: its measures.
        pattern: its light.
        camera: of the rig.
        lit: sum of the pattern's levels as a share of the brightest pattern's; 0 is dark.
        config: the limits.
    """
    out: list[Finding] = []

    def add(severity: Severity, code: str, found: str, expected: str, hint: str) -> None:
        place = where(pattern, camera.id)
        out.append(Finding(severity, code, place, found, expected, hint, pattern, camera.id))

    size = camera.width_px, camera.height_px
    if photo.size_px != size:
        add(
            "retake",
            "size",
            f"{photo.size_px[0]} x {photo.size_px[1]} pixels",
            f"{size[0]} x {size[1]} (rig.json)",
            "Set the camera's picture size to full, or is it another camera's photograph?",
        )
    if photo.wild:
        add(
            "retake",
            "not-finite",
            counted(photo.wild, "pixel without a finite number", "pixels without a finite number"),
            "finite light",
            "The file is damaged, or was made by a program that divided by nothing.",
        )
    if photo.encoding == "raw" and photo.flat:
        add(
            "retake",
            "blank",
            "the same count in every pixel",
            "a picture with noise",
            "The sensor gave nothing: switch this camera off and on.",
        )
        return out
    out += _clipping(photo, pattern, camera.id, config)
    if lit == 0.0:
        out += _dark(photo, pattern, camera.id, config)
    elif lit >= 1.0:
        out += _exposure(photo, pattern, camera.id, config)
    elif photo.signal <= UNLIT_SIGMA * float(photo.spread.max(initial=0.0)):
        add(
            "retake",
            "not-lit",
            "nothing but noise",
            "the subject in this pattern's light",
            "Is the lens cap on, or were the lights off when the shutter was open?",
        )
    return out


def _clipping(photo: Photo, pattern: str, camera_id: str, config: ChecksConfig) -> list[Finding]:
    worst = int(photo.clipped.argmax())
    share = float(photo.clipped[worst])
    if share <= config.warn_clipped_share:
        return []
    bad = share > config.max_clipped_share
    shares = ", ".join(
        f"{two_digits(100 * part, 100 * config.warn_clipped_share)} % of {name}"
        for part, name in zip(photo.clipped, COLOURS, strict=True)
        if part > 0
    )
    return [
        Finding(
            "retake" if bad else "warn",
            "clipped",
            where(pattern, camera_id),
            f"{shares} clipped where the subject is lit",
            f"at most {100 * config.warn_clipped_share:g} %",
            "Shorten the exposure or lower ISO for all cameras."
            if bad
            else "Highlights are lost there; shorten the exposure if it is skin.",
            pattern,
            camera_id,
        )
    ]


def _exposure(photo: Photo, pattern: str, camera_id: str, config: ChecksConfig) -> list[Finding]:
    """Level and noise under the brightest pattern."""
    dim = photo.signal < config.warn_signal_share
    noisy = photo.snr < config.min_snr
    if not (dim or noisy):
        return []
    bad = noisy or photo.signal < config.min_signal_share
    return [
        Finding(
            "retake" if bad else "warn",
            "underexposed",
            where(pattern, camera_id),
            "the brightest percent at "
            f"{two_digits(100 * photo.signal, 100 * config.warn_signal_share)} % of white, "
            f"signal to noise {two_digits(photo.snr, config.min_snr)}",
            f"at least {100 * config.warn_signal_share:g} %, and {config.min_snr:g}",
            "Were the lights on, is the cap off? Then open the aperture, or expose longer.",
            pattern,
            camera_id,
        )
    ]


def _dark(photo: Photo, pattern: str, camera_id: str, config: ChecksConfig) -> list[Finding]:
    """A leak that shows without any other photograph: a share of white, not of full."""
    level = float(photo.coarse[..., 1].max())
    noise = DARK_SIGMA * float(photo.spread.max(initial=0.0))
    if level <= noise + config.warn_ambient_share:
        return []
    return [
        Finding(
            "retake" if level > noise + config.max_ambient_share else "warn",
            "dark-leak",
            where(pattern, camera_id),
            f"light at {two_digits(100 * level)} % of white",
            "black and noise",
            "Is a lamp still on, or room light? Darken the room.",
            pattern,
            camera_id,
        )
    ]
