"""Sheets of maps beside truth, to look at: what `refine` finds of a person's frontal view.

Run `python -m benchmarks.reflectance_pictures` for docs/reflectance_maps.jpg: a light, a dark and
the scanned person with the true mesh. `--people`, `--light` and `--out` choose others. Each person
has a row of what was found, one of truth, one of errors: diffuse albedo, specular albedo, diffuse
normal, specular normal's relief below 2 mm, and confidence beside one light that no pattern used.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import cv2
import numpy as np

from benchmarks.reflectance_case import Case
from benchmarks.reflectance_people import SCALE, new_lights, person
from benchmarks.reflectance_scores import FINE_SIGMA_MM, Maps, relief
from lightstage.formats.files import atomic_path
from processing.colour import srgb_from_linear
from processing.evaluation.maps import angle_deg
from processing.readings import px_per_mm

CAMERA = "cam0"
PICTURE = Path(__file__).parents[1] / "docs" / "reflectance_maps.jpg"
PEOPLE = "tone3,tone6,lps"
SPECULAR_PEAK = 0.05
RELIEF_PEAK = 0.15
ALBEDO_ERROR, SPECULAR_ERROR, ANGLE_ERROR_DEG, LIGHT_ERROR = 0.04, 0.015, 5.0, 0.05
"""Errors that are drawn white."""
LIGHT = 7
COLUMNS = 210
TITLES = (
    f"diffuse albedo (error: {ALBEDO_ERROR:g} white)",
    f"specular 0..{SPECULAR_PEAK:g} ({SPECULAR_ERROR:g})",
    f"diffuse normal ({ANGLE_ERROR_DEG:g} deg)",
    f"specular relief < 2 mm ({RELIEF_PEAK:g})",
    "confidence; truth: skin",
    f"a new light ({LIGHT_ERROR:g})",
)


def sheet(case: Case, maps: Maps) -> np.ndarray:
    """Three rows of pictures, BGR: found, true, error."""
    camera = case.session.rig.camera(CAMERA)
    truth = case.truth
    skin, scored = case.true[CAMERA].mask, case.true[CAMERA].skin
    sigma = FINE_SIGMA_MM * px_per_mm(camera)
    albedo, mirror, diffuse, specular = (
        truth.read_view(CAMERA, name)
        for name in ("diffuse_albedo", "specular_albedo", "diffuse_normal", "specular_normal")
    )
    rendered = case.relighter.render(maps, camera, skin)[LIGHT]
    shown = new_lights(case.session.root, CAMERA)[LIGHT]
    fine, fine_true = (relief(n, skin, sigma) for n in (maps.specular_normal, specular))
    off = np.zeros(skin.shape)
    off[skin] = angle_deg(maps.diffuse_normal[skin], diffuse[skin])
    peak = float(np.quantile(shown, 0.999))

    def placed(values: np.ndarray) -> np.ndarray:
        picture = np.zeros((*skin.shape, 3), np.float32)
        picture[skin] = values
        return picture

    lit, lit_true = placed(rendered), placed(shown)
    found = [
        srgb_from_linear(maps.diffuse_albedo),
        _grey(maps.specular_albedo / SPECULAR_PEAK),
        maps.diffuse_normal / 2 + 0.5,
        fine / RELIEF_PEAK / 2 + 0.5,
        _grey(maps.confidence),
        srgb_from_linear(np.clip(lit / peak, 0, 1)),
    ]
    true = [
        srgb_from_linear(albedo),
        _grey(mirror / SPECULAR_PEAK),
        diffuse / 2 + 0.5,
        fine_true / RELIEF_PEAK / 2 + 0.5,
        _grey(scored),
        srgb_from_linear(np.clip(lit_true / peak, 0, 1)),
    ]
    error = [
        np.abs(maps.diffuse_albedo - albedo) / ALBEDO_ERROR,
        _grey(np.abs(maps.specular_albedo - mirror) / SPECULAR_ERROR),
        _grey(off / ANGLE_ERROR_DEG),
        np.abs(fine - fine_true) / RELIEF_PEAK,
        _grey(np.zeros(skin.shape)),
        np.abs(lit - lit_true) / LIGHT_ERROR,
    ]
    rows, columns = (np.flatnonzero(skin.any(axis=axis)) for axis in (1, 0))
    part = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    return np.concatenate([_row(pictures, skin, part) for pictures in (found, true, error)], axis=0)


def _grey(values: np.ndarray) -> np.ndarray:
    return np.repeat(np.asarray(values, np.float32)[..., None], 3, axis=2)


def _row(pictures: list[np.ndarray], skin: np.ndarray, part: tuple[slice, slice]) -> np.ndarray:
    small = []
    for picture in pictures:
        masked = np.where(skin[..., None], picture, 0)[part]
        height = round(masked.shape[0] * COLUMNS / masked.shape[1])
        small.append(
            cv2.resize(
                np.clip(masked, 0, 1).astype(np.float32),
                (COLUMNS, height),
                interpolation=cv2.INTER_AREA,
            )
        )
    return (np.concatenate(small, axis=1)[..., ::-1] * 255).round().astype(np.uint8)


def titled(picture: np.ndarray) -> np.ndarray:
    """A sheet under the columns' titles."""
    strip = np.zeros((22, picture.shape[1], 3), np.uint8)
    for k, title in enumerate(TITLES):
        place = (k * COLUMNS + 4, 15)
        cv2.putText(strip, title, place, cv2.FONT_HERSHEY_SIMPLEX, 0.4, (255, 255, 255), 1,
                    cv2.LINE_AA)  # fmt: skip
    return np.concatenate([strip, picture], axis=0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--people", default=PEOPLE)
    parser.add_argument("--light", default="direct", choices=("direct", "reference"))
    parser.add_argument("--scale", type=float, default=SCALE, help="of the pictures' pixels")
    parser.add_argument("--out", type=Path, default=PICTURE)
    arguments = parser.parse_args()
    sheets = []
    for name in arguments.people.split(","):
        with tempfile.TemporaryDirectory() as folder:
            case = Case(person(name), arguments.light, Path(folder), scale=arguments.scale)
            sheets.append(sheet(case, case.refined()[CAMERA]))
    ok, data = cv2.imencode(
        arguments.out.suffix, titled(np.concatenate(sheets, axis=0)), [cv2.IMWRITE_JPEG_QUALITY, 85]
    )
    if not ok:
        raise OSError(f"{arguments.out}: cannot be encoded")
    with atomic_path(arguments.out) as beside:
        beside.write_bytes(data.tobytes())
    print(arguments.out)


if __name__ == "__main__":
    main()
