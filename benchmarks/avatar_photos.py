"""A head photographed, made into an avatar, and scored against the truth over the face.

A head that took minutes to make is kept as it was scored in LIGHTSTAGE_BENCHMARK_DATA, by commit,
so that a benchmark that was stopped continues where it was.
"""

from __future__ import annotations

import dataclasses
import functools
import pickle
import time
import zlib
from pathlib import Path

import numpy as np

from benchmarks.networks_guesses import harmonic_division
from benchmarks.networks_head import relit_squares
from benchmarks.networks_lights import light_of
from benchmarks.networks_people import Head, Who, make
from benchmarks.networks_scores import light_deg, specular_sums, squared
from benchmarks.photo import apart, in_head, scored
from benchmarks.photo_studio import Sitter, marks_of, photograph
from benchmarks.record import changed, git
from benchmarks.reflectance_people import folder
from learning.checkpoint import (
    load_mesostructure,
    load_super_resolution,
    load_whole_face,
    shipped_mesostructure,
    shipped_super_resolution,
    shipped_weights,
)
from learning.evaluation.measures import normal_measures
from learning.mesostructure.infer import TrainedMesostructure
from learning.networks.whole_face import WholeFaceNetwork
from learning.photo.config import FitConfig
from learning.photo.fit import FittedHead, fit_head
from learning.photo.marks import FaceMarks
from learning.photo.shape_fit import Photograph
from learning.render.uv import rasterise
from learning.upscale.network import Rcan
from learning.whole.detail import enlarged
from lightstage.formats.environment import LightSet
from lightstage.formats.template import Template, default_template_path, load_template
from processing.tones import ita_deg

SETTLES_SECONDS = 120.0
"""For the search of the light, which ends by itself before that: a busy machine finds the same."""
CODE = ("benchmarks/*.py", "learning", "lightstage", "processing", "sim")
AVATAR, TEXTURE, HARMONIC, MEAN = (
    "avatar",
    "texture as albedo",
    "harmonic division",
    "mean person",
)


@dataclasses.dataclass(frozen=True)
class Case:
    """One photograph of one head.

    Attributes:
        who: is shown.
        light: of `networks_lights.GROUPS`.
        yaw_deg: of the camera.
        rows: of the texture.
    """

    who: Who
    light: str
    yaw_deg: float
    rows: int

    @property
    def name(self) -> str:
        """Of the file that keeps what was found."""
        return f"{self.who.kind}-{self.who.name}-{self.light}-{self.yaw_deg:g}-{self.rows}"


@dataclasses.dataclass(frozen=True)
class Score:
    """What became of a photograph, over skin of the face.

    Attributes:
        albedo: mean square error by guess, sRGB-encoded.
        seen: the avatar's, of texels that the photograph shows.
        gain: the avatar's after the best gain a channel.
        normal_db: PSNR of the encoded diffuse normals, of the avatar and of the true mesh.
        normal_deg: mean angle of the same two.
        specular: see `networks_scores.specular_sums`.
        relit: mean square error in new lights by guess.
        ita_deg: typology angle, found and true.
        shape_mm: mean distance of corresponding vertices of the face, after a similarity.
        light_deg: between the strongest lamps.
        masked: share of the seen face that was taken for no skin.
        known: share of the face that the photograph shows.
        seconds: of the fit.
    """

    albedo: dict[str, float]
    seen: float
    gain: float
    normal_db: tuple[float, float]
    normal_deg: tuple[float, float]
    specular: tuple[float, float, float, float]
    relit: dict[str, float]
    ita_deg: tuple[float, float]
    shape_mm: float
    light_deg: float
    masked: float
    known: float
    seconds: float


@functools.cache
def template() -> Template:
    """Our own."""
    return load_template(default_template_path())


@functools.cache
def marks() -> FaceMarks:
    """The points that photographs' faces have."""
    return marks_of(template())


@functools.cache
def networks() -> tuple[WholeFaceNetwork, TrainedMesostructure, Rcan]:
    """The shipped weights."""
    relief, about = load_mesostructure(shipped_mesostructure())
    whole = load_whole_face(shipped_weights())[0]
    larger = load_super_resolution(shipped_super_resolution())[0]
    return whole, TrainedMesostructure(relief, about.texture_rows), larger


@functools.lru_cache(maxsize=1)
def head_of(who: Who, rows: int) -> Head:
    """A head: one at a time is held."""
    return make(who, rows)


def light_for(case: Case) -> LightSet:
    """The case's light; `random` differs from head to head."""
    return light_of(case.light, zlib.crc32(case.who.name.encode()))


@functools.lru_cache(maxsize=1)
def sitter_of(who: Who, yaw_deg: float, rows: int) -> Sitter:
    """A head before a camera: one at a time is held."""
    return Sitter(head_of(who, rows), yaw_deg)


