"""Photographs that a camera took, made into avatars: albedo and tone from the worst to the best."""

from __future__ import annotations

import dataclasses
import itertools
import pickle

import numpy as np

from benchmarks.avatar_photos import code_commit, fitted, write
from benchmarks.camera_cases import Fit, Known, albedo_score, cases, known, light_to_dark
from benchmarks.networks_lights import GROUPS
from benchmarks.networks_scores import db, light_deg
from benchmarks.record import changed, record
from benchmarks.reflectance_people import folder
from processing.colour import srgb_from_linear

SEED = 20
PEOPLE = {"ict": 5, "simulated": 4}
ONE_TONE = 5
"""The person of twelve photographs has at least this tone."""
WEARERS = {"ict": 2, "simulated": 2}
"""Lightest and darkest of each kind."""
TWELVE = (*GROUPS, "random", "studio")
"""Lights of one person's photographs, each by a camera of its own."""
SAMPLED = 4
"""Each so many-th texel a side of the face's albedo is kept, to compare photographs with."""


@dataclasses.dataclass(frozen=True)
class Found:
    """Score of a photograph.

    Attributes:
        name: of it.
        tone: true.
        fit: of the albedo.
        lamp_deg: between the strongest lamps.
        sample: (n, 3) found albedo at the same places of the face in each photograph of a person.
    """

    name: str
    tone: str
    fit: Fit
    lamp_deg: float
    sample: np.ndarray


def found_of(case: Known) -> Found | None:
    """Fit a photograph; None where no face was found. Kept by commit where nothing differs."""
    kept = folder() / f"avatar-{code_commit()}" / f"camera-{case.name}.pickle"
    if kept.is_file():
        found: Found | None = pickle.loads(kept.read_bytes())
        return found
    taken, result = case.photograph(), None
    if np.isfinite(taken.landmarks_px).any():
        answer = fitted(len(case.albedo), [taken])
        albedo = answer.inferred.maps["diffuse_albedo"]
        result = Found(
            case.name,
            case.tone,
            albedo_score(albedo, case.albedo, case.face),
            light_deg(answer.light, case.lights),
            albedo[::SAMPLED, ::SAMPLED][case.face[::SAMPLED, ::SAMPLED]],
        )
        print(
            f"{case.name}, {case.tone}: {db([result.fit.raw]):.1f} dB, after gain "
            f"{db([result.fit.gain]):.1f} dB, angle {result.fit.ita_deg:+.0f} deg",
            flush=True,
        )
    if not any(name.endswith(".py") for name in changed()):
        write(kept, result)
    return result


def measure_camera(title: str, unseen: bool) -> None:
    """Photographs of people with and without hair by tone, and twelve of one person."""
    body = []
    for marked in (False, True):
        answers = [
            found_of(case)
            for kind, count in PEOPLE.items()
            if not (unseen and kind == "simulated")
            for case in cases(kind, count, SEED, unseen, marked=marked)
        ]
        kind = "hair and marks" if marked else "bare"
        body += by_tone_rows(kind, answers)
    record(
        f"{title}: a camera between",
        ["people", "tone", "photographs", *SCORES, "lamp off, deg, median", "faces not found"],
        body,
        "Photographs of 768 x 1024 px by cameras that meter face, centre or scene, with white "
        "balance, tone curve, noise and JPEG, 28 to 200 mm, the focal length given of half of "
        "them; textures of 384 rows, over skin of the face. Worst tone first.",
    )
    who = next(p for p in light_to_dark("ict", 5, unseen) if (p.tone or 0) >= ONE_TONE)
    some = [
        found_of(known(who, SEED, 100 + number, marked=True, light=light))
        for number, light in enumerate(TWELVE)
    ]
    there = [each for each in some if each is not None]
    albedos = [srgb_from_linear(each.sample) for each in there]
    pairs = [db([float(np.square(a - b).mean())]) for a, b in itertools.combinations(albedos, 2)]
    record(
        f"{title}: twelve lights and cameras of one person",
        ["person", "photographs", "agree, dB, mean", "least pair", *SCORES, "faces not found"],
        [
            [
                f"{who.name}, tone {who.tone}",
                str(len(there)),
                f"{np.mean(pairs):.1f}",
                f"{min(pairs):.1f}",
                *score_cells(there),
                str(len(some) - len(there)),
            ]
        ],
        f"PSNR between the albedos of each pair, sRGB. Lights {', '.join(TWELVE)}.",
    )


def measure_glasses(title: str, unseen: bool) -> None:
    """People without glasses, with clear ones and with dark ones, by one camera and light each."""
    body = []
    for kind, count in WEARERS.items():
        for who in light_to_dark(kind, count, unseen):
            found = [found_of(known(who, SEED, 0, lenses=worn)) for worn in (None, "clear", "dark")]
            tone = "" if found[0] is None else found[0].tone
            cells = ("no face" if each is None else f"{db([each.fit.gain]):.1f}" for each in found)
            body.append([f"{who.kind} {who.name}", tone, *cells])
    record(
        f"{title}: glasses",
        ["person", "tone", "without, dB", "clear", "dark"],
        body,
        "Albedo after the best gain a channel, over skin of the face; textures of 384 rows.",
    )


SCORES = ("albedo dB", "after the best gain a channel", "error of the typology angle, deg", "worst")


def score_cells(found: list[Found]) -> list[str]:
    """The columns `SCORES`."""
    angles = [abs(each.fit.ita_deg) for each in found]
    return [
        f"{db(each.fit.raw for each in found):.1f}",
        f"{db(each.fit.gain for each in found):.1f}",
        f"{np.mean(angles):.1f}",
        f"{max(angles):.1f}",
    ]


def by_tone_rows(kind: str, answers: list[Found | None]) -> list[list[str]]:
    """A row for each tone, the worst albedo first, and one for all."""
    groups: dict[str, list[Found]] = {}
    for each in answers:
        if each is not None:
            groups.setdefault(each.tone, []).append(each)
    worst_first = sorted(groups, key=lambda tone: db(each.fit.raw for each in groups[tone]))
    everyone = [each for tone in worst_first for each in groups[tone]]
    lost = [""] * len(groups) + [str(len(answers) - len(everyone))]
    return [
        [
            kind,
            tone,
            str(len(some)),
            *score_cells(some),
            f"{np.median([each.lamp_deg for each in some]):.0f}",
            missed,
        ]
        for (tone, some), missed in zip(
            [*((tone, groups[tone]) for tone in worst_first), ("all", everyone)], lost, strict=True
        )
    ]
