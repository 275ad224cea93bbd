"""A fitted head in pictures: beside its photograph in the same view and light, and neutral."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from learning.export.source import Source, read_source
from learning.maps import SHININESS, TRANSLUCENCY, TexturedHead, skin_maps_from
from learning.photo.command import LIGHT, MESH, TEXTURE
from learning.relight import render_head, shadows_of
from learning.render.uv import rasterise
from learning.render.view import render_view
from lightstage.formats.environment import LightSet, read_lights
from lightstage.formats.exr import read_exr
from lightstage.rig import Camera, look_at

PICTURE_ROWS = 768
"""Of the texture in pictures, at most: a texel is about a pixel then."""
GREY = 0.25
"""Of the background, linear."""
AROUND = 0.08
"""Margin around a head, of its size."""
SIDES_DEG = (-50.0, 0.0, 50.0)
FAR_MM, FOCAL_PX = 900.0, 2400.0
"""Of the cameras of the neutral head; pictures are cut to the head."""
STUDIO = LightSet(
    "studio",
    np.array([[-500.0, 500.0, 900.0], [700.0, 200.0, 800.0]]),
    np.array([[1.0] * 3, [0.4] * 3]),
    np.full(3, 0.4),
)
"""Under which the neutral head is shown."""


def photo_camera(taken: dict[str, Any]) -> Camera:
    """The camera of a photograph, of an entry of fit.json's `photographs`; world = head frame."""
    width, height, focal = taken["width_px"], taken["height_px"], taken["focal_px"]
    pose = np.array(taken["cam_from_head"])
    middle = (width / 2, height / 2)
    return Camera("photo", "", "", width, height, focal, focal, *middle, (0.0,) * 5, pose)


def around_head(camera: Camera, vertices: np.ndarray, size_px: tuple[int, int]) -> Camera:
    """A camera whose picture is that of another, cut to a head and resized.

    Args:
        camera: without distortion.
        vertices: (n, 3) of the head.
        size_px: width and height of the picture.
    """
    place, _ = camera.project(vertices)
    low, high = np.nanmin(place, axis=0), np.nanmax(place, axis=0)
    size = np.array(size_px, float)
    scale = float((size / ((high - low) * (1 + 2 * AROUND))).min())
    shift = size / 2 - scale * (low + high) / 2
    return dataclasses.replace(
        camera,
        width_px=size_px[0],
        height_px=size_px[1],
        fx_px=scale * camera.fx_px,
        fy_px=scale * camera.fy_px,
        cx_px=scale * camera.cx_px + shift[0],
        cy_px=scale * camera.cy_px + shift[1],
    )


def cut(image: np.ndarray, camera: Camera, part: Camera) -> np.ndarray:
    """Cut out what a camera of `around_head` sees of a photograph of the camera it was made of.

    Args:
        image: (h, w, 3) linear, of `camera`.
        camera: of the photograph.
        part: of `around_head`.

    Returns:
        (part's height, width, 3); grey beside the photograph.
    """
    scale = part.fx_px / camera.fx_px
    # OpenCV counts from the first pixel's centre.
    shift = np.array([part.cx_px, part.cy_px]) - scale * np.array([camera.cx_px, camera.cy_px])
    shift += 0.5 * scale - 0.5
    turn = np.array([[scale, 0, shift[0]], [0, scale, shift[1]]])
    flags = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    soft = cv2.GaussianBlur(image, (0, 0), 0.4 / scale) if scale < 1 else image
    size = (part.width_px, part.height_px)
    return np.asarray(cv2.warpAffine(soft, turn, size, flags=flags, borderValue=(GREY,) * 3))


def photographed(fit: Path, part: Camera) -> np.ndarray:
    """(h, w, 3) linear: the head with its photograph's expression, under the light that was found.

    Where none was found, its texture has the photograph's own light.

    Args:
        fit: the folder.
        part: the view, head frame.
    """
    head = _textured(read_source(fit, fit / MESH))
    if (fit / LIGHT).is_file():
        light = read_lights(fit / LIGHT)
        return render_head(head, light, part, GREY, seen=shadows_of(head, light))[0]
    texture = read_exr(fit / TEXTURE)
    return render_view(texture, head.raster.covered, head.mesh, part, GREY)[0]


def neutral_sides(source: Source, size_px: tuple[int, int]) -> np.ndarray:
    """(h, 3 w, 3) linear: a head in the head frame from three sides, in the studio's light.

    Args:
        source: of `read_source`.
        size_px: width and height of each side.
    """
    head = _textured(source)
    seen = shadows_of(head, STUDIO)
    middle = head.mesh.vertices.mean(axis=0)
    shown = []
    for turn in np.radians(SIDES_DEG):
        place = middle + FAR_MM * np.array([np.sin(turn), 0.0, np.cos(turn)])
        pose = look_at(place, middle)
        camera = Camera("", "", "", 1, 1, FOCAL_PX, FOCAL_PX, 0.5, 0.5, (0.0,) * 5, pose)
        part = around_head(camera, head.mesh.vertices, size_px)
        shown.append(render_head(head, STUDIO, part, GREY, seen=seen)[0])
    return np.hstack(shown)


def _textured(source: Source) -> TexturedHead:
    """A head as it is rendered, with the gloss that a fit takes for granted."""
    rows, columns = source.size
    if rows > PICTURE_ROWS:
        rows, columns = PICTURE_ROWS, columns * PICTURE_ROWS // rows
    raster = rasterise(source.mesh, rows, columns)
    maps = {
        name: cv2.resize(
            source.spread(image).astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA
        )
        for name, image in source.maps.items()
    }
    maps["position"] = raster.interpolate(source.mesh.vertices)
    ones = np.ones((rows, columns), np.float32)
    skin = skin_maps_from(maps, raster.covered, SHININESS * ones, TRANSLUCENCY * ones)
    return TexturedHead(source.mesh, raster, skin, raster.covered)
