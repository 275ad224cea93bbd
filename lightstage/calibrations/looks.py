"""What each photograph of a calibration target must show at once: figures, and what is amiss.

Quick checks: they advise the operator to take a pose again, and measure nothing that a calibration
could be made of.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from lightstage.calibrations.config import CalibrationConfig
from lightstage.calibrations.picture import Picture
from lightstage.counting import counted

BRIGHT_SHARE = 0.25
"""Share of a picture's brightest light above which a ball and highlights are searched."""


@dataclasses.dataclass(frozen=True)
class Amiss:
    """One thing that a photograph does not show as it must: a finding without its place."""

    code: str
    found: str
    expected: str
    hint: str


Seen = tuple[dict[str, Any], list[Amiss]]
"""Figures for calibration.json, and what is amiss."""


def look_at_board(picture: Picture, config: CalibrationConfig) -> Seen:
    """ChArUco corners found by OpenCV's detector, and whether the board's white clips."""
    small = picture.small(config.look.looked_at_px)
    top = float(np.percentile(small, 99.5))
    grey = np.clip(255.0 * small / max(top, 1e-6), 0, 255).astype(np.uint8)
    corners, ids, *_ = config.board.detector().detectBoard(grey)
    count = 0 if ids is None else len(ids)
    figures: dict[str, Any] = {"corners": count}
    amiss = []
    wanted = round(config.look.min_corners_share * config.board.corners)
    if count < wanted:
        amiss.append(
            Amiss(
                "board-corners",
                f"{counted(count, 'corner')} of the board",
                f"at least {wanted} of {config.board.corners}",
                "Turn the board more toward this camera, keep fingers off it, and see that it is "
                "sharp and its markers at least 15 pixels wide; is it the board of the "
                "configuration?",
            )
        )
    if count >= 4:
        scale = picture.clipped.shape[1] / small.shape[1]
        hull = cv2.convexHull(np.asarray(corners, np.float32).reshape(-1, 2) * scale)
        inside = np.zeros(picture.clipped.shape, np.uint8)
        cv2.fillConvexPoly(inside, np.round(hull).astype(np.int32), 1)
        amiss += _clipping(figures, picture, inside.astype(bool), config, "the board's white")
    return figures, amiss


def look_at_mirror(picture: Picture, config: CalibrationConfig) -> Seen:
    """Highlights of a mirror ball: apart from each other, whole in the picture, not all clipped."""
    bright = picture.rgb.max(axis=2)
    top = float(bright.max(initial=0.0))
    lit = (bright > max(BRIGHT_SHARE * top, config.look.max_dark_level)).astype(np.uint8)
    count, labels = cv2.connectedComponents(lit, connectivity=8)
    count -= 1  # the first is what is not lit
    figures: dict[str, Any] = {"highlights": count, "brightest": round(top, 4)}
    if count < config.look.min_highlights:
        few = Amiss(
            "ball-highlights",
            counted(count, "separate highlight"),
            f"at least {config.look.min_highlights}, one for each lamp that the ball mirrors",
            "Is the ball in this camera's picture, clean and sharp?",
        )
        return figures, [few]
    places = np.argwhere(lit)[:, ::-1].astype(np.float32)
    _, radius = cv2.minEnclosingCircle(places)
    figures["diameter_px"] = round(4.0 * radius, 1)  # two pixels of the photograph for one here
    filled = float(lit.sum() / (np.pi * (radius + 0.5) ** 2))
    figures["filled"] = round(filled, 4)
    if filled > config.look.max_mirror_filled:
        return figures, [_no_ball(f"light that fills {100 * filled:.0f} % of its circle")]
    amiss = _ball(figures["diameter_px"], lit, config)
    spots = np.unique(labels[picture.clipped & (lit > 0)])
    figures["clipped_highlights"] = round(len(spots) / count, 4)
    if figures["clipped_highlights"] > config.look.max_highlights_clipped:
        amiss.append(
            Amiss(
                "clipped",
                f"{100 * figures['clipped_highlights']:.0f} % of the highlights at the white level",
                f"at most {100 * config.look.max_highlights_clipped:g} %",
                "Lower the ISO or shorten the exposure for this ball.",
            )
        )
    return figures, amiss


def look_at_grey_ball(picture: Picture, config: CalibrationConfig) -> Seen:
    """A lit disc, whole in the picture, nearly filled, not clipped."""
    bright = picture.rgb[..., 1]
    smooth = cv2.GaussianBlur(bright, (0, 0), 1.0)
    top = float(np.percentile(smooth, 99.9))
    figures: dict[str, Any] = {"brightest": round(top, 4)}
    lit = (smooth > max(BRIGHT_SHARE * top, config.look.max_dark_level)).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(lit, connectivity=8)
    if count < 2:
        return figures, [_no_ball("nothing lit")]
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    disc = (labels == largest).astype(np.uint8)
    _, radius = cv2.minEnclosingCircle(np.argwhere(disc)[:, ::-1].astype(np.float32))
    # A pixel's middle on the rim represents half a pixel more.
    filled = float(disc.sum() / (np.pi * (radius + 0.5) ** 2))
    figures |= {"diameter_px": round(4.0 * radius, 1), "filled": round(filled, 3)}
    amiss = _ball(figures["diameter_px"], disc, config)
    if filled < config.look.min_ball_filled and not any(a.code == "ball-cut" for a in amiss):
        return figures, [_no_ball(f"a lit shape that fills {100 * filled:.0f} % of its circle")]
    return figures, amiss + _clipping(figures, picture, disc > 0, config, "the ball")