def shot(case: Case) -> Photograph:
    """The photograph."""
    sitter = sitter_of(case.who, case.yaw_deg, case.rows)
    return photograph(sitter, light_for(case), marks(), case.name)


def fitted(rows: int, photographs: list[Photograph]) -> FittedHead:
    """What `fit` makes of photographs; the first gives the texture of so many rows."""
    config = FitConfig(rows=rows, refine_seconds=SETTLES_SECONDS)
    whole, relief, larger = networks()
    return fit_head(
        photographs, template(), marks().places, whole, config, relief, super_resolution=larger
    )


def score(case: Case) -> Score | None:
    """Photograph, fit and score a head; None where no face was found.

    Kept by commit where nothing differs from it.
    """
    kept = folder() / f"avatar-{code_commit()}" / f"{case.name}.pickle"
    if kept.is_file():
        found: Score | None = pickle.loads(kept.read_bytes())
        return found
    taken = shot(case)
    result = None
    if np.isfinite(taken.landmarks_px).any():
        began = time.perf_counter()
        answer = fitted(case.rows, [taken])
        result = scored_fit(case, answer, time.perf_counter() - began)
    if not any(name.endswith(".py") for name in changed()):
        write(kept, result)
    return result


@functools.cache
def code_commit() -> str:
    """Abbreviated hash of the last commit that changed what is measured, or how."""
    return git("log", "-1", "--format=%h", "--", *CODE)


def write(kept: Path, result: object) -> None:
    """Keep a score, or what it is made from."""
    kept.parent.mkdir(parents=True, exist_ok=True)
    beside = kept.with_suffix(".part")
    beside.write_bytes(pickle.dumps(result))
    beside.rename(kept)


def face_of(head: Head) -> np.ndarray:
    """(rows, columns) bool, skin of the face that shape is scored on, too."""
    face = scored(template())[:, None].astype(float)
    raster = rasterise(template().mesh, *head.shown.shape)
    return np.asarray(head.skin & (raster.interpolate(face)[..., 0] > 0.5))


def scored_fit(case: Case, found: FittedHead, seconds: float) -> Score:
    """Hold a fit against the truth."""
    head = head_of(case.who, case.rows)
    face = face_of(head)
    maps = found.inferred.maps
    true = head.maps["diffuse_albedo"]
    turn = head.head_from_world[:, :3]
    raster = rasterise(head.mesh, *head.shown.shape)
    own = raster.normals(head.mesh) @ turn.T
    true_normal = head.maps["diffuse_normal"] @ turn.T
    mean_log = networks()[0].mean_log_albedo[0].permute(1, 2, 0).numpy()
    mean = enlarged(np.exp(mean_log), *head.shown.shape)
    fitted_raster = rasterise(found.shape.meshes[0], *head.shown.shape)
    guesses = {
        AVATAR: maps["diffuse_albedo"],
        TEXTURE: found.texture,
        HARMONIC: harmonic_division(
            found.texture, mean, fitted_raster.normals(found.shape.meshes[0]), head.shown
        ),
        MEAN: mean,
    }
    normals = [
        normal_measures("n", each, true_normal, face) for each in (maps["diffuse_normal"], own)
    ]
    in_world = {
        name: image @ turn if name.endswith("_normal") else image for name, image in maps.items()
    }
    small = dataclasses.replace(head, skin=face)
    relit = {
        name: float(np.mean(relit_squares(small, {**in_world, "diffuse_albedo": albedo})))
        for name, albedo in guesses.items()
    }
    gain = (maps["diffuse_albedo"] * true)[face].sum(0)
    gain = gain / np.maximum((maps["diffuse_albedo"] ** 2)[face].sum(0), 1e-12)
    vertices = scored(template())
    off = apart(
        found.shape.meshes[0].vertices[vertices], in_head(head, head.mesh.vertices)[vertices]
    )
    seen = face & found.seen
    lamps = light_for(case)
    return Score(
        {name: squared(albedo[face], true[face]) for name, albedo in guesses.items()},
        squared(maps["diffuse_albedo"][seen], true[seen]) if seen.any() else float("nan"),
        squared((gain * maps["diffuse_albedo"])[face], true[face]),
        (normals[0]["n_psnr_db"], normals[1]["n_psnr_db"]),
        (normals[0]["n_mean_deg"], normals[1]["n_mean_deg"]),
        specular_sums(maps["specular_albedo"][face], head.maps["specular_albedo"][face]),
        relit,
        (ita_deg(maps["diffuse_albedo"][face]), ita_deg(true[face])),
        float(np.linalg.norm(off, axis=1).mean()),
        light_deg(
            found.light, dataclasses.replace(lamps, position_mm=in_head(head, lamps.position_mm))
        ),
        found.masked,
        float(seen.sum() / face.sum()),
        seconds,
    )
