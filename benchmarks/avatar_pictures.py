"""Ten heads to look at: a photograph, what `fit` makes of it, and the truth where it is known.

python -m benchmarks.avatar_pictures PICTURE.jpg [--photos PHOTO...] [--captured OUT]

From left to right: the photograph, the head in its place under the light that was found, the head
turned and lit from one side, and the true head likewise. Simulated people, ICT's and the scanned
head are those of `benchmarks.avatar`. Photographs of real people have no truth; the captured head
of a processed folder, which is shown first, has no photograph.

The scanned head is Infinite, 3D Head Scan by Lee Perry-Smith, CC BY 3.0, based on a work at
www.triplegangers.com.
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
from pathlib import Path

import cv2
import numpy as np

from benchmarks.avatar import LIGHTS, ROWS
from benchmarks.avatar_photos import Case, head_of, light_for, sitter_of
from benchmarks.networks_lights import light_of
from benchmarks.networks_people import KINDS, chosen
from benchmarks.photo import in_head
from benchmarks.photo_studio import FOCAL_PX, HEIGHT_PX, WIDTH_PX, studio_camera
from learning.maps import load_head
from learning.photo.command import FIT, MAPS, MESH, FitRequest, fit_command
from learning.photo.in_place import GREY, around_head, cut, photo_camera, photographed
from learning.photo.picture import read_photograph
from learning.relight import render_head, shadows_of
from lightstage.commands import quiet
from lightstage.exif import film_focal_px
from lightstage.formats.environment import LightSet
from lightstage.formats.files import read_json
from lightstage.formats.mesh import Mesh, read_obj
from lightstage.formats.png import write_png
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.template import default_template_path, load_template
from lightstage.rig import Camera
from processing.colour import srgb_from_linear

TILE_PX = 168, 224
TURN_DEG = 35.0
SIDE = "hard-oblique"
"""Light of the turned heads, of `benchmarks.networks_lights`."""
ACROSS = 2
"""Heads in a row of the picture."""
FILM_MM = FOCAL_PX / film_focal_px(1.0, WIDTH_PX, HEIGHT_PX)


def main() -> None:
    """Make the picture."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("picture", type=Path, help=".jpg or .png to write")
    parser.add_argument("--photos", type=Path, nargs="*", default=[], help="of real people")
    parser.add_argument("--captured", type=Path, help="a processed folder")
    asked = parser.parse_args()
    if asked.picture.suffix.lower() not in (".jpg", ".png"):
        parser.error(f"{asked.picture}: expected a picture's name, .jpg or .png")
    heads = [] if asked.captured is None else [captured_row(asked.captured)]
    with tempfile.TemporaryDirectory() as place:
        for number, who in enumerate(chosen(list(KINDS), 3, unseen=False)):
            case = Case(who, LIGHTS[number % len(LIGHTS)], 0.0, ROWS)
            heads.append(known_row(case, Path(place) / f"{number}"))
            print(f"{who.kind} {who.name}, {case.light}", flush=True)
        for number, photo in enumerate(asked.photos):
            heads.append(row(fit_tiles(photo, Path(place) / f"real-{number}", side_light())))
            print(photo.name, flush=True)
    heads += [np.full_like(heads[0], 255)] * (-len(heads) % ACROSS)
    rows = [np.concatenate(heads[k : k + ACROSS], axis=1) for k in range(0, len(heads), ACROSS)]
    picture = np.ascontiguousarray(np.concatenate(rows)[..., ::-1])
    cv2.imwrite(str(asked.picture), picture)


def known_row(case: Case, place: Path) -> np.ndarray:
    """A photograph that `benchmarks.avatar` takes, and the true head at its end."""
    codes, _ = sitter_of(case.who, case.yaw_deg, case.rows).shot(light_for(case))
    photo = write_png(place.with_suffix(".png"), codes)
    truth = sitter_of(case.who, TURN_DEG, case.rows).under(side_light())
    head, side = head_of(case.who, case.rows), side_light()
    side = dataclasses.replace(side, position_mm=in_head(head, side.position_mm))
    return row([*fit_tiles(photo, place, side, FILM_MM), tile(truth)])


def fit_tiles(
    photo: Path, out: Path, side: LightSet, film_mm: float | None = None
) -> list[np.ndarray]:
    """The photograph, the head in its place, and the head turned; `side` in the head frame."""
    request = FitRequest((photo,), default_template_path(), out, film_mm=film_mm, rows=2 * ROWS)
    fit_command(request, quiet)
    taken = read_json(out / FIT)["photographs"][0]
    camera = photo_camera(taken)
    mesh = read_obj(out / MESH)
    part = around_head(camera, mesh.vertices, TILE_PX)
    shown = [cut(read_photograph(photo).rgb_linear, camera, part), photographed(out, part)]
    shown = [codes(image) for image in shown]
    return [*shown, tile(picture(out / MAPS, mesh, side, studio_camera(np.eye(3, 4), TURN_DEG)))]


def captured_row(out: Path) -> np.ndarray:
    """The captured head of a processed folder, from in front and turned."""
    folder = ProcessedFolder(out)
    pose = np.array(read_json(folder.head_pose)["head_from_world"])
    side = dataclasses.replace(
        side_light(), position_mm=(side_light().position_mm - pose[:, 3]) @ pose[:, :3]
    )
    mesh = read_obj(folder.registered_mesh)
    cameras = [studio_camera(pose, yaw_deg) for yaw_deg in (0.0, TURN_DEG)]
    return row(
        [
            tile(picture(folder.atlas_path("diffuse_albedo").parent, mesh, side, camera))
            for camera in cameras
        ]
    )


def picture(maps: Path, mesh: Mesh, lights: LightSet, camera: Camera) -> np.ndarray:
    """(h, w, 3) of maps on their mesh, with cast shadows; eyes are as smooth as the template's."""
    head = load_head(maps, mesh, load_template(default_template_path()))
    return render_head(head, lights, camera, GREY, seen=shadows_of(head, lights))[0]


def side_light() -> LightSet:
    """Under which heads are turned."""
    return light_of(SIDE, 0)


def codes(image: np.ndarray) -> np.ndarray:
    """Linear light as sRGB's bytes."""
    return np.round(255 * srgb_from_linear(np.clip(image, 0, 1))).astype(np.uint8)


def tile(image: np.ndarray) -> np.ndarray:
    """A picture of the studio's size as a tile."""
    small = cv2.resize(image.astype(np.float32), TILE_PX, interpolation=cv2.INTER_AREA)
    return codes(small)


def row(tiles: list[np.ndarray]) -> np.ndarray:
    """Four tiles beside each other; white where there is none."""
    blank = np.full((TILE_PX[1], TILE_PX[0], 3), 255, np.uint8)
    return np.concatenate([*tiles, *[blank] * (4 - len(tiles))], axis=1)


if __name__ == "__main__":
    main()
