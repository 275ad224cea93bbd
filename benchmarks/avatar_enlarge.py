"""Whether super-resolution of a photograph brings its texture nearer to the true one.

`python -m benchmarks.avatar_enlarge` photographs heads with fewer and fewer pixels, brings each
photograph into texels by the true shape (as it is, enlarged by the shipped weights, enlarged by
bicubic interpolation), and compares the texture with the true one under the same light.
"""

from __future__ import annotations

import argparse
import time

import cv2
import numpy as np

from benchmarks.avatar_photos import Case, face_of, head_of, light_for, networks
from benchmarks.networks_people import chosen
from benchmarks.networks_scores import correlation, db, detail, squared
from benchmarks.photo import scored
from benchmarks.photo_studio import Sitter
from benchmarks.record import record
from learning.photo.enlarge import texels_a_pixel
from learning.photo.unwrap import unwrap
from learning.render.uv import rasterise
from learning.upscale.infer import upscale
from lightstage.formats.template import default_template_path, load_template
from lightstage.rig import Camera

ROWS, LIGHT = 768, "front"
COARSER = (2, 4, 8)
"""Than photographs of 768 x 1024 px."""


def main() -> None:
    """Measure, print, record."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--people", default="simulated,scan", help="kinds of heads, with commas")
    asked = parser.parse_args()
    network = networks()[2]
    vertices = scored(load_template(default_template_path()))
    body = []
    for who in chosen(asked.people.split(","), 1, False):
        case = Case(who, LIGHT, 0.0, ROWS)
        head = head_of(who, ROWS)
        lit = head.image(head.lit.under(light_for(case))).astype(np.float32)
        raster = rasterise(head.mesh, *head.shown.shape)
        for coarser in COARSER:
            sitter = Sitter(head, 0.0, 1 / coarser)
            camera = sitter.camera
            _, rgb = sitter.shot(light_for(case))
            began = time.process_time()
            large = upscale(network, rgb)
            seconds = time.process_time() - began
            times = network.config.times
            size = (times * rgb.shape[1], times * rgb.shape[0])
            pictures: dict[str, tuple[np.ndarray, Camera]] = {
                "as it is": (rgb, camera),
                "super-resolution": (large, camera.scaled(times)),
                "bicubic": (
                    np.maximum(cv2.resize(rgb, size, interpolation=cv2.INTER_CUBIC), 0),
                    camera.scaled(times),
                ),
            }
            found = {n: unwrap(p, head.mesh, raster, c) for n, (p, c) in pictures.items()}
            seen = face_of(head)
            for each in found.values():
                seen = seen & each.seen
            row = [
                who.kind,
                f"{rgb.shape[1]} x {rgb.shape[0]}",
                f"{texels_a_pixel(head.mesh, raster, vertices, camera):.1f}",
            ]
            for each in found.values():
                row.append(
                    f"{db([squared(each.texture[seen], lit[seen])]):.1f} "
                    f"({correlation([detail(each.texture, lit, seen)]):.3f})"
                )
            body.append([*row, f"{seconds:.1f}"])
            print(body[-1], flush=True)
    record(
        "Super-resolution of a photograph, in texels",
        ["head", "photograph px", "texels a pixel", *found, "processor s"],
        body,
        f"PSNR in dB of the lit texture of {ROWS} rows over skin of the face, by the true shape; "
        "in brackets the correlation of detail within patches. Head of the scan: Lee Perry-Smith, "
        "CC BY 3.0.",
    )


if __name__ == "__main__":
    main()
