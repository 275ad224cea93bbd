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
    path: Path, sides: dict[str, tuple[Source, Pictures]], photo_share: float = 0.0
) -> Path:
    """Write a head's page, atomically.

    Args:
        path: the file.
        sides: one or two by name, of one mesh; of two a slider shows the first left of it.
        photo_share: of its photograph's expression, with which a fitted head's page opens.

    Returns:
        `path`.

    Raises:
        MapsError: the page would be larger than `MOST_BYTES`.
    """
    source = next(iter(sides.values()))[0]
    data = {
        "ior": INDEX,
        "said": SAID,
        "mesh": _mesh(source),
        "photo": photo_share,
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


def _mesh(source: Source) -> dict[str, str]:
    corners = corners_of(source)
    assert source.mesh.uvs is not None  # read_source refuses a mesh without
    fields: dict[str, np.ndarray] = {
        "position": METRES * source.mesh.vertices[corners.vertex],
        "normal": unit_normals(source)[corners.vertex],
        "tangent": corners.tangent,
        "uv": source.mesh.uvs[corners.uv] * [1, -1] + [0, 1],
    }
    if source.photo_mm is not None:
        fields["moved"] = METRES * source.photo_mm[corners.vertex]
        fields["turned"] = turned_normals(source, source.photo_mm)[corners.vertex]
    packed = {name: _base64(values.astype("<f4").tobytes()) for name, values in fields.items()}
    return {**packed, "index": _base64(corners.triangles.astype("<u4").tobytes())}


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
