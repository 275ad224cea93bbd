"""Photographs that a camera took of people whose albedo is known, kept by what made them.

`cases` makes them; a photograph, its person's albedo and where the face is stay in
LIGHTSTAGE_BENCHMARK_DATA as long as the code that renders them is the same, so that a changed fit
does not render them again.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import pickle
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.avatar_photos import face_of, head_of, marks, write
from benchmarks.networks_lights import LitPoints, light_of
from benchmarks.networks_people import Head, Who, chosen, make
from benchmarks.networks_scores import squared
from benchmarks.photo_camera import Shooting, drawn, taken
from benchmarks.photo_hair import looks_of, painted, worn
from benchmarks.photo_studio import of_codes
from benchmarks.reflectance_people import folder
from learning.photo.shape_fit import Photograph
from lightstage.formats.environment import LightSet
from processing.tones import ita_deg, tone_of
from sim.light.scene import Scene
from sim.people.traits import TONES

ROWS = 384
CAMERA_LIGHTS = ("front", "studio", "hard-oblique", "warm-cool", "random", "hard-side", "random")
YAW_DEG = 8.0
"""Deviation of the camera's place from straight before the face."""
PLANNED = 12
"""So many of a model's people have all six tones."""
RENDERS = ("sim", "benchmarks/networks_*.py", "benchmarks/photo_*.py", "benchmarks/camera_cases.py")
REPOSITORY = Path(__file__).parent.parent


@dataclasses.dataclass(frozen=True)
class Known:
    """A person before a camera, and what is true of them.

    Attributes:
        name: of the photograph.
        codes: (h, w, 3) uint8 of the file.
        albedo: (rows, columns, 3) float32 true diffuse albedo on our template.
        face: (rows, columns) bool, skin of the face, which is scored.
        lights: in the head frame.
        shooting: how the camera was set.
        focal_px: true.
    """

    name: str
    codes: np.ndarray
    albedo: np.ndarray
    face: np.ndarray
    lights: LightSet
    shooting: Shooting
    focal_px: float

    @property
    def true_ita_deg(self) -> float:
        """Typology angle of the face."""
        return ita_deg(self.albedo[self.face])

    @property
    def tone(self) -> str:
        """The group of that angle."""
        return tone_of(self.true_ita_deg)

    def photograph(self) -> Photograph:
        """The photograph that the fit reads; landmarks are sought by the code as it is."""
        told = self.focal_px if self.shooting.told else None
        return of_codes(self.codes, marks(), self.name, told)


@dataclasses.dataclass(frozen=True)
class Fit:
    """An albedo against the truth, over skin of the face.

    Attributes:
        raw: mean square error, sRGB-encoded.
        gain: the same after the best gain a channel.
        ita_deg: found typology angle less the true one.
    """

    raw: float
    gain: float
    ita_deg: float


def albedo_score(found: np.ndarray, true: np.ndarray, face: np.ndarray) -> Fit:
    """Hold a (rows, columns, 3) albedo against the true one where (rows, columns) is the face."""
    one, other = found[face], true[face]
    gain = (one * other).sum(0) / np.maximum((one**2).sum(0), 1e-12)
    return Fit(squared(one, other), squared(gain * one, other), ita_deg(one) - ita_deg(other))


def light_to_dark(kind: str, count: int, unseen: bool) -> list[Who]:
    """People of a kind, their tones spread evenly from the lightest to the darkest."""
    people = chosen([kind], PLANNED, unseen)
    if kind == "scan":
        return people
    tones = np.resize(np.round(np.linspace(TONES[0], TONES[-1], min(count, len(TONES)))), count)
    found = []
    for tone in tones:
        who = next(each for each in people if each.tone == tone)
        people.remove(who)
        found.append(who)
    return found


def cases(
    kind: str, count: int, seed: int, unseen: bool, each: int = 2, marked: bool = False
) -> Iterator[Known]:
    """Photographs of people, each of them in several lights by several cameras.

    Args:
        kind: of `networks_people.KINDS`.
        count: of people.
        seed: of lights and cameras.
        unseen: the half of ICT's people that is kept apart.
        each: photographs of each person.
        marked: people have hair, beards, spots, folds, make-up and glasses, see `photo_hair`.
    """
    for who in light_to_dark(kind, count, unseen):
        for number in range(each):
            yield known(who, seed, number, marked=marked)


def known(
    who: Who,
    seed: int,
    number: int,
    rows: int = ROWS,
    marked: bool = False,
    light: str | None = None,
    lenses: str | None = None,
) -> Known:
    """A photograph of a person, as it was kept, or made.

    Args:
        who: is seen.
        seed: of lights and cameras.
        number: of the photograph among the person's.
        rows: of the true maps.
        marked: see `cases`.
        light: of `networks_lights.GROUPS`; one of `CAMERA_LIGHTS` is drawn where None.
        lenses: `clear` or `dark` ones before a bare person.
    """
    name = f"{who.kind}-{who.name}-{seed}-{number}{'-marked' * marked}"
    name += "".join(f"-{each}" for each in (light, lenses) if each is not None)
    kept = folder() / f"camera-{rendering()}" / f"{name}-{rows}.pickle"
    if kept.is_file():
        found: Known = pickle.loads(kept.read_bytes())
        return found
    rng = np.random.default_rng([seed, number, zlib.crc32(f"{who.kind}-{who.name}".encode())])
    shooting = drawn(rng)
    common = CAMERA_LIGHTS[int(rng.integers(len(CAMERA_LIGHTS)))]
    lights = light_of(light or common, int(rng.integers(2**31)))
    head = marked_head(who, rows) if marked else head_of(who, rows)
    if lenses is not None:
        head = seen_with_glasses(head, lenses == "dark")
    codes, sitter = taken(head, float(rng.normal(0, YAW_DEG)), lights, shooting)
    to_head = head.head_from_world
    inside = lights.position_mm @ to_head[:, :3].T + to_head[:, 3]
    answer = Known(
        name,
        codes,
        head.maps["diffuse_albedo"].astype(np.float32),
        face_of(head),
        dataclasses.replace(lights, position_mm=inside),
        shooting,
        sitter.camera.fx_px,
    )
    write(kept, answer)
    return answer


@functools.lru_cache(maxsize=1)
def marked_head(who: Who, rows: int) -> Head:
    """A head with its looks, and glasses in what a camera sees of it: one at a time is held."""
    looks = looks_of(who)
    head = make(who, rows, lambda subject: painted(subject, looks, 0))
    return seen_with_glasses(head, dark=False) if looks.glasses else head


def seen_with_glasses(head: Head, dark: bool) -> Head:
    """The head as a camera sees it behind glasses; its true maps are those without."""
    scene = Scene(worn(head.lit.scene.subject, dark))
    return dataclasses.replace(head, lit=LitPoints(scene, head.lit.points))


@functools.cache
def rendering() -> str:
    """Hash of the code that makes photographs and their truth, as it lies on the disk."""
    digest = hashlib.sha256()
    for pattern in RENDERS:
        path = REPOSITORY / pattern
        files = path.rglob("*.py") if path.is_dir() else path.parent.glob(path.name)
        for file in sorted(files):
            digest.update(file.read_bytes())
    return digest.hexdigest()[:12]
