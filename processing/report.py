"""Self-contained HTML reports: pictures as data URIs, tables, captions; no script, no network."""

from __future__ import annotations

import base64
import dataclasses
import html
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

import cv2
import numpy as np

from lightstage.formats.files import write_text
from processing.colour import srgb_from_linear
from processing.errors import ProcessingError

CSS = """
:root { color-scheme: light dark; --line: #8884; --quiet: #777; }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 70rem; margin: 0 auto; padding: 1rem; }
h1 { line-height: 1.2; } h2 { margin-top: 2.5rem; border-top: 1px solid var(--line);
 padding-top: 1rem; }
p { max-width: 45rem; }
figure { margin: 1rem 0; } figcaption { color: var(--quiet); font-size: .92rem; max-width: 45rem; }
img { max-width: 100%; height: auto; display: block; border-radius: 4px; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; margin: 1rem 0; }
caption { text-align: left; color: var(--quiet); padding-bottom: .3rem; }
th, td { padding: .3rem .8rem .3rem 0; border-bottom: 1px solid var(--line); text-align: left;
 vertical-align: top; }
footer { margin-top: 3rem; color: var(--quiet); font-size: .92rem; }
"""


@dataclasses.dataclass(frozen=True)
class Picture:
    """A picture and what a newcomer should see in it.

    Attributes:
        image: (h, w) or (h, w, 3) uint8, sRGB.
        caption: what it shows and how it should be.
        alt: a few words in its place.
        lossless: PNG instead of JPEG (drawings, small thumbnails).
    """

    image: np.ndarray
    caption: str
    alt: str = ""
    lossless: bool = False


@dataclasses.dataclass(frozen=True)
class Link:
    """A link to another file, alone in its paragraph or in a table's cell.

    Attributes:
        target: relative to the report.
        text: what is seen there.
    """

    target: str
    text: str


@dataclasses.dataclass(frozen=True)
class Marked:
    """A table's cell that is to be seen first."""

    value: str | float | int


@dataclasses.dataclass(frozen=True)
class Table:
    """A table: column names with units, rows of cells (text, numbers, links)."""

    header: Sequence[str]
    rows: Sequence[Sequence[str | float | int | Link | Marked]]
    caption: str = ""


@dataclasses.dataclass(frozen=True)
class Section:
    """A heading and what is under it: paragraphs (str), links, pictures, tables, in order."""

    title: str
    parts: Sequence[str | Link | Picture | Table]


def write_report(path: Path, title: str, sections: Sequence[Section], footer: str = "") -> Path:
    """Write a report that is one file.

    Args:
        path: the .html file.
        title: of the page.
        sections: in order. All text is escaped.
        footer: last words, such as credits.

    Returns:
        `path`.

    Raises:
        ProcessingError: a picture of another shape or type.
    """
    body = "\n".join(
        f"<section>\n<h2>{_text(section.title)}</h2>\n"
        + "\n".join(_part(part, section.title) for part in section.parts)
        + "\n</section>"
        for section in sections
    )
    ending = f"<footer><p>{_text(footer)}</p></footer>\n" if footer else ""
    return write_text(
        path,
        "<!doctype html>\n"
        f'<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{_text(title)}</title>\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<style>{CSS}</style>\n</head>\n<body>\n<h1>{_text(title)}</h1>\n{body}\n{ending}"
        "</body>\n</html>\n",
    )


def display(rgb_linear: np.ndarray, scale: float = 1.0) -> np.ndarray:
    """Linear light as an 8-bit sRGB picture for looking.

    Args:
        rgb_linear: (h, w), (h, w, 1) or (h, w, 3), any range; NaN shows black.
        scale: factor before encoding.

    Returns:
        (h, w, 3) uint8.
    """
    image = np.nan_to_num(np.asarray(rgb_linear, np.float32) * scale, posinf=1.0, neginf=0.0)
    image = image.reshape(*image.shape[:2], -1)
    if image.shape[2] == 1:
        image = np.repeat(image, 3, axis=2)
    return np.round(srgb_from_linear(image) * 255).astype(np.uint8)


def display_normals(normals: np.ndarray) -> np.ndarray:
    """Normals for looking: x, y, z from -1..1 to red, green, blue; zero vectors black.

    Args:
        normals: (h, w, 3).

    Returns:
        (h, w, 3) uint8.
    """
    there = (normals != 0).any(axis=2, keepdims=True)
    return np.round(np.clip(normals * 0.5 + 0.5, 0, 1) * 255 * there).astype(np.uint8)


