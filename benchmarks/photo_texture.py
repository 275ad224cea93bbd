"""One photograph against three of a person, as one texture: what of the skin is seen, and how well.

Part of `benchmarks.photo`. The heads are those that the fit knows nothing of. The truth is the
head's texture under the first photograph's light, and its albedo.
"""

from __future__ import annotations

import dataclasses
import time

import numpy as np

from benchmarks.networks_lights import light_of
from benchmarks.networks_people import Head
from benchmarks.networks_scores import db, squared
from learning.checkpoint import load_whole_face, shipped_weights
from learning.photo.config import FitConfig
from learning.photo.fit import FittedHead, fit_head
from learning.photo.shape_fit import Photograph, Places
from lightstage.formats.template import Template

FIRST = "hard-oblique"
YAWS_DEG = (0, 35, -35)
CASES = {
    "one": ((FIRST, 0),),
    "three, one light": tuple((FIRST, yaw) for yaw in YAWS_DEG),
    "three, each in its own light": tuple(
        zip((FIRST, "front", "warm-cool"), YAWS_DEG, strict=True)
    ),
}
NUMBER = 3
"""Of the lights' draw."""
HEADER = [
    "heads",
    "photographs",
    "skin seen, face",
    "skin seen, all",
    "texture dB, face",
    "texture dB, all skin",
    "of it where seen",
    "albedo dB, face",
    "albedo dB, all skin",
    "s",
]


@dataclasses.dataclass
class Sums:
    """What fits of one kind of heads came to, each a list over heads."""

    values: dict[str, list[float]] = dataclasses.field(default_factory=dict)

    def add(self, name: str, value: float) -> None:
        """Keep a value."""
        self.values.setdefault(name, []).append(value)

    def row(self, kind: str, case: str) -> list[str]:
        """Of the table."""
        share = [f"{100 * np.mean(self.values[n]):.0f} %" for n in ("seen face", "seen skin")]
        names = ("texture face", "texture skin", "texture seen", "albedo face", "albedo skin")
        return [
            kind,
            case,
            *share,
            *(f"{db(self.values[name]):.1f}" for name in names),
            f"{np.mean(self.values['seconds']):.0f}",
        ]


def measure_texture(
    head: Head,
    face: np.ndarray,
    shots: dict[tuple[str, int], Photograph],
    template: Template,
    places: Places,
    rows: int,
    sums: dict[str, Sums],
) -> None:
    """Fit one head by each of `CASES`, and add up its errors.

    Args:
        head: with its true maps.
        face: (rows, columns) bool, skin of the face.
        shots: photographs by light and yaw.
        template: ours.
        places: of the landmarks on it.
        rows: of the texture.
        sums: by case.
    """
    network, _ = load_whole_face(shipped_weights())
    truth = head.image(head.lit.under(light_of(FIRST, NUMBER)))
    albedo = head.maps["diffuse_albedo"]
    for case, chosen in CASES.items():
        began = time.perf_counter()
        photographs = [shots[key] for key in chosen]
        found = fit_head(photographs, template, places, network, FitConfig(rows=rows))
        seconds = time.perf_counter() - began
        for name, value in scores(found, truth, albedo, face, head.skin).items():
            sums[case].add(name, value)
        sums[case].add("seconds", seconds)


def scores(
    found: FittedHead, truth: np.ndarray, albedo: np.ndarray, face: np.ndarray, skin: np.ndarray
) -> dict[str, float]:
    """Shares of skin that are seen, and mean square errors of encoded texture and albedo."""
    maps = found.inferred.maps["diffuse_albedo"]
    seen = skin & found.seen
    return {
        "seen face": float((face & found.seen).sum() / face.sum()),
        "seen skin": float(seen.sum() / skin.sum()),
        "texture face": squared(found.texture[face], truth[face]),
        "texture skin": squared(found.texture[skin], truth[skin]),
        "texture seen": squared(found.texture[seen], truth[seen]),
        "albedo face": squared(maps[face], albedo[face]),
        "albedo skin": squared(maps[skin], albedo[skin]),
    }
