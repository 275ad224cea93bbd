"""A head as one HTML file that opens from the disk: three.js, mesh and pictures are inside."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from learning.errors import MapsError
from learning.export.encode import perceptual
from learning.export.gltf import METRES, corners_of, turned_normals, unit_normals
from learning.export.parts.furnish import Furnished
from learning.export.parts.part import Part
from learning.export.pictures import CONSTANT_ROUGHNESS, Pictures
from learning.export.source import Source
from learning.render.dielectric import INDEX
from lightstage.formats.files import write_text

DATA = Path(__file__).parents[1] / "data"
MOST_ROWS = 2048
"""Rows of the pictures in a page; larger ones are halved by areas until they fit."""
MOST_BYTES = 25_000_000
QUALITY = {"base": 92, "normal": 95, "packed": 92}
"""JPEG's, by picture; the specular picture keeps its alpha and is a PNG."""
WHOLE_COLOURS = (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444)
"""A normal's x and y are colours, which JPEG else keeps at half the rows and columns: a sixth of
the relief of pores was lost."""
SAID = (
    "Subsurface scattering is approximated here: diffuse light wraps around the horizon, red "
    "farthest. The roughness was measured with Beckmann's facets and is shown with GGX. Pictures "
    "have at most 2048 rows and eight bits."
)


def write_page(
    path: Path,
    sides: dict[str, tuple[Source, Pictures]],
    head: Furnished,
    opens_with: str | None = None,
) -> Path:
    """Write a head's page, atomically.

    Args:
        path: the file.
        sides: one or two by name, of one mesh; of two a slider shows the first left of it.
        head: the mesh, morph targets, and what is drawn beside the skin.
        opens_with: the morph target that has weight 1 at first; None for none.

    Returns:
        `path`.

    Raises:
        MapsError: the page would be larger than `MOST_BYTES`.
    """
    data = {
        "ior": INDEX,
        "said": SAID,
        "mesh": _mesh(head),
        "parts": [_part(part) for part in head.parts],
        "morphs": {name: float(name == opens_with) for name in head.morphs},
        "sides": [_side(name, *side) for name, side in sides.items()],
    }
    # No text of the data may end the script that holds it.
    text = json.dumps(data, allow_nan=False).replace("</", "<\\/")
    page = (DATA / "page.html").read_text()
    three = DATA / "three"
    licence = (three / "LICENSE").read_text()
    parts = {
        "@LICENCE@": f"<!-- three.js 0.187.0, https://github.com/mrdoob/three.js\n{licence}-->",
        "@CORE@": _harmless((three / "three.core.js").read_text()),
        "@THREE@": _harmless((three / "three.module.js").read_text()),
        "@DATA@": text,
    }
    whole = page
    for mark, part in parts.items():
        whole = whole.replace(mark, part)
    if len(whole) > MOST_BYTES:
        raise MapsError(
            path,
            found=f"a page of {len(whole) / 1e6:.0f} MB",
            expected=f"at most {MOST_BYTES / 1e6:.0f} MB",
            hint="Leave `page` out of --format, or give smaller maps.",
        )
    return write_text(path, whole)


def _harmless(script: str) -> str:
    """A script's text with nothing in it that would end the element that holds it."""
    return script.replace("</script", "<\\/script")


def _mesh(head: Furnished) -> dict[str, Any]:
    source, corners = head.source, corners_of(head.source)
    assert source.mesh.uvs is not None  # read_source refuses a mesh without
    return {
        "position": _floats(METRES * source.mesh.vertices[corners.vertex]),
        "normal": _floats(unit_normals(source)[corners.vertex]),
        "tangent": _floats(corners.tangent),
        "uv": _floats(source.mesh.uvs[corners.uv] * [1, -1] + [0, 1]),
        "index": _base64(corners.triangles.astype("<u4").tobytes()),
        "morphs": {
            name: _target(offsets[corners.vertex], turned_normals(source, offsets)[corners.vertex])
            for name, offsets in head.morphs.items()
        },
    }


def _part(part: Part) -> dict[str, Any]:
    return {
        "roughness": part.roughness,
        "position": _floats(METRES * part.places),
        "normal": _floats(part.normals()),
        "color": _floats(part.colours),
        "index": _base64(part.triangles.astype("<u4").tobytes()),
        "morphs": {
            name: _target(offsets, part.turned(offsets)) for name, offsets in part.morphs.items()
        },
    }


def _target(offsets: np.ndarray, turned: np.ndarray) -> dict[str, str]:
    """A morph target: which vertices move (.001 mm and more), their places and normals."""
    moved = np.flatnonzero(np.abs(offsets).max(axis=1) > 1e-3)
    return {
        "at": _base64(moved.astype("<u4").tobytes()),
        "position": _floats(METRES * offsets[moved]),
        "normal": _floats(turned[moved]),
    }


def _floats(values: np.ndarray) -> str:
    return _base64(values.astype("<f4").tobytes())


def _side(name: str, source: Source, pictures: Pictures) -> dict[str, Any]:
    rough = "roughness" in source.maps
    packed = pictures.occlusion_roughness
    return {
        "name": name,
        "base": _jpeg(pictures.base_colour, QUALITY["base"]),
        "normal": _jpeg(pictures.normal, QUALITY["normal"]),
        "packed": None if packed is None else _jpeg(packed, QUALITY["packed"]),
        "specular": _url("png", _small(pictures.specular_gltf), ()),
        "white": pictures.highest_specular,
        "rough": rough,
        "open": "ambient_occlusion" in source.maps,
        "roughness": 1.0 if rough else float(perceptual(np.array(CONSTANT_ROUGHNESS))),
    }


def _small(data: bytes) -> np.ndarray:
    """A PNG's pixels in OpenCV's order, of at most `MOST_ROWS` rows."""
    image = np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED))
    rows, columns = image.shape[:2]
    if rows > MOST_ROWS:
        size = (max(1, columns * MOST_ROWS // rows), MOST_ROWS)
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
    return image


def _jpeg(data: bytes, quality: int) -> str:
    return _url("jpeg", _small(data), (cv2.IMWRITE_JPEG_QUALITY, quality, *WHOLE_COLOURS))


def _url(kind: str, image: np.ndarray, options: tuple[int, ...]) -> str:
    done, data = cv2.imencode(f".{kind}", image, list(options))
    if not done:
        raise MapsError("picture", found=f"shape {image.shape}", expected="one that can be encoded")
    return f"data:image/{kind};base64,{_base64(data.tobytes())}"


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode()
