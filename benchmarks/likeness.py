"""Likeness of heads to the photographs that they were made of, by dlib's recogniser.

python -m benchmarks.likeness [FOLDER] [--fits FOLDER] [--rendered N] [--sheet FILE.png]

FOLDER holds photographs of real people; files whose names agree before the first ``_`` are of one
person. Without it, photographs in the public domain are taken from installed packages.
``--rendered N`` adds photographs of the simulator: N simulated people, N of ICT's model, the
scanned head. ``fit`` makes a head of each, kept in ``--fits`` under the photograph's name; a folder
of `fit` or `avatar` that is there already is scored as it is, whatever made it.

A photograph is compared with its head in the same view and in the light that was found, turned by
30 degrees, and under another light. References: the photograph's own texture on the mesh; another
photograph of the person; strangers' photographs and heads; the mean person's head, in the same view
and light. Tones are those of the heads' skin as `fit` found it.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib.util
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from benchmarks.avatar import LIGHTS
from benchmarks.avatar_photos import Case, light_for, networks, sitter_of, template
from benchmarks.networks_lights import light_of
from benchmarks.networks_people import KINDS, chosen
from benchmarks.photo import scored
from benchmarks.photo_studio import FOCAL_PX, HEIGHT_PX, WIDTH_PX
from benchmarks.record import record
from learning.bootstrap import interval
from learning.errors import RecogniserError
from learning.evaluation.dlib_recogniser import SAME_PERSON, DlibRecogniser, installed
from learning.maps import TexturedHead, load_head, skin_maps_from
from learning.photo.command import (
    FIT,
    LIGHT,
    MAPS,
    MESH,
    NEUTRAL,
    TEXTURE,
    FitRequest,
    fit_command,
)
from learning.photo.in_place import GREY, around_head, cut, photo_camera
from learning.photo.picture import read_photograph
from learning.relight import render_head, shadows_of, turned_camera
from learning.render.uv import rasterise
from learning.render.view import render_view
from lightstage.commands import quiet
from lightstage.errors import LightstageError
from lightstage.formats.environment import read_lights
from lightstage.formats.exr import read_exr
from lightstage.formats.files import read_json
from lightstage.formats.mesh import Mesh, read_obj
from lightstage.formats.png import write_png
from lightstage.formats.template import default_template_path
from lightstage.rig import Camera
from processing.colour import srgb_from_linear
from processing.tones import ita_deg, tone_of

PUBLIC_DOMAIN = {
    "collins": ("skimage", "data/astronaut.png"),
    "hopper": ("matplotlib", "mpl-data/sample_data/grace_hopper.jpg"),
}
"""Photographs in the public domain that packages carry."""
SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff")
ROWS = 768
SIZE = 448, 448
"""Of the pictures that are compared."""
TURN_DEG = 30.0
OTHER = "front"
"""The other light, of `benchmarks.networks_lights`."""
CLAY = 0.5
REPROJECTED, SAME, LEFT, RIGHT, RELIT, MEAN = (
    "its texture on the mesh",
    "same view and light",
    "turned left",
    "turned right",
    "other light",
    "mean person's head",
)
SHADOWS = "shadows"
HEADS = (SAME, LEFT, RIGHT, RELIT)
TILE_PX = 256


@dataclasses.dataclass(frozen=True)
class Compared:
    """A photograph and the pictures of its head.

    Attributes:
        name: of the photograph.
        tone: of `processing.tones`, as `fit` found it.
        pictures: (side, side, 3) sRGB by what they show; the photograph under "".
        faces: (128,) embeddings of those; NaN where no face is found.
        seconds: of a picture without its shadows, and of the shadows of one light.
    """

    name: str
    tone: str
    pictures: dict[str, np.ndarray]
    faces: dict[str, np.ndarray]
    seconds: dict[str, float]

    @property
    def person(self) -> str:
        """Name of who is shown."""
        return self.name.split("_")[0]


def main() -> None:
    """Fit what has no head yet, compare, print, record."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("photographs", type=Path, nargs="?", help="folder")
    parser.add_argument("--fits", type=Path, help="folder of heads by the photographs' names")
    parser.add_argument("--rendered", type=int, default=0, help="people of each model")
    parser.add_argument("--sheet", type=Path, help=".png to write, a row for each photograph")
    asked = parser.parse_args()
    recogniser = installed()
    if recogniser is None:
        parser.error("dlib is not installed: pip install 'lightstage[likeness]'")
    with tempfile.TemporaryDirectory() as place:
        fits = asked.fits or Path(place)
        found = []
        for name, photo, film_mm in photographs(asked.photographs, asked.rendered, Path(place)):
            try:
                out = head_of(photo, fits / name, film_mm)
                found.append(compared(name, photo, out, recogniser))
            except LightstageError as wrong:
                print(f"{name} is left out: {wrong}")
                continue
            print(line(found[-1]), flush=True)
    if not found:
        parser.error("no photograph with a head")
    if asked.sheet is not None:
        write_png(asked.sheet, np.concatenate([row(each) for each in found]))
    write_table(found)


