"""The page of an avatar: photograph and head, what is guessed, links to its parts, its relief."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from learning.detail.emboss import embossed
from learning.export.source import Source, maps_folder, read_source
from learning.photo.in_place import around_head, cut, neutral_sides, photo_camera, photographed
from learning.photo.picture import read_photograph
from lightstage.exif import film_focal_px
from lightstage.formats.exr import read_exr
from lightstage.formats.files import read_json
from lightstage.formats.mesh import read_mesh
from lightstage.formats.processed import ProcessedFolder
from processing.report import Link, Marked, Picture, Section, Table, display, write_report
from processing.sides import lit_sides

BESIDE_PX = (480, 600)
"""Width and height of the photograph, and of the head beside it."""
TURNED_PX = (320, 400)
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


def write_avatar_page(
    path: Path, parts: Sequence[str], maps: Path | None = None, photo: Path | None = None
) -> Path:
    """Write the page, atomically; returns `path`.

    Args:
        path: in the avatar's folder.
        parts: folders that are up to date; others are not shown.
        maps: of a captured head, where there is no fit.
        photo: the first photograph of a fitted head.
    """
    out = path.parent
    there: list[list[str | float | int | Link | Marked]] = [
        [Link(file, what), file, f"{(out / file).stat().st_size / 1e6:.1f}"]
        for file, what in FILES.items()
        if file.split("/")[0] in parts and (out / file).is_file()
    ]
    sections = []
    if maps is None:
        fit = read_json(out / "fit" / "fit.json")
        of = ", ".join(photograph["name"] for photograph in fit["photographs"])
        notes, mesh = fit["notes"], ProcessedFolder(out / "fit").neutral_mesh
        assert photo is not None  # a fit has photographs
        sections += _fitted(out / "fit", fit, photo)
    else:
        of, notes = f"the captured head {maps.name}", []
        mesh = ProcessedFolder(maps_folder(maps).parent).registered_mesh
    table = Table(["part", "file", "MB"], there, f"Of {of}.")
    sections.append(Section("Parts", [table, *notes]))
    if "detail" in parts:
        sections.append(_relief(out, mesh))
    return write_report(path, "A head that leaves the program", sections)


def _fitted(folder: Path, fit: dict[str, Any], photo: Path) -> list[Section]:
    """The photograph beside the head in its place, the neutral head, and what is guessed."""
    taken = fit["photographs"][0]
    camera = photo_camera(taken)
    mesh = read_mesh(ProcessedFolder(folder).registered_mesh)
    part = around_head(camera, mesh.vertices, BESIDE_PX)
    shown = [cut(read_photograph(photo).rgb_linear, camera, part), photographed(folder, part)]
    light = "under the light that was found in it"
    if fit["lamps"] is None:
        light = "with the photograph's own light, as none was found that explains it"
    source = read_source(folder)
    return [
        Section(
            "The photograph and the head",
            [
                Picture(
                    display(np.hstack(shown)),
                    f"Left: {taken['name']}. Right: the head from the same place, {light}. Eyes, "
                    "mouth and outline should be where the photograph has them, light and colours "
                    "alike.",
                )
            ],
        ),
        Section(
            "The neutral head",
            [
                Picture(
                    display(neutral_sides(source, TURNED_PX)),
                    "Without the photograph's expression, which is its morph target, in the light "
                    "of a studio.",
                )
            ],
        ),
        Section("What is guessed", [Table(["what", "how it was found"], guesses(fit, source))]),
    ]


def guesses(fit: dict[str, Any], source: Source) -> list[list[str]]:
    """List what a head has that its photographs do not show for certain, a line each.

    Args:
        fit: contents of fit.json.
        source: maps and mesh of the fit.
    """
    covered = source.covered
    confidence = source.maps.get("confidence")
    filled = 0.0 if confidence is None else float((confidence[covered] <= 0).mean())
    tone = fit.get("tone")
    found = [
        [
            "tone of the skin",
            "one photograph does not separate it from the light's strength and colour"
            if tone is None
            else "typology angle {:.0f} degrees, between {:.0f} and {:.0f}, ".format(
                tone["ita_deg"], *tone["span_deg"]
            )
            + "by {}: a photograph does not separate it from the light".format(
                ", ".join(tone["cues"])
            ),
        ],
        [
            "what was not seen",
            f"{100 * filled:.0f} % of the texels: the skin that was seen, continued and mirrored",
        ],
        ["hair", "colour on the skull, without volume; where it was not seen, continued"],
        ["eyes", "painted on the lids' surface; no eyeballs"],
        [
            "teeth, inside of the mouth",
            "none: lips and what a photograph shows between them are one surface",
        ],
        [
            "shape",
            f"standard deviation {fit['shape_deviation_mm']:.1f} mm over the face; depth from in "
            "front the most",
        ],
    ]
    if fit["lamps"] is None:
        found.append(["light", "none was found that explains the photograph: skin and light mix"])
    for taken in fit["photographs"]:
        if not taken["focal_told"]:
            unit = film_focal_px(1.0, taken["width_px"], taken["height_px"])
            found.append(
                [
                    f"lens of {taken['name']}",
                    f"fitted, {taken['focal_px'] / unit:.0f} mm as a 35 mm equivalent, as the file "
                    "does not state it",
                ]
            )
        if taken["black_and_white"]:
            found.append(
                [f"colour of {taken['name']}", "the mean person's: the photograph has none"]
            )
    return found


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
