"""RUN/samples.html: what a network makes of people held out, shown beside the truth.

One file without script or network, pictures inside it. It shows faces: it is its owner's alone.
"""

from __future__ import annotations

import base64
import dataclasses
import html
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from torch import Tensor

from learning.maps import from_batch
from lightstage.formats.access import limited_access
from lightstage.formats.files import write_text
from lightstage.formats.png import png_bytes
from processing.colour import srgb_from_linear

SAMPLES = "samples.html"
MOST = 12
"""People that are shown, at most."""
LEAST_PX = 192
"""Height that a picture is shown at, at least, by whole multiples of its texels."""
STYLE = """
:root { color-scheme: light dark; }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 70rem; margin: 0 auto; padding: 1rem; }
td, th { padding: .3rem .6rem .3rem 0; text-align: left; vertical-align: top; }
img { image-rendering: pixelated; display: block; }
"""


@dataclasses.dataclass(frozen=True)
class Sample:
    """A person held out: linear, (1, 3, h, w) each.

    Attributes:
        name: pseudonym of the person.
        texture: what the network saw, light in it.
        found: diffuse albedo.
        truth: diffuse albedo.
    """

    name: str
    texture: Tensor
    found: Tensor
    truth: Tensor


def write_samples(folder: Path, title: str, sentence: str, samples: Sequence[Sample]) -> Path:
    """Write the sheet of some samples, `MOST` at most; only its owner may read it.

    Args:
        folder: of the run.
        title: of the page.
        sentence: what is written beneath the title.
        samples: in order.

    Returns:
        Its path.
    """
    rows = "\n".join(_row(sample) for sample in samples[:MOST])
    columns = ("person held out", "texture", "diffuse albedo found", "true diffuse albedo")
    head = "".join(f'<th scope="col">{name}</th>' for name in columns)
    page = (
        "<!doctype html>\n"
        f'<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{html.escape(title)}</title>\n'
        f"<style>{STYLE}</style>\n</head>\n<body>\n<h1>{html.escape(title)}</h1>\n"
        f"<p>{html.escape(sentence)}</p>\n<table>\n<thead><tr>{head}</tr></thead>\n"
        f"<tbody>\n{rows}\n</tbody>\n</table>\n</body>\n</html>\n"
    )
    with limited_access("nothing"):
        return write_text(folder / SAMPLES, page)


def _row(sample: Sample) -> str:
    cells = [
        f"<td>{_picture(image, f'{what} of {sample.name}')}</td>"
        for image, what in (
            (sample.texture, "texture"),
            (sample.found, "albedo found"),
            (sample.truth, "true albedo"),
        )
    ]
    return f"<tr><td>{html.escape(sample.name)}</td>{''.join(cells)}</tr>"


def _picture(rgb_linear: Tensor, what: str) -> str:
    image = np.round(255 * srgb_from_linear(np.nan_to_num(from_batch(rgb_linear))))
    data = base64.b64encode(png_bytes(image.astype(np.uint8), what)).decode()
    height, width = image.shape[:2]
    times = -(-LEAST_PX // height)
    return (
        f'<img src="data:image/png;base64,{data}" alt="{html.escape(what, quote=True)}" '
        f'width="{times * width}" height="{times * height}">'
    )