def display_error(error: np.ndarray, largest: float, mask: np.ndarray | None = None) -> np.ndarray:
    """An error map in colours: dark blue 0, yellow `largest` and above (viridis).

    Args:
        error: (h, w), not negative.
        largest: the value of the brightest colour.
        mask: (h, w) bool, where to show it; black elsewhere.

    Returns:
        (h, w, 3) uint8.
    """
    value = np.nan_to_num(np.clip(error / largest, 0, 1), nan=1.0)
    colours = cv2.applyColorMap(np.round(value * 255).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
    image = np.ascontiguousarray(colours[:, :, ::-1])
    if mask is not None:
        image[~mask] = 0
    return image


def resize(image: np.ndarray, height: int) -> np.ndarray:
    """A (h, w[, 3]) uint8 picture at another height, aspect kept."""
    width = max(1, round(image.shape[1] * height / image.shape[0]))
    how = cv2.INTER_AREA if height < image.shape[0] else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(image, (width, height), interpolation=how))


def side_by_side(images: Sequence[np.ndarray], height: int, gap: int = 6) -> np.ndarray:
    """Pictures (h, w[, 3]) uint8 in a row at one height with a white gap: (height, w, 3) uint8."""
    row: list[np.ndarray] = []
    for image in images:
        coloured = image if image.ndim == 3 else np.repeat(image[:, :, None], 3, axis=2)
        if row:
            row.append(np.full((height, gap, 3), 255, np.uint8))
        row.append(resize(coloured, height))
    return np.concatenate(row, axis=1)


def encode(image: np.ndarray, *, lossless: bool = False, quality: int = 85) -> bytes:
    """A (h, w[, 3]) uint8 sRGB picture as JPEG, or as PNG where `lossless`."""
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or image.size == 0:
        raise ProcessingError(
            "picture", found=f"{image.dtype} {image.shape}", expected="uint8 (h, w) or (h, w, 3)"
        )
    ordered = image[:, :, ::-1] if image.ndim == 3 else image
    options = [] if lossless else [cv2.IMWRITE_JPEG_QUALITY, quality]
    done, data = cv2.imencode(".png" if lossless else ".jpg", ordered, options)
    if not done:
        raise ProcessingError("picture", found=f"shape {image.shape}", expected="one OpenCV writes")
    return bytes(data.tobytes())


def _part(part: str | Link | Picture | Table, title: str) -> str:
    if isinstance(part, str):
        return f"<p>{_text(part)}</p>"
    if isinstance(part, Link):
        return f"<p>{_link(part)}</p>"
    if isinstance(part, Table):
        return _table(part)
    kind = "png" if part.lossless else "jpeg"
    data = base64.b64encode(encode(part.image, lossless=part.lossless)).decode()
    height, width = part.image.shape[:2]
    return (
        f'<figure><img src="data:image/{kind};base64,{data}" alt="{_text(part.alt or title)}" '
        f'width="{width}" height="{height}">\n'
        f"<figcaption>{_text(part.caption)}</figcaption></figure>"
    )


def _table(table: Table) -> str:
    head = "".join(f'<th scope="col">{_text(name)}</th>' for name in table.header)
    rows = "\n".join(
        "<tr>" + "".join(f"<td>{_cell(cell)}</td>" for cell in row) + "</tr>" for row in table.rows
    )
    caption = f"<caption>{_text(table.caption)}</caption>" if table.caption else ""
    return (
        f'<div class="wide"><table>{caption}\n<thead><tr>{head}</tr></thead>\n'
        f"<tbody>\n{rows}\n</tbody></table></div>"
    )


def _cell(cell: str | float | int | Link | Marked) -> str:
    if isinstance(cell, Link):
        return _link(cell)
    if isinstance(cell, Marked):
        return f"<mark>{_cell(cell.value)}</mark>"
    return _text(f"{cell:.4g}" if isinstance(cell, float) else str(cell))


def _link(link: Link) -> str:
    return f'<a href="{_text(quote(link.target))}">{_text(link.text)}</a>'


def _text(text: str) -> str:
    return html.escape(text, quote=True)
