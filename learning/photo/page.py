"""The page of a fit: the photograph, the head over it, its sides, its texture and its light."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from learning.photo.fit import FittedHead
from learning.photo.shape_fit import Photograph
from learning.photo.unwrap import smaller
from learning.render.view import render_view
from lightstage.formats.environment import LightSet
from lightstage.rig import Camera
from processing.colour import srgb_from_linear
from processing.report import Picture, Section, Table, display, display_error, write_report
from processing.sides import coloured_sides, lit_sides

LARGEST_PX = 640
"""Longer side of a picture on the page."""
SIDE_PX = 320
BALL_PX = 200
WORST_MM = 8.0
"""Deviation that has the brightest colour."""
WORST_OFF = 0.2
"""Difference of sRGB values that has the brightest colour."""


def write_page(path: Path, photographs: list[Photograph], fitted: FittedHead) -> Path:
    """Write the page, atomically; returns `path`."""
    shape = fitted.shape
    sections = [_over(photographs[0], fitted)]
    others = [
        Picture(_marked(p, c), f"{p.name}: landmarks (green) and where the fitted head has them.")
        for p, c in zip(photographs[1:], shape.cameras[1:], strict=True)
    ]
    if others:
        others.append(
            Picture(
                _sources(fitted, len(photographs)),
                "Which photograph each texel was mostly taken from, the first in the darkest "
                "colour; black was filled. All were brought to the light of the first.",
            )
        )
        sections.append(Section("The other photographs", others))
    deviation = np.where(shape.model.face, shape.deviation_mm, np.nan)
    sections += [
        Section(
            "Shape",
            [
                Picture(lit_sides(shape.meshes[0], SIDE_PX), "The fitted head from three sides."),
                Picture(
                    coloured_sides(shape.meshes[0], deviation, WORST_MM, SIDE_PX),
                    "How uncertain the shape is: black is certain, the brightest colour is a "
                    f"standard deviation of {WORST_MM:g} mm, grey was not fitted. A photograph "
                    "from in front shows little of a face's depth.",
                ),
            ],
        ),
        Section(
            "Texture",
            [
                Picture(
                    np.hstack(
                        [
                            display(_small(fitted.texture, LARGEST_PX)),
                            display(_small(fitted.confidence, LARGEST_PX)),
                            display(_small(fitted.inferred.maps["diffuse_albedo"], LARGEST_PX)),
                        ]
                    ),
                    "Left: the texture with the first photograph's light, whole. Middle: where it "
                    "was taken from a photograph (white is seen from in front); the rest is filled "
                    "with the skin that was found, under the light that was found. Right: the "
                    "skin's diffuse albedo.",
                )
            ],
        ),
        _light(fitted),
    ]
    return write_report(path, "A head from photographs", sections)


def _over(photograph: Photograph, fitted: FittedHead) -> Section:
    """The first photograph, the head over it, and their difference."""
    camera = smaller(fitted.shape.cameras[0], LARGEST_PX)
    size = (camera.width_px, camera.height_px)
    shown = cv2.resize(photograph.rgb_linear, size, interpolation=cv2.INTER_AREA)
    covered = np.ones(fitted.texture.shape[:2], bool)
    head, alpha = render_view(fitted.texture, covered, fitted.shape.meshes[0], camera, 0.0)
    over = head + shown * (1 - alpha[..., None])
    off = np.abs(srgb_from_linear(over) - srgb_from_linear(shown)).mean(axis=2)
    taken = fitted.shape.landmarks.photographs[0]
    facts = Table(
        ["", ""],
        [
            ["landmarks, root mean square", f"{taken.residual_px:.2f} px"],
            ["focal length", f"{taken.focal_px:.0f} px"],
            ["distance of the camera", f"{np.linalg.norm(taken.offset_mm):.0f} mm"],
            ["texture taken from photographs", f"{100 * fitted.seen.mean():.0f} %"],
            ["of the face, found to be no skin", f"{100 * fitted.masked:.0f} %"],
            ["photograph over its model, logarithm", f"{fitted.misfit:.2f}"],
        ],
    )
    return Section(
        "Photograph and fit",
        [
            Picture(
                np.hstack([_marked(photograph, camera), display(over)]),
                "Left: the photograph with its landmarks. Right: the fitted head drawn over it; "
                "eyes, mouth and outline should be on the photograph's.",
            ),
            Picture(
                display_error(off, WORST_OFF),
                f"Their difference; the brightest colour is {WORST_OFF:g} of the sRGB range.",
            ),
            facts,
            *fitted.notes,
        ],
    )


def _sources(fitted: FittedHead, count: int) -> np.ndarray:
    """Which of so many photographs each texel shows, in colours."""
    share = (fitted.source + 1) / max(count, 1)
    codes = np.round(255 * share).astype(np.uint8)
    coloured = cv2.applyColorMap(codes, cv2.COLORMAP_VIRIDIS)[..., ::-1]
    coloured = np.where((fitted.source >= 0)[..., None], coloured, 0).astype(np.uint8)
    scale = min(1.0, LARGEST_PX / max(coloured.shape[:2]))
    size = (round(coloured.shape[1] * scale), round(coloured.shape[0] * scale))
    return cv2.resize(coloured, size, interpolation=cv2.INTER_NEAREST)


def _light(fitted: FittedHead) -> Section:
    """The light as a white ball, and its lamps."""
    if fitted.light is None:
        return Section("Light", ["No light was found that explains the photograph."])
    rows = []
    for place, rgb in zip(fitted.light.position_mm, fitted.light.rgb, strict=True):
        x, y, z = place / np.linalg.norm(place)
        across, up = np.degrees(np.arctan2(x, z)), np.degrees(np.arcsin(np.clip(y, -1, 1)))
        rows.append([f"{across:.0f}", f"{up:.0f}", *(f"{c:.2f}" for c in rgb)])
    rows.append(["everywhere", "", *(f"{c:.2f}" for c in fitted.light.ambient_rgb)])
    return Section(
        "Light",
        [
            Picture(display(ball(fitted.light, BALL_PX)), "A white ball under the light."),
            Table(
                ["degrees to the face's left", "degrees up", "red", "green", "blue"],
                rows,
                "Lamps as the face sees them; colours as a white surface that faces the lamp.",
            ),
        ],
    )


def ball(light: LightSet, side_px: int) -> np.ndarray:
    """(side_px, side_px, 3) linear: a white matt ball seen from in front, black around.

    Args:
        light: head frame.
        side_px: of the picture.
    """
    at = (np.arange(side_px) + 0.5) / side_px * 2 - 1
    x, y = np.meshgrid(at, -at)
    inside = x**2 + y**2 < 1
    normal = np.stack([x, y, np.sqrt(np.clip(1 - x**2 - y**2, 0, 1))], axis=2)
    length = np.linalg.norm(light.position_mm, axis=1, keepdims=True)
    toward = light.position_mm / np.maximum(length, 1e-9)
    lit = np.clip(normal @ toward.T, 0, None) @ light.rgb + light.ambient_rgb
    return np.asarray(lit * inside[..., None])


def _marked(photograph: Photograph, camera: Camera) -> np.ndarray:
    """The photograph with its landmarks, at the page's size."""
    small = smaller(camera, LARGEST_PX)
    size = (small.width_px, small.height_px)
    shown = display(cv2.resize(photograph.rgb_linear, size, interpolation=cv2.INTER_AREA))
    height, width = photograph.rgb_linear.shape[:2]
    scale = np.array([small.width_px / width, small.height_px / height])
    for point in photograph.landmarks_px:
        if np.isfinite(point).all():
            x, y = np.round(point * scale - 0.5).astype(int).tolist()
            cv2.circle(shown, (x, y), 1, (0, 220, 0), -1)
    return shown


def _small(image: np.ndarray, largest_px: int) -> np.ndarray:
    """Not larger than so many pixels a side."""
    scale = min(1.0, largest_px / max(image.shape[:2]))
    size = (round(image.shape[1] * scale), round(image.shape[0] * scale))
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)
