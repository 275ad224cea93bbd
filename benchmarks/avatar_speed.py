"""Seconds, memory and error of `avatar` by stage and by the texture's size."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

from benchmarks.avatar_photos import Case, face_of, head_of, shot
from benchmarks.networks_people import chosen
from benchmarks.networks_scores import db, squared
from benchmarks.record import record
from lightstage.formats.exr import read_exr
from lightstage.formats.template import default_template_path
from processing.colour import srgb_from_linear

SIZES = (384, 768, 1536, 6144)
TRUTH_ROWS = 384
LIGHT = "hard-oblique"
TIMED = """
import json, resource, sys, time
from contextlib import contextmanager
from pathlib import Path
from learning.avatar import avatar_command
from learning.photo.command import FitRequest

taken = {}

@contextmanager
def bar(label):
    began = time.perf_counter()
    yield lambda done, total: None
    taken[label.removeprefix("avatar ")] = time.perf_counter() - began

photo, template, out, rows, formats = sys.argv[1:]
request = FitRequest((Path(photo),), Path(template), Path(out), rows=int(rows))
avatar_command(request, "export", formats, bar)
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
print(json.dumps({"seconds": taken, "peak_gib": peak}))
"""


def measure_speed(title: str) -> None:
    """One photograph of 768 x 1024 px to a page, in a process of its own for each size."""
    who = chosen(["simulated"], 1, False)[0]
    case = Case(who, LIGHT, 0.0, TRUTH_ROWS)
    taken = shot(case)
    head = head_of(who, TRUTH_ROWS)
    face, true = face_of(head), head.maps["diffuse_albedo"]
    body = []
    with tempfile.TemporaryDirectory() as folder:
        photo = Path(folder) / "photo.png"
        codes = np.round(255 * srgb_from_linear(taken.rgb_linear)).astype(np.uint8)
        cv2.imwrite(str(photo), codes[..., ::-1])
        for rows in SIZES:
            out = Path(folder) / str(rows)
            began = time.perf_counter()
            # A page of 6144 rows shows 2048 of them; glTF has all.
            words = [str(photo), str(default_template_path()), str(out), str(rows), "gltf,page"]
            told = subprocess.run(
                [sys.executable, "-c", TIMED, *words], check=True, capture_output=True, text=True
            )
            facts = json.loads(told.stdout.splitlines()[-1])
            albedo = read_exr(out / "fit" / "atlas" / "diffuse_albedo.exr")
            size = (TRUTH_ROWS * 2 // 3, TRUTH_ROWS)
            small = cv2.resize(albedo.astype(np.float32), size, interpolation=cv2.INTER_AREA)
            seconds = facts["seconds"]
            body.append(
                [
                    str(rows),
                    *(
                        f"{seconds.get(stage, 0):.1f}"
                        for stage in ("fit", "detail", "export", "page")
                    ),
                    f"{time.perf_counter() - began:.0f}",
                    f"{facts['peak_gib']:.1f}",
                    f"{db([squared(small[face], true[face])]):.1f}",
                ]
            )
            print(body[-1], flush=True)
    record(
        f"{title}: seconds and memory by stage",
        ["rows", "fit s", "detail s", "export s", "page s", "all s", "peak GiB", "albedo dB"],
        body,
        "One photograph to glTF and page in a process of its own; all counts its start. Albedo over "
        f"skin of the face at {TRUTH_ROWS} rows.",
    )
