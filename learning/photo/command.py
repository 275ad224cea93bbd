"""What `fit` does: read photographs, find faces, fit, write a folder, return the facts."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path
from typing import Any

import numpy as np

from learning.checkpoint import (
    load_mesostructure,
    load_super_resolution,
    shipped_mesostructure,
    shipped_super_resolution,
    whole_face_of,
)
from learning.errors import MapsError
from learning.export.morphs import morph_names
from learning.limits import configured
from learning.mesostructure.infer import TrainedMesostructure
from learning.networks.whole_face import WholeFaceNetwork
from learning.photo.config import FitConfig
from learning.photo.eyes import openings, whites
from learning.photo.fit import FittedHead, fit_head
from learning.photo.grey import coloured, has_no_colour
from learning.photo.marks import FaceMarks, face_marks
from learning.photo.page import write_page
from learning.photo.picture import PhotoFile, read_photograph
from learning.photo.shape_fit import Photograph, Places
from learning.points.network import shipped_finder
from lightstage.commands import ProgressCallback
from lightstage.counting import counted
from lightstage.errors import ConfigError
from lightstage.faces import SURE, Face, detect_faces, small_faces
from lightstage.faces.schemes import FACE_MESH, IBUG, IBUG_PAIRS, INNER_LIPS, ibug68, seen_points
from lightstage.formats.environment import write_lights
from lightstage.formats.exr import write_exr
from lightstage.formats.files import (
    atomic_folder,
    read_json,
    require_replaceable,
    write_json,
)
from lightstage.formats.landmarks import read_points_px
from lightstage.formats.mesh import write_obj
from lightstage.formats.processed import write_map
from lightstage.formats.template import Template, load_template
from processing.colour import srgb_from_linear

SCHEMA = "lightstage.fit/1"
FIT, PAGE, TEXTURE, LIGHT = "fit.json", "fit.html", "texture.exr", "light.json"
MESH, NEUTRAL = "registered_mesh.obj", "neutral_mesh.obj"
MAPS = "atlas"
OWN = (FIT, PAGE, TEXTURE, LIGHT, MESH, NEUTRAL, f"{MAPS}/*.exr")
"""What a fit's folder holds."""
MOST_PHOTOGRAPHS = 32
LEAST_PRESENCE = 0.1
"""Confidence of the detector from which a face is taken where there is no surer one: a profile."""


@dataclasses.dataclass(frozen=True)
class FitRequest:
    """The options of `fit`.

    Attributes:
        photographs: of one person; the light of the first is the texture's.
        template: folder.
        out: folder to make.
        landmarks: file with the points of each photograph; detected where None.
        face: which face of a photograph, the largest is 1.
        film_mm: 35 mm equivalent of the focal length, in place of what the files state.
        checkpoint: a run of a whole-face network; the shipped weights where None.
        rows: of the texture; the configuration's where None.
        refine: seconds; the configuration's where None.
        config: TOML file, or None.
    """

    photographs: tuple[Path, ...]
    template: Path
    out: Path
    landmarks: Path | None = None
    face: int = 1
    film_mm: float | None = None
    checkpoint: Path | None = None
    rows: int | None = None
    refine: float | None = None
    config: Path | None = None


def fit_command(request: FitRequest, progress: ProgressCallback) -> dict[str, Any]:
    """Fit a head to photographs of one person; the facts.

    Raises:
        LightstageError: bad input; nothing is written then.
    """
    began = time.monotonic()
    options = {"rows": ("--rows", request.rows), "refine_seconds": ("--refine", request.refine)}
    config = configured(FitConfig, request.config, options, "fit")
    require_replaceable(request.out, FIT, own=OWN)
    network = whole_face_of(request.checkpoint)
    template = load_template(request.template)
    photographs, places, notes = read_all(request, template)
    colourless = [has_no_colour(each.rgb_linear) for each in photographs]
    photographs = [
        _coloured(each, network, notes) if grey else each
        for each, grey in zip(photographs, colourless, strict=True)
    ]
    meso, about_meso = load_mesostructure(shipped_mesostructure())
    fitted = fit_head(
        photographs,
        template,
        places,
        network,
        config,
        TrainedMesostructure(meso, about_meso.texture_rows),
        progress,
        load_super_resolution(shipped_super_resolution())[0] if config.super_resolution else None,
    )
    facts = _facts(photographs, colourless, fitted, config, notes, request.template)
    with atomic_folder(request.out, FIT, own=OWN) as folder:
        write_fitted(folder, fitted)
        write_json(folder / FIT, {"schema": SCHEMA, **facts})
        write_page(folder / PAGE, photographs, fitted)
    return {**facts, "seconds": time.monotonic() - began}


