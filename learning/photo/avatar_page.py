"""The page of an avatar: links to its parts, and its relief."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from learning.detail.emboss import embossed
from learning.export.source import maps_folder
from lightstage.formats.exr import read_exr
from lightstage.formats.files import read_json
from lightstage.formats.mesh import read_mesh
from lightstage.formats.processed import ProcessedFolder
from processing.report import Link, Marked, Picture, Section, Table, write_report
from processing.sides import lit_sides

SIDE_PX = 320
HEIGHT_PX = 640
SHOWN_TIMES = 1
"""How often triangles are split for the picture: a file of more would take seconds to read."""
WHITE_MM = 0.2
"""Height that shows as white; its negative is black."""
FILES = {
    "fit/fit.html": "The fit: photograph, head over it, shape, texture, light",
    "export/page.html": "The head in the browser: turn it, move the lamp",
    "export/head.glb": "The head as glTF 2.0",
    "export/head.obj": "The head as OBJ",
    "export/head.usda": "The head as USD",
    "export/README.txt": "Units, colour spaces, and what to plug in where",
    "detail/embossed.obj": "The mesh with its relief",
    "detail/displacement.exr": "Heights in mm along the mesh's normals",
    "fit/texture.exr": "The texture with the photograph's light, linear",
    "fit/light.json": "The photograph's light",
}
"""What the parts of an avatar may hold, and what it is."""


def write_avatar_page(path: Path, parts: Sequence[str], maps: Path | None = None) -> Path:
    """Write the page, atomically; returns `path`.

    Args:
        path: in the avatar's folder.
        parts: folders that are up to date; others are not shown.
        maps: of a captured head, where there is no fit.
    """
    out = path.parent
    there: list[list[str | float | int | Link | Marked]] = [
        [Link(file, what), file, f"{(out / file).stat().st_size / 1e6:.1f}"]
        for file, what in FILES.items()
        if file.split("/")[0] in parts and (out / file).is_file()
    ]
    if maps is None:
        fit = read_json(out / "fit" / "fit.json")
        of = ", ".join(photograph["name"] for photograph in fit["photographs"])
        notes, mesh = fit["notes"], ProcessedFolder(out / "fit").neutral_mesh
    else:
        of, notes = f"the captured head {maps.name}", []
        mesh = ProcessedFolder(maps_folder(maps).parent).registered_mesh
    table = Table(["part", "file", "MB"], there, f"Of {of}.")
    sections = [Section("Parts", [table, *notes])]
    if "detail" in parts:
        sections.append(_relief(out, mesh))
    return write_report(path, "A head that leaves the program", sections)


def _relief(out: Path, shape: Path) -> Section:
    """The mesh without and with its heights, and their map."""
    facts = read_json(out / "detail" / "detail.json")
    height = read_exr(out / "detail" / "displacement.exr")
    mesh = read_mesh(shape)
    sides = [lit_sides(each, SIDE_PX) for each in (mesh, embossed(mesh, height, SHOWN_TIMES))]
    scale = min(1.0, HEIGHT_PX / height.shape[0])
    small = cv2.resize(height, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    grey = np.round(255 * np.clip(0.5 + 0.5 * small / WHITE_MM, 0, 1)).astype(np.uint8)
    return Section(
        "Pores and folds",
        [
            Picture(np.vstack(sides), "The mesh, and below it with its relief."),
            Picture(
                grey,
                f"Heights: white is {WHITE_MM:g} mm outward, black as much inward; "
                f"{facts['height_rms_mm']:.3f} mm root mean square. Pores and folds should be "
                "darker than what is around; where a brow, a lip or a shadow has an outline, "
                "colour was taken for relief.",
            ),
        ],
    )