def look_at_chart(picture: Picture, config: CalibrationConfig) -> Seen:
    """All 24 patches found by OpenCV's detector, none of them clipped."""
    small = cv2.resize(
        picture.rgb,
        None,
        fx=(factor := min(1.0, config.look.looked_at_px / max(picture.rgb.shape))),
        fy=factor,
        interpolation=cv2.INTER_AREA,
    )
    # Balanced by what is bright, and encoded: the detector needs a picture for the eye.
    shown = small / np.maximum(np.percentile(small, 99.5, axis=(0, 1)), 1e-6)
    image = (255 * np.clip(shown, 0, 1) ** (1 / 2.2)).astype(np.uint8)
    detector = cv2.mcc.CCheckerDetector.create()
    detector.setColorChartType(cv2.mcc.MCC24)
    if not detector.process(np.ascontiguousarray(image[..., ::-1]), 1):
        missing = Amiss(
            "chart-patches",
            "no colour chart",
            "its 24 patches",
            "Turn the chart toward this camera, upright, larger in the picture, without glare.",
        )
        return {"patches": 0}, [missing]
    charts = detector.getBestColorChecker().getColorCharts()
    patches = np.asarray(charts, float).reshape(24, 4, 2) / factor
    # The inner half of each patch: its edges blur into the frame.
    middles = patches.mean(axis=1, keepdims=True)
    inside = np.zeros(picture.clipped.shape, np.uint8)
    for patch in middles + 0.5 * (patches - middles):
        cv2.fillConvexPoly(inside, np.round(patch).astype(np.int32), 1)
    figures: dict[str, Any] = {"patches": 24}
    return figures, _clipping(figures, picture, inside > 0, config, "the chart's patches")


def look_at_dark(picture: Picture, config: CalibrationConfig) -> Seen:
    """No light: mean near black, and few bright pixels."""
    level = float(picture.rgb.mean())
    bright = float((picture.rgb.max(axis=2) > 10 * config.look.max_dark_level).mean())
    figures = {"level": round(level, 6), "bright_share": round(bright, 6)}
    if level <= config.look.max_dark_level and bright <= config.look.max_dark_bright_share:
        return figures, []
    light = Amiss(
        "not-dark",
        f"{100 * level:.2f} % of white in the mean, {100 * bright:.2f} % of pixels bright",
        f"at most {100 * config.look.max_dark_level:g} %, and "
        f"{100 * config.look.max_dark_bright_share:g} % of pixels",
        "Put the lens cap on, or put out the room's light; cover lit displays.",
    )
    return figures, [light]


def look_at_flat(picture: Picture, config: CalibrationConfig) -> Seen:
    """An even light over the whole picture, neither clipped nor faint."""
    level = float(picture.rgb[..., 1].mean())
    whole = np.ones(picture.clipped.shape, bool)
    smooth = cv2.resize(picture.rgb[..., 1], (24, 24), interpolation=cv2.INTER_AREA)
    darkest, brightest = np.percentile(smooth, [5, 95])
    even = float(darkest / brightest) if brightest > 0 else 0.0
    figures: dict[str, Any] = {"level": round(level, 4), "evenness": round(even, 4)}
    amiss = _clipping(figures, picture, whole, config, "the card")
    if level < config.look.min_flat_level:
        amiss.append(
            Amiss(
                "flat-faint",
                f"{100 * level:.1f} % of white in the mean",
                f"at least {100 * config.look.min_flat_level:g} %",
                "Hold the card nearer to the lights, or expose longer.",
            )
        )
    elif even < config.look.min_flat_evenness:
        amiss.append(
            Amiss(
                "flat-uneven",
                f"its darkest twentieth at {100 * even:.0f} % of its brightest",
                f"at least {100 * config.look.min_flat_evenness:g} %",
                "The card must fill the picture, without a shadow of the camera or of a hand.",
            )
        )
    return figures, amiss


LOOKS: dict[str, Callable[[Picture, CalibrationConfig], Seen]] = {
    "charuco": look_at_board,
    "mirror": look_at_mirror,
    "grey": look_at_grey_ball,
    "chart": look_at_chart,
    "dark": look_at_dark,
    "flat": look_at_flat,
}
"""By kind."""


def _no_ball(found: str) -> Amiss:
    return Amiss(
        "no-ball", found, "the ball", "Is it in this camera's picture, alone, and the right one?"
    )


def _ball(diameter_px: float, lit: np.ndarray, config: CalibrationConfig) -> list[Amiss]:
    """Whether a ball is large enough and whole."""
    amiss = []
    if diameter_px < config.look.min_ball_px:
        amiss.append(
            Amiss(
                "ball-small",
                f"a ball of {diameter_px:.0f} pixels across",
                f"at least {config.look.min_ball_px:g}",
                "Use a larger ball, or check whether it is the ball that is lit.",
            )
        )
    if lit[0].any() or lit[-1].any() or lit[:, 0].any() or lit[:, -1].any():
        amiss.append(
            Amiss(
                "ball-cut",
                "light at the picture's edge",
                "the whole ball in the picture, and nothing else lit",
                "Move the ball to the middle; take away what else shines.",
            )
        )
    return amiss


def _clipping(
    figures: dict[str, Any],
    picture: Picture,
    inside: np.ndarray,
    config: CalibrationConfig,
    what: str,
) -> list[Amiss]:
    """Note the share of a target's pixels that clip; amiss where it is too large."""
    share = float(picture.clipped[inside].mean()) if inside.any() else 0.0
    figures["clipped"] = round(share, 6)
    if share <= config.look.max_clipped_share:
        return []
    return [
        Amiss(
            "clipped",
            f"{100 * share:.2f} % of {what} at the white level",
            f"at most {100 * config.look.max_clipped_share:g} %",
            "Lower the ISO or shorten the exposure, for all photographs of this calibration.",
        )
    ]
