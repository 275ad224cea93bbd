"""`lightstage landmarks`: the points of a face in photographs, as landmarks.json."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import typer

from lightstage.commands import JsonFlag, finish, output_file, progress_bar
from lightstage.counting import counted
from lightstage.errors import ConfigError, FaceError
from lightstage.faces.detect import Face, detect_faces
from lightstage.faces.schemes import FACE_MESH, SCHEMES, seen_points
from lightstage.faces.upright_srgb import read_photo
from lightstage.formats.access import group_of, limited_access
from lightstage.formats.landmarks import write_points_px
from lightstage.formats.png import write_png

SHOWN_ROWS = 768
"""Height of each photograph in the picture."""
DOT = (0, 255, 0)


def register(app: typer.Typer) -> None:
    """Add the command to an application."""
    app.command("landmarks")(landmarks_command)


def landmarks_command(
    photo: list[Path] = typer.Argument(
        help="JPEG, PNG or TIFF; several may be of several cameras.", show_default=False
    ),
    out: Path = output_file(
        "--out", help="Points by photograph's name, .json.", suffixes=[".json"]
    ),
    scheme: str = typer.Option(
        FACE_MESH, help="`mediapipe468`, or `ibug68` for `import` and `register`."
    ),
    face: int = typer.Option(1, min=1, help="Which of a photograph's faces; 1 is the largest."),
    picture: Path | None = output_file(
        "--picture",
        help="The photographs with their points, .png.",
        suffixes=[".png"],
        default=None,
    ),
    as_json: bool = JsonFlag,
) -> None:
    """Find a face's points in photographs and write them as landmarks.json."""
    if scheme not in SCHEMES:
        raise ConfigError("--scheme", found=repr(scheme), expected=" or ".join(SCHEMES))
    names = [path.stem for path in photo]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ConfigError("PHOTO", found=f"{twice[0]} twice", expected="a name for each photograph")
    began = time.monotonic()
    points: dict[str, np.ndarray] = {}
    facts: dict[str, Any] = {}
    shown, warnings = [], []
    with limited_access(group_of(path.parent for path in photo)):
        with progress_bar("landmarks") as progress:
            for done, path in enumerate(photo, 1):
                image = read_photo(path)
                faces = detect_faces(image)
                chosen = faces[face - 1] if face <= len(faces) else None
                facts[path.stem] = _facts(faces, chosen)
                if chosen is None:
                    warnings.append(f"{path}: {_too_few(len(faces), face)}")
                else:
                    points[path.stem] = seen_points(chosen, scheme)
                    if len(faces) > 1:
                        which = "the largest" if face == 1 else f"number {face} by size"
                        warnings.append(f"{path}: {len(faces)} faces, {which} is taken")
                if picture is not None:
                    shown.append(_drawn(image, None if chosen is None else points[path.stem]))
                progress(done, len(photo))
        if not points:
            raise FaceError(
                photo[0] if len(photo) == 1 else f"{len(photo)} photographs",
                found=_too_few(max(len(each["boxes_px"]) for each in facts.values()), face),
                expected="a face of at least a tenth of the picture, upright within 45 degrees",
                hint="Points may be clicked, or found by another program that writes the same "
                "file: docs/landmarks.md.",
            )
        write_points_px(points, out, scheme)
        if picture is not None:
            write_png(picture, np.concatenate(shown, axis=1))
    for warning in warnings:
        print(f"warning: {warning}", file=sys.stderr)
    finish(
        f"{out}: {scheme} of {counted(len(points), 'photograph')} of {len(photo)}",
        {
            "out": str(out),
            "scheme": scheme,
            "photographs": facts,
            "picture": None if picture is None else str(picture),
            "warnings": warnings,
            "seconds": round(time.monotonic() - began, 2),
        },
        as_json,
    )


def _too_few(there: int, wanted: int) -> str:
    return "no face" if there == 0 else f"{counted(there, 'face')}, no number {wanted}"


def _facts(faces: list[Face], chosen: Face | None) -> dict[str, Any]:
    """A photograph's facts."""
    return {
        "boxes_px": [[round(c, 1) for c in face.box_px] for face in faces],
        "presence": None if chosen is None else round(chosen.presence, 4),
    }


def _drawn(image: np.ndarray, points_px: np.ndarray | None) -> np.ndarray:
    """(768, w, 3) uint8: a photograph, small, with its points."""
    import cv2

    factor = SHOWN_ROWS / image.shape[0]
    size = (max(1, round(factor * image.shape[1])), SHOWN_ROWS)
    kind = cv2.INTER_AREA if factor < 1 else cv2.INTER_CUBIC
    shown = np.ascontiguousarray(cv2.resize(image, size, interpolation=kind))
    for x, y in [] if points_px is None else factor * points_px[np.isfinite(points_px).all(axis=1)]:
        cv2.circle(shown, (int(x), int(y)), 1, DOT, -1)
    return shown