def photographs(
    folder: Path | None, rendered: int, place: Path
) -> Iterator[tuple[str, Path, float | None]]:
    """Names, files and known focal lengths, mm on film."""
    if folder is not None:
        for path in sorted(folder.iterdir()):
            if path.suffix.lower() in SUFFIXES:
                yield path.stem, path, None
    else:
        for name, (package, inside) in PUBLIC_DOMAIN.items():
            spec = importlib.util.find_spec(package)
            if spec is None or not spec.submodule_search_locations:
                print(f"{name} is left out: {package} is not installed")
                continue
            yield name, Path(spec.submodule_search_locations[0]) / inside, None
    film_mm = 36.0 * FOCAL_PX / max(WIDTH_PX, HEIGHT_PX)
    for number, who in enumerate(chosen(list(KINDS), rendered, unseen=False) if rendered else []):
        case = Case(who, LIGHTS[number % len(LIGHTS)], 0.0, ROWS // 2)
        codes, _ = sitter_of(who, case.yaw_deg, case.rows).shot(light_for(case))
        yield case.name, write_png(place / f"{case.name}.png", codes), film_mm


def head_of(photo: Path, out: Path, film_mm: float | None) -> Path:
    """The folder of a photograph's fit, which is made where there is none."""
    for there in (out, out / "fit"):
        if (there / FIT).is_file():
            return there
    out.parent.mkdir(parents=True, exist_ok=True)
    request = FitRequest((photo,), default_template_path(), out, film_mm=film_mm, rows=ROWS)
    fit_command(request, quiet)
    return out


def compared(name: str, photo: Path, fit: Path, recogniser: DlibRecogniser) -> Compared:
    """A photograph, its head's pictures, and what dlib makes of them."""
    mesh = read_obj(fit / MESH)
    head = load_head(fit / MAPS, mesh, template())
    light = read_lights(fit / LIGHT)
    camera = photo_camera(read_json(fit / FIT)["photographs"][0])
    window = around_head(camera, mesh.vertices, SIZE)
    left, right = (
        around_head(turned(camera, mesh, way), mesh.vertices, SIZE) for way in (-TURN_DEG, TURN_DEG)
    )
    mean, other = mean_head(head), light_of(OTHER, 0)
    began = time.perf_counter()
    lit, relit = shadows_of(head, light), shadows_of(head, other)
    seconds = {SHADOWS: (time.perf_counter() - began) / 2}
    unlike, mean_window = shadows_of(mean, light), around_head(camera, mean.mesh.vertices, SIZE)
    made = {
        SAME: lambda: render_head(head, light, window, GREY, seen=lit)[0],
        LEFT: lambda: render_head(head, light, left, GREY, seen=lit)[0],
        RIGHT: lambda: render_head(head, light, right, GREY, seen=lit)[0],
        RELIT: lambda: render_head(head, other, window, GREY, seen=relit)[0],
        REPROJECTED: lambda: render_view(
            read_exr(fit / TEXTURE), head.raster.covered, mesh, window, GREY
        )[0],
        MEAN: lambda: render_head(mean, light, mean_window, GREY, seen=unlike)[0],
        NEUTRAL: lambda: clay(read_obj(fit / NEUTRAL), head, window),
    }
    taken = cut(read_photograph(photo).rgb_linear, camera, window)
    pictures = {"": srgb_from_linear(np.clip(taken, 0, 1))}
    for what, make in made.items():
        began = time.perf_counter()
        pictures[what] = srgb_from_linear(np.clip(make(), 0, 1))
        seconds[what] = time.perf_counter() - began
    faces = {what: recogniser.embedding(p) for what, p in pictures.items() if what != NEUTRAL}
    if not np.isfinite(faces[""]).all():
        raise RecogniserError(photo, found="no face", expected="a face that can be detected")
    face = head.raster.interpolate(scored(template())[:, None].astype(float))[..., 0] > 0.5
    skin = face & head.captured
    albedo = head.skin.diffuse_albedo[0].permute(1, 2, 0).numpy()[skin]
    return Compared(name, tone_of(ita_deg(albedo)), pictures, faces, seconds)


def turned(camera: Camera, mesh: Mesh, way_deg: float) -> Camera:
    """A camera turned about the head."""
    return turned_camera(camera, way_deg, mesh.vertices.mean(axis=0))


def mean_head(like: TexturedHead) -> TexturedHead:
    """The template's mesh with the mean person's skin, at the size of another head's maps."""
    network, mesh = networks()[0], template().mesh
    raster = rasterise(mesh, *like.raster.covered.shape)
    means = {
        "diffuse_albedo": network.mean_log_albedo,
        "specular_albedo": network.mean_log_specular,
    }
    normals = raster.normals(mesh)
    maps = {"diffuse_normal": normals, "specular_normal": normals}
    for name, mean in means.items():
        image = np.exp(mean[0].permute(1, 2, 0).numpy())
        maps[name] = cv2.resize(image, raster.covered.shape[::-1]).reshape(*normals.shape[:2], -1)
    skin = skin_maps_from(
        {**maps, "position": raster.interpolate(mesh.vertices)},
        raster.covered,
        like.skin.shininess[0, 0].numpy(),
        like.skin.translucency[0, 0].numpy(),
    )
    return TexturedHead(mesh, raster, skin, raster.covered)


def clay(mesh: Mesh, like: TexturedHead, camera: Camera) -> np.ndarray:
    """A mesh without colour, lit from where it is seen and from above; linear."""
    raster = rasterise(mesh, *like.raster.covered.shape)
    towards = camera.centre_mm / np.linalg.norm(camera.centre_mm) + np.array([0.3, 0.6, 0.0])
    facing = raster.normals(mesh) @ (towards / np.linalg.norm(towards))
    shaded = np.repeat(CLAY * (0.1 + 0.9 * np.maximum(facing, 0))[..., None], 3, axis=2)
    return render_view(shaded, raster.covered, mesh, camera, 1.0)[0]


def apart(one: np.ndarray, other: np.ndarray) -> float:
    """Distance of embeddings."""
    return float(np.linalg.norm(one - other))


def line(one: Compared) -> str:
    """A photograph's own distances."""
    own = ", ".join(
        f"{what} {apart(one.faces[''], face):.2f}" for what, face in one.faces.items() if what
    )
    return f"{one.name} ({one.tone}): {own}"


def write_table(found: list[Compared]) -> None:
    """Means over people, worst tone first, and ratios of time."""
    rows = [
        ["strangers' photographs", *over(found, strangers(found, "")), "", ""],
        ["another photograph of the person", *over(found, another(found)), "", ""],
    ]
    base = np.mean([one.seconds[REPROJECTED] for one in found])
    for what in (MEAN, REPROJECTED, *HEADS):
        own = [apart(one.faces[""], one.faces[what]) for one in found]
        time_ = np.mean([one.seconds[what] for one in found]) / base
        rows.append([what, *over(found, own), nearest(found, what), f"{time_:.1f}"])
        if what in HEADS:
            label = f"{what}, strangers' heads"
            rows.append([label, *over(found, strangers(found, what)), "", ""])
    for tone, mean, count in by_tone(found):
        rows.append([f"{SAME}: {tone} skin ({count})", f"{mean:.2f}", "", "", ""])
    shadows = np.mean([one.seconds[SHADOWS] for one in found]) / base
    people = len({one.person for one in found})
    record(
        "Likeness of heads to their photographs",
        ["from a photograph to", "distance", "95 %", "own head nearest", "time, of reprojection's"],
        rows,
        f"{len(found)} photographs of {people} people: {', '.join(one.name for one in found)}. "
        f"Euclidean distance of dlib's embeddings, below {SAME_PERSON} for one person; means and "
        "intervals by bootstrap over people; nearest: photographs whose own head is nearer than "
        f"every stranger's head in the same row. Time is without "
        f"shadows, which take {shadows:.1f} for each light.",
    )


def over(found: list[Compared], values: list[float]) -> tuple[str, str]:
    """Mean and interval over people, each with the mean of their photographs."""
    people: dict[str, list[float]] = {}
    for one, value in zip(found, values, strict=True):
        if np.isfinite(value):
            people.setdefault(one.person, []).append(value)
    result = interval([float(np.mean(own)) for own in people.values()])
    return f"{result.mean:.2f}", f"{result.low:.2f} to {result.high:.2f}"


def strangers(found: list[Compared], what: str) -> list[float]:
    """Of each photograph, the mean distance to other people's pictures."""
    return [
        _mean([apart(one.faces[""], b.faces[what]) for b in found if b.person != one.person])
        for one in found
    ]


def another(found: list[Compared]) -> list[float]:
    """Of each photograph, the mean distance to others of its person; NaN without one."""
    return [
        _mean(
            [
                apart(one.faces[""], b.faces[""])
                for b in found
                if b.person == one.person and b is not one
            ]
        )
        for one in found
    ]


def nearest(found: list[Compared], what: str) -> str:
    """Photographs whose own head is the nearest, of those whose head shows a face."""
    if what == MEAN:
        return ""
    right = known = 0
    for one in found:
        own = apart(one.faces[""], one.faces[what])
        rest = [apart(one.faces[""], b.faces[what]) for b in found if b.person != one.person]
        if not rest or not np.isfinite(own):
            continue
        known += 1
        right += int(own < np.nanmin([np.inf, *rest]))
    return f"{right} of {known}"


def by_tone(found: list[Compared]) -> list[tuple[str, float, int]]:
    """Tones with the mean own distance in the same view and how many photographs; worst first."""
    groups: dict[str, list[float]] = {}
    for one in found:
        groups.setdefault(one.tone, []).append(apart(one.faces[""], one.faces[SAME]))
    made = [(tone, _mean(values), len(values)) for tone, values in groups.items()]
    return sorted(made, key=lambda group: -group[1])


def _mean(values: list[float]) -> float:
    known = [value for value in values if np.isfinite(value)]
    return float(np.mean(known)) if known else float("nan")


def row(one: Compared) -> np.ndarray:
    """Tiles beside each other, (TILE_PX, n TILE_PX, 3) uint8, with the distances on them."""
    tiles = []
    for what in ("", *HEADS, NEUTRAL):
        tile = cv2.resize(one.pictures[what], (TILE_PX, TILE_PX), interpolation=cv2.INTER_AREA)
        tile = np.ascontiguousarray(np.round(255 * tile).astype(np.uint8))
        label = one.name if not what else ""
        if what in one.faces and what:
            label = f"{apart(one.faces[''], one.faces[what]):.2f}"
        cv2.putText(tile, label, (6, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 2)
        cv2.putText(tile, label, (6, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 1)
        tiles.append(tile)
    return np.concatenate(tiles, axis=1)


if __name__ == "__main__":
    main()