def read_all(request: FitRequest, template: Template) -> tuple[list[Photograph], Places, list[str]]:
    """The photographs with their landmarks, where these are on the template, and notes."""
    paths = request.photographs
    if not 1 <= len(paths) <= MOST_PHOTOGRAPHS:
        raise ConfigError(
            "PHOTO", found=counted(len(paths), "file"), expected=f"1 to {MOST_PHOTOGRAPHS}"
        )
    if request.face < 1:
        raise ConfigError("--face", found=str(request.face), expected="1 for the largest, or more")
    if request.landmarks is not None and request.face != 1:
        raise ConfigError(
            "--face",
            found=f"{request.face}, given with --landmarks",
            expected="one of them: the landmarks are of one face",
        )
    marks = Marks(request, template)
    notes: list[str] = []
    photographs = []
    for path in paths:
        file = read_photograph(path, request.film_mm)
        photographs.append(marks.photograph(path, file, notes))
        if file.focal_px is None:
            notes.append(
                f"{path.name} does not state its focal length: it was fitted, and the face's depth "
                "is less certain (--focal-35mm)"
            )
    return photographs, marks.places, notes


def _coloured(photograph: Photograph, network: WholeFaceNetwork, notes: list[str]) -> Photograph:
    """A black-and-white photograph in the mean person's colour; a note states it."""
    notes.append(
        f"{photograph.name} is black and white: the colour of its skin is the mean person's, not "
        "the photograph's"
    )
    rgb = coloured(photograph.rgb_linear, network)
    return dataclasses.replace(photograph, rgb_linear=rgb)


class Marks:
    """Landmarks of photographs: from a file, or detected."""

    def __init__(self, request: FitRequest, template: Template) -> None:
        """The template must have the places of the scheme's points.

        Raises:
            MapsError: a template without the detector's points.
            FormatError: a file of landmarks that cannot be read.
        """
        self._face = request.face
        self._marks: FaceMarks | None = None
        self._file = request.landmarks
        self._stated: dict[str, np.ndarray] = {}
        self._taken: dict[str, Path] = {}
        scheme = FACE_MESH
        if self._file is not None:
            scheme = str(read_json(self._file, "lightstage.landmarks/1").get("scheme"))
            self._stated = read_points_px(self._file, scheme if scheme == FACE_MESH else IBUG)
        if scheme == FACE_MESH:
            # Points that are stated in a file are the detector's, or clicked: they count alone.
            finder = None if self._file is not None else shipped_finder(template)
            found = face_marks(template, finder)
            if found is None:
                raise MapsError(
                    request.template,
                    field=f"{FACE_MESH}.json",
                    found="none",
                    expected="the places of the detector's points on the template",
                    hint="`lightstage-learning template-points --template TEMPLATE` finds them.",
                )
            self.places, self._there, self._marks = found.places, found.there, found
        else:
            self._there = np.ones(len(template.landmarks), bool)
            corners = np.repeat(template.landmarks[:, None], 3, axis=1)
            weights = np.tile([1.0, 0.0, 0.0], (len(corners), 1))
            self.places = Places(corners, weights, np.zeros(len(corners)))

    def photograph(self, path: Path, file: PhotoFile, notes: list[str]) -> Photograph:
        """Make a photograph of a file: landmarks, how much they count, eyes and mouth.

        Raises:
            MapsError: no face, no face of that number, or none in the file of landmarks, or those
                of two photographs in one.
        """
        rgb, weight = file.rgb_linear, None
        if self._file is not None:
            stated = file.scale * self._stated_in(self._file, path)
            marks = stated if len(stated) == len(IBUG_PAIRS) else ibug68(stated)
            points = stated[self._there]
        else:
            shown = np.round(255 * srgb_from_linear(rgb)).astype(np.uint8)
            face = self._detected_in(shown, path, notes)
            marks = seen_points(face, IBUG)
            assert self._marks is not None
            points, weight = self._marks.of(shown, face)
        return Photograph(
            path.name,
            rgb,
            points,
            file.focal_px,
            weight,
            openings(rgb, marks),
            whites(rgb, marks),
            marks[INNER_LIPS],
        )

    def _stated_in(self, file: Path, path: Path) -> np.ndarray:
        for name in (path.name, path.stem):
            if name not in self._stated:
                continue
            if name in self._taken:
                raise MapsError(
                    file,
                    field=f"points_px, {name}",
                    found=f"one entry for {self._taken[name]} and {path}",
                    expected="the landmarks of each photograph, by its file's name",
                    hint="Rename one of the two photographs.",
                )
            self._taken[name] = path
            return self._stated[name]
        raise MapsError(
            file,
            field="points_px",
            found=f"no {path.name}",
            expected="the landmarks of each photograph, by its file's name",
        )

    def _detected_in(self, shown: np.ndarray, path: Path, notes: list[str]) -> Face:
        faces = _faces(shown)
        if len(faces) < self._face:
            found = counted(len(faces), "face") if faces else "no face"
            raise MapsError(
                path,
                found=found,
                expected="a face that is turned toward the camera, or half away from it"
                if self._face == 1
                else f"{self._face} faces (--face)",
                hint="Cut the picture around the face, or give its points by --landmarks.",
            )
        if len(faces) > 1 and self._face == 1:
            notes.append(
                f"{path.name} shows {len(faces)} faces: the largest was taken (--face 2 for the "
                "next)"
            )
        face = faces[self._face - 1]
        if face.presence < SURE:
            notes.append(
                f"{path.name}: the detector is {100 * face.presence:.0f} % sure that this is a "
                "face; inspect the fit over it"
            )
        return face


