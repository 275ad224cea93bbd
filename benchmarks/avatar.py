"""Photographs to avatars: albedo, normals and new lights against the truth, beside plain guesses.

`python -m benchmarks.avatar` photographs people who were not trained on (simulated people of
another seed, people of ICT's model, the scanned head) under lights of the simulator, one photograph
each, and scores what `avatar` finds over skin of the face with the weights as shipped. ``--part
camera`` has a camera between that meters, balances and curves, and people with hair, beards, spots
and glasses: albedo and tone from the worst tone to the best, and twelve photographs of one person.
``--part glasses`` has people with clear and dark ones beside themselves without. ``--part speed``
and ``--part export`` measure seconds and memory. Truth and new lights are the simulator's own
rendering on the true shape: these are no figures of real people.

The scanned head is Infinite, 3D Head Scan by Lee Perry-Smith, CC BY 3.0, based on a work at
www.triplegangers.com. Its true albedo is its texture, with some shading baked in.
"""

from __future__ import annotations

import argparse

import numpy as np

from benchmarks.avatar_camera import measure_camera, measure_glasses
from benchmarks.avatar_photos import AVATAR, HARMONIC, MEAN, TEXTURE, Case, Score, score
from benchmarks.avatar_speed import SIZES, measure_export, measure_speed
from benchmarks.networks_people import KINDS, Who, chosen
from benchmarks.networks_scores import db, specular_share
from benchmarks.record import record
from learning.evaluation.people import by_tone, spread
from processing.tones import tone_of

ROWS, COUNT = 384, 3
LIGHTS = ("front", "hard-oblique", "studio", "warm-cool", "hard-side", "random")
"""Of the people, in turn."""
GUESSES = (AVATAR, TEXTURE, HARMONIC, MEAN)
PARTS = ("people", "camera", "glasses", "speed", "export")


def main() -> None:
    """Measure, print, record."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--part", choices=PARTS, help="of the benchmark; all of it else")
    parser.add_argument("--people", default=",".join(KINDS), help="kinds of heads, with commas")
    parser.add_argument("--count", type=int, default=COUNT, help="simulated people, and ICT's")
    parser.add_argument("--rows", type=int, default=ROWS, help="of the texture")
    parser.add_argument("--unseen", action="store_true", help="the half of ICT's people kept apart")
    asked = parser.parse_args()
    kinds = asked.people.split(",")
    parts = PARTS if asked.part is None else (asked.part,)
    whole = (asked.people, asked.count, asked.rows) == (",".join(KINDS), COUNT, ROWS)
    title = "Avatars from photographs" + ("" if whole else ", a part")
    title += ", kept apart" if asked.unseen else ""
    if "people" in parts:
        write_people(title, chosen(kinds, asked.count, asked.unseen), asked.rows)
    if "camera" in parts:
        measure_camera(title, asked.unseen)
    if "glasses" in parts:
        measure_glasses(title, asked.unseen)
    if "speed" in parts:
        measure_speed(title, SIZES)
    if "export" in parts:
        measure_export(title)


def write_people(title: str, people: list[Who], rows: int) -> None:
    """One photograph of each person."""
    scores: list[tuple[Who, Score]] = []
    lost: list[Who] = []
    for number, who in enumerate(people):
        found = score(Case(who, LIGHTS[number % len(LIGHTS)], 0.0, rows))
        if found is None:
            lost.append(who)
            continue
        scores.append((who, found))
        print(
            f"{number + 1} of {len(people)}: {who.kind} {who.name}, albedo "
            f"{db([found.albedo[AVATAR]]):.1f} dB, normals {found.normal_db[0]:.1f} dB, lamp "
            f"{found.light_deg:.0f} deg off",
            flush=True,
        )
    kinds = list(dict.fromkeys(who.kind for who in people))
    body = []
    for kind in [*kinds, "all"]:
        some = [each for who, each in scores if kind in (who.kind, "all")]
        if not some or (kind == "all" and len(kinds) == 1):
            continue
        normal, true_normal = (np.mean([each.normal_db[k] for each in some]) for k in (0, 1))
        degrees = [np.mean([each.normal_deg[k] for each in some]) for k in (0, 1)]
        body.append(
            [
                kind,
                str(len(some)),
                *(f"{db(each.albedo[guess] for each in some):.1f}" for guess in GUESSES),
                f"{db(each.seen for each in some):.1f}",
                f"{db(each.gain for each in some):.1f}",
                f"{normal:.1f} / {true_normal:.1f}",
                f"{degrees[0]:.1f} / {degrees[1]:.1f}",
                f"{specular_share(each.specular for each in some):.2f}",
                ", ".join(f"{db(each.relit[guess] for each in some):.1f}" for guess in GUESSES),
                f"{np.mean([each.shape_mm for each in some]):.2f}",
                f"{np.median([each.light_deg for each in some]):.0f}",
                f"{np.mean([each.seconds for each in some]):.0f}",
                str(sum(who.kind == kind or kind == "all" for who in lost)),
            ]
        )
    record(
        title,
        [
            "heads",
            "photographs",
            "albedo dB: avatar",
            "texture as albedo",
            "harmonic division",
            "mean person",
            "avatar where photographed",
            "avatar after the best gain a channel",
            "normals dB: avatar / true mesh",
            "normals deg: avatar / true mesh",
            "specular, of the best constant's error",
            "new lights dB (the same four)",
            "shape mm",
            "lamp off, deg, median",
            "fit s",
            "faces not found",
        ],
        body,
        f"One photograph of 768 x 1024 px each, 8 bits, from in front, focal length given, lights "
        f"{', '.join(LIGHTS)} in turn; textures of {rows} rows; over skin of the face. Normals are "
        "encoded as (n + 1) / 2; the true mesh has no pores. New lights: clamshell, street and a "
        "low lamp, by sim on the true shape, with the avatar's normals and the albedo of each "
        "guess. The ceiling is a capture of the scanned head: its atlas has 39.0 dB of albedo and "
        "1.5 degrees of normals in `make demo`.",
    )
    found_deg, true_deg = ([each.ita_deg[k] for _, each in scores] for k in (0, 1))
    off_deg = [abs(found - true) for found, true in zip(found_deg, true_deg, strict=True)]
    tones = by_tone(true_deg, off_deg)
    squares: dict[str, list[float]] = {}
    for _, each in scores:
        squares.setdefault(tone_of(each.ita_deg[1]), []).append(each.albedo[AVATAR])
    record(
        f"{title}: skin colour by tone",
        ["tone", "people", "error of the typology angle, deg", "albedo dB"],
        [
            [
                tone,
                count,
                f"{error:.1f}",
                f"{db(squares[tone]):.1f}",
            ]
            for tone, (count, error) in tones.items()
        ],
        f"The photographs of the table of the same name. The worst tone's error over the best's: "
        f"{spread(tones):.1f}.",
    )


if __name__ == "__main__":
    main()
