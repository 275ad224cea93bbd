"""The report's section on light and motion: how well each view's photographs agree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from processing.decode.diagnosis import (
    RESIDUAL_WHITE,
    UNLIKE_WHITE,
    Diagnosis,
    diagnosed_cameras,
    read_diagnosis,
)
from processing.report import Picture, Section, Table, display, display_error, resize

HEIGHT_PX = 150
GAP_PX = 6
TITLE_PX = 22
AMBIENT_WHITE = 0.05
"""Share of full that ambient light shows as white."""


def light_section(out: Path, facts: Mapping[str, Any]) -> Section | None:
    """Pictures and figures of light and motion; None where decode left none.

    Args:
        out: processed folder.
        facts: of the stage decode: ``sums``, camera to the facts of `preparation.prepare_view`, and
            ``clipped_share_of_foreground``, camera to share.
    """
    cameras = diagnosed_cameras(out)
    if not cameras:
        return None
    views = [read_diagnosis(out, camera) for camera in cameras]
    caption = (
        f"Cameras from top to bottom: {', '.join(cameras)}. Under an axis: what the pair of "
        "gradients has more (red) or less (blue) than full, as photographed; even grey is right. "
        "One colour all over one axis is flicker or another exposure, stripes are pulses, edges "
        "in pairs of red and blue are motion, patches everywhere are another pattern; the same "
        f"red on all axes is light that no lamp made. Full colour is {100 * RESIDUAL_WHITE:.0f} % "
        f"of full. Ambient: that light, in its own colour, {100 * AMBIENT_WHITE:.0f} % of full "
        "shows as white. Clipped: where a red square is, some photograph has a clipped pixel, and "
        "that pixel is used in none; spots on nose, forehead and lips are usual, red over whole "
        "cheeks is overexposure. "
        "Pattern: how far the photograph that is least like its own pattern is from it on a ball; "
        "dark is right."
    )
    pictures = grid(dict(zip(cameras, views, strict=True)))
    parts: list[str | Picture | Table] = [Picture(pictures, caption, "light and motion", True)]
    if facts.get("sums"):
        parts.append(_table(facts["sums"], facts.get("clipped_share_of_foreground", {})))
    return Section("Light and motion", parts)


def grid(views: Mapping[str, Diagnosis]) -> np.ndarray:
    """(h, w, 3) uint8: a row a camera, with titles above the columns."""
    axes = sorted({axis for view in views.values() for axis in view.residuals})
    titles = ["full", *axes, "ambient", "clipped", "pattern"]
    rows = [_row(view, axes) for view in views.values()]
    for row, camera in zip(rows, views, strict=True):
        _write(row[0], camera, (255, 255, 255))
    columns: list[np.ndarray] = []
    for place, title in enumerate(titles):
        width = max(row[place].shape[1] for row in rows)
        cells = [_label(title, width)]
        for row in rows:
            cells += [_padded(row[place], width), np.full((GAP_PX, width, 3), 255, np.uint8)]
        columns.append(np.concatenate(cells))
    gap = np.full((len(columns[0]), GAP_PX, 3), 255, np.uint8)
    return np.concatenate([part for c in columns for part in (c, gap)][:-1], axis=1)


def signed(share: np.ndarray, largest: float) -> np.ndarray:
    """(h, w, 3) uint8 of signed shares: red more, blue less, grey 0; full colour at `largest`."""
    value = np.clip(np.nan_to_num(share) / largest, -1, 1)[..., None]
    grey, red, blue = np.full(3, 128.0), np.array([225.0, 30, 20]), np.array([30.0, 70, 230])
    image = grey + np.maximum(value, 0) * (red - grey) + np.maximum(-value, 0) * (blue - grey)
    return np.round(image).astype(np.uint8)


def _row(view: Diagnosis, axes: Sequence[str]) -> list[np.ndarray]:
    peak = float(np.quantile(view.whole, 0.995)) or 1.0
    whole = display(view.whole, 0.8 / max(peak, 1e-12))
    black = np.zeros((*view.whole.shape[:2], 3), np.uint8)
    row = [whole]
    row += [
        signed(view.residuals[axis], RESIDUAL_WHITE) if axis in view.residuals else black
        for axis in axes
    ]
    lit = view.whole.mean(axis=2, keepdims=True) > 0.05 * peak
    row.append(black if view.ambient is None else display(view.ambient * lit, 1 / AMBIENT_WHITE))
    share = view.clipped[..., None]
    clipped = whole // 3 * (1 - share) + share * np.array([255, 40, 30])
    row.append(np.round(clipped).astype(np.uint8))
    row.append(_worst(view, black))
    return [resize(image, HEIGHT_PX) for image in row]


def _worst(view: Diagnosis, black: np.ndarray) -> np.ndarray:
    if not view.unlike:
        return black
    worst = max(view.unlike.values(), key=lambda picture: float(picture.mean()))
    coloured = display_error(worst, UNLIKE_WHITE)
    size = black.shape[1], black.shape[0]
    return np.asarray(cv2.resize(coloured, size, interpolation=cv2.INTER_NEAREST))


def _label(text: str, width: int) -> np.ndarray:
    image = np.full((TITLE_PX, width, 3), 255, np.uint8)
    _write(image, text, (30, 30, 30))
    return image


def _write(image: np.ndarray, text: str, colour: tuple[int, int, int]) -> None:
    cv2.putText(image, text, (2, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.45, colour, 1, cv2.LINE_AA)


def _padded(image: np.ndarray, width: int) -> np.ndarray:
    left = np.full((image.shape[0], width - image.shape[1], 3), 255, np.uint8)
    return np.concatenate([image, left], axis=1)


def _table(sums: Mapping[str, Mapping[str, Any]], clipped: Mapping[str, float]) -> Table:
    rows = []
    for camera, facts in sums.items():
        moved, ambient, apart = facts["displaced_px"], facts["ambient"], facts["pairs_apart"]
        flicker = ", ".join(f"{name} {gain:.3f}" for name, gain in facts["flicker"].items())
        left = ", ".join(f"{axis} {100 * x:.2f}" for axis, x in facts["left"].items())
        wrong = ", ".join(f"{name} as {other}" for name, other in facts["looks_like"].items())
        rows.append(
            (
                camera,
                f"{max(moved.values()):.2f}" if moved else "not known",
                ", ".join(facts["aligned"]) or "none",
                "not known" if ambient is None else ", ".join(f"{100 * x:z.2f}" for x in ambient),
                "not known" if apart is None else f"{100 * apart:.2f}",
                flicker or "none",
                left or "not known",
                wrong or "none",
                ", ".join(facts["rebuilt"]) or "none",
                f"{100 * clipped[camera]:.2f}" if camera in clipped else "not known",
            )
        )
    header = (
        "camera",
        "largest displacement, px",
        "aligned",
        "ambient R, G, B, % of full",
        "axes apart, %",
        "flicker, times as bright",
        "left over, % of full",
        "looks like another",
        "rebuilt",
        "clipped, % of the subject",
    )
    caption = (
        "What the sums of the photographs show of each camera: the pair of gradients of an axis, "
        "added, should give full. Left over: how far it is from that in the mean, when flicker "
        "and ambient light are taken off. It is the photographs' noise as long as all axes have "
        "about the same; bad would be one axis with twice the others', or several per cent: two "
        "photographs that do not belong together, by motion or by their light. Axes apart: the "
        "largest difference of two axes in what their pairs have too much or too little. Clipped: "
        "of the pixels that show the subject, those that are clipped in any of the photographs. "
        "So it is more than what `lightstage check` reports, which is of all pixels of one "
        "photograph, background included; a capture takes a photograph again above 2 % of the lit "
        "pixels of one colour, where nothing else is configured."
    )
    return Table(header, rows, caption)