def _faces(shown: np.ndarray) -> list[Face]:
    """Faces of a photograph, the largest first: sure ones, however small, before doubtful ones."""
    faces = detect_faces(shown)
    if not any(face.presence >= SURE for face in faces):
        faces = small_faces(shown) or faces
    return faces or detect_faces(shown, LEAST_PRESENCE)


def write_fitted(folder: Path, fitted: FittedHead) -> None:
    """Write the meshes, the texture, the maps and the light into a folder that exists."""
    shape = fitted.shape
    write_obj(shape.meshes[0], folder / MESH)
    write_obj(shape.neutral, folder / NEUTRAL)
    write_exr(folder / TEXTURE, fitted.texture)
    maps = dict(fitted.inferred.maps)
    maps["confidence"] = np.minimum(maps["confidence"], fitted.confidence)
    (folder / MAPS).mkdir()
    for name, image in maps.items():
        write_map(folder / MAPS / f"{name}.exr", name, image)
    if fitted.light is not None:
        write_lights(fitted.light, folder / LIGHT)


def _facts(
    photographs: list[Photograph],
    colourless: list[bool],
    fitted: FittedHead,
    config: FitConfig,
    notes: list[str],
    template: Path,
) -> dict[str, Any]:
    """What fit.json holds."""
    shape = fitted.shape
    names = shape.model.expression_names
    taken = [
        {
            "name": photograph.name,
            "width_px": camera.width_px,
            "height_px": camera.height_px,
            "focal_px": camera.fx_px,
            "focal_told": photograph.focal_px is not None,
            "black_and_white": colourless[index],
            "cam_from_head": camera.cam_from_world.tolist(),
            "landmark_px": found.residual_px,
            "landmarks_used": float((found.used > 0.25).mean()),
            "expression": {
                name: weight
                for own, weight in zip(names, found.expression.tolist(), strict=True)
                for name in morph_names(own) or (own,)
            },
            "texture_percent": float(100 * (fitted.source == index).mean()),
        }
        for index, (photograph, camera, found) in enumerate(
            zip(photographs, shape.cameras, shape.landmarks.photographs, strict=True)
        )
    ]
    face = shape.model.face
    return {
        "template": template.name,
        "config": dataclasses.asdict(config),
        "photographs": taken,
        "identity": shape.landmarks.identity[: shape.model.named_modes].tolist(),
        "shape_deviation_mm": float(shape.deviation_mm[face].mean()),
        "rows": fitted.texture.shape[0],
        "columns": fitted.texture.shape[1],
        "seen_percent": float(100 * fitted.seen.mean()),
        "not_skin_percent": 100 * fitted.masked,
        "lamps": None if fitted.light is None else len(fitted.light.rgb),
        "tone": None
        if fitted.tone is None
        else dataclasses.asdict(fitted.tone) | {"rgb": fitted.tone.rgb.tolist()},
        "misfit": None if np.isnan(fitted.misfit) else fitted.misfit,
        "notes": [*notes, *fitted.notes],
    }
