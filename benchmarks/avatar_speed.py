"""Seconds, memory and error of `avatar` by stage and by the texture's size, and of a large export.

Seconds are of the processor, all cores together, and of the wall: where others use the machine too,
only the first can be compared.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.avatar_photos import Case, face_of, head_of, shot, template
from benchmarks.networks_people import chosen
from benchmarks.networks_scores import db, squared
from benchmarks.record import record
from learning.render.uv import rasterise
from lightstage.formats.exr import read_exr
from lightstage.formats.mesh import write_obj
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.template import default_template_path
from processing.colour import srgb_from_linear

LARGEST_ROWS = 6144
SIZES = (384, 768, 1536, 3072, LARGEST_ROWS)
TRUTH_ROWS = 384
LIGHT = "hard-oblique"
STAGES = ("fit", "detail", "export", "page")
AVATAR = """
from learning.avatar import avatar_command
from learning.photo.command import FitRequest

photo, template, out, rows = sys.argv[1:]
request = FitRequest((Path(photo),), Path(template), Path(out), rows=int(rows))
avatar_command(request, "export", "gltf,page", bar)
"""
EXPORT = """
from learning.export.command import export_command

maps, out = map(Path, sys.argv[1:])
with bar("avatar export") as progress:
    export_command(maps, None, "gltf,obj,maps", out, None, None, progress)
"""
TIMED = """
import json, resource, sys, time
from contextlib import contextmanager
from pathlib import Path

taken = {}

@contextmanager
def bar(label):
    began, used = time.perf_counter(), time.process_time()
    yield lambda done, total: None
    used = time.process_time() - used
    taken[label.removeprefix("avatar ")] = [time.perf_counter() - began, used]
"""
TOLD = """
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
print(json.dumps({"taken": taken, "wall_s": time.perf_counter(), "peak_gib": peak}))
"""


def measured(code: str, words: list[str]) -> dict[str, Any]:
    """Seconds of the wall and of the processor by stage, and the largest memory, of a process."""
    line = [sys.executable, "-c", TIMED + code + TOLD, *words]
    done = subprocess.run(line, check=True, capture_output=True, text=True)
    facts: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return facts


def measure_speed(title: str, sizes: tuple[int, ...]) -> None:
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
        for rows in sizes:
            out = Path(folder) / str(rows)
            facts = measured(
                AVATAR, [str(photo), str(default_template_path()), str(out), str(rows)]
            )
            albedo = read_exr(out / "fit" / "atlas" / "diffuse_albedo.exr")
            size = (TRUTH_ROWS * 2 // 3, TRUTH_ROWS)
            small = cv2.resize(albedo.astype(np.float32), size, interpolation=cv2.INTER_AREA)
            seconds = [facts["taken"].get(stage, [0, 0]) for stage in STAGES]
            body.append(
                [
                    str(rows),
                    *(f"{used:.1f} ({wall:.0f})" for wall, used in seconds),
                    "{1:.0f} ({0:.0f})".format(*np.sum(seconds, axis=0)),
                    f"{facts['peak_gib']:.1f}",
                    f"{db([squared(small[face], true[face])]):.1f}",
                ]
            )
            print(body[-1], flush=True)
    record(
        f"{title}: seconds and memory by stage",
        ["rows", *(f"{stage} s" for stage in STAGES), "all s", "peak GiB", "albedo dB"],
        body,
        "One photograph of 768 x 1024 px, its focal length not given, to glTF and page, in a "
        "process of its own. Seconds of the processor, in brackets of the wall while others used "
        f"the machine. Albedo over skin of the face at {TRUTH_ROWS} rows.",
    )


def measure_export(title: str) -> None:
    """A head of `LARGEST_ROWS` as glTF, OBJ and maps."""
    with tempfile.TemporaryDirectory() as place:
        folder = ProcessedFolder(Path(place) / "head")
        write_head(folder, LARGEST_ROWS)
        out = Path(place) / "out"
        facts = measured(EXPORT, [str(folder.root), str(out)])
        size = sum(path.stat().st_size for path in out.rglob("*") if path.is_file())
    wall, used = facts["taken"]["export"]
    record(
        f"{title}: export of the largest atlas",
        ["rows", "processor s", "wall s", "peak GiB", "GB written"],
        [
            [
                LARGEST_ROWS,
                f"{used:.0f}",
                f"{wall:.0f}",
                f"{facts['peak_gib']:.1f}",
                f"{size / 1e9:.2f}",
            ]
        ],
        "glTF, OBJ and maps of our template with noise in all maps, which no encoder makes small. "
        "The aim is 60 s on two cores and 4 GiB.",
    )


def write_head(folder: ProcessedFolder, rows: int) -> None:
    """Maps of noise on the template."""
    columns = rows * 2 // 3
    mesh, rng = template().mesh, np.random.default_rng(0)
    normal = rasterise(mesh, rows, columns).normals(mesh).astype(np.float32)
    folder.write_atlas("diffuse_normal", normal)
    noise = rng.standard_normal((rows, columns), np.float32)[..., None]
    folder.write_atlas("specular_normal", normal + 0.05 * noise * (normal != 0))
    folder.write_atlas("diffuse_albedo", 0.4 + 0.02 * np.repeat(noise, 3, axis=2).clip(-4, 4))
    folder.write_atlas("specular_albedo", 0.03 + 0.002 * noise[..., 0].clip(-4, 4))
    folder.write_atlas("roughness", 0.3 + 0.02 * noise[..., 0].clip(-4, 4))
    write_obj(mesh, folder.registered_mesh)
