"""Pictures of the renderer: each term on and off, and a scanned head beside Mitsuba.

Writes docs/renderer_terms.jpg and one picture a light, docs/renderer_street.jpg and so on. The scan
is Infinite, 3D Head Scan by Lee Perry-Smith, CC BY 3.0, www.triplegangers.com.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch

from benchmarks.record import record
from benchmarks.render_scene import (
    NAMES,
    MatteScene,
    head_of,
    lights_of,
    matte,
    panorama_of,
    scanned_head,
)
from learning.maps import TexturedHead, to_batch
from learning.relight import render_head, shadows_of
from learning.render.skin import ShadeOptions
from lightstage.formats.environment import LightSet
from lightstage.rig import Camera, default_rig
from processing.colour import srgb_from_linear
from sim.people.subject import Subject

DOCS = Path(__file__).parents[1] / "docs"
CREDIT = "Scan: Infinite, 3D Head Scan by Lee Perry-Smith, CC BY 3.0, www.triplegangers.com"
TEXTURE, SAMPLES, LIGHTS, SCALE = 320, 512, 64, 0.05
GAIN = 4.0
"""Of the differences that are shown."""
SOFT = ShadeOptions()


def tile(picture: np.ndarray, exposure: float, text: str) -> np.ndarray:
    """SRGB bytes with a label."""
    out = np.round(255 * srgb_from_linear(np.clip(picture * exposure, 0, 1))).astype(np.uint8)
    out = np.ascontiguousarray(cv2.resize(out, None, fx=1.5, fy=1.5)[..., ::-1])
    cv2.putText(out, text, (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (40, 40, 200), 1, cv2.LINE_AA)
    return out


def write_sheet(path: Path, rows: list[list[np.ndarray]]) -> None:
    sheet = np.concatenate([np.concatenate(row, axis=1) for row in rows])
    strip = np.full((26, sheet.shape[1], 3), 255, np.uint8)
    cv2.putText(strip, CREDIT, (8, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 0, 0), 1, cv2.LINE_AA)
    cv2.imwrite(str(path), np.concatenate([sheet, strip]), [cv2.IMWRITE_JPEG_QUALITY, 88])


def environment(person: Subject, camera: Camera, name: str) -> None:
    """One light: ours, Mitsuba's, the difference, and ours with all terms."""
    smooth, fine = matte(head_of(person, False)), head_of(person, True)
    flat = ShadeOptions(subsurface_mm=0)
    panorama = panorama_of(name)
    lights = lights_of(panorama, LIGHTS)
    # Once for nothing: what is compiled is read from disk.
    render_head(smooth, lights, camera, 0.0, options=flat)
    began = time.process_time()
    seen = shadows_of(smooth, lights)
    baked = time.process_time()
    ours, alpha = render_head(smooth, lights, camera, 0.0, options=flat, seen=seen)
    shaded = time.process_time()
    scene = MatteScene(person, panorama, camera)
    drawn = time.process_time()
    truth = scene.picture(SAMPLES)
    traced = time.process_time()
    full, _ = render_head(fine, lights, camera, 0.0, options=SOFT, seen=seen)
    inside = alpha > 0.999
    truth = truth * inside[..., None]
    exposure = 0.6 / float(np.quantile(truth[inside], 0.95))
    off, mean = np.abs(ours - truth)[inside], float(truth[inside].mean())
    row = [
        f"{100 * off.mean() / mean:.1f}",
        f"{100 * (ours[inside].mean() / mean - 1):+.1f}",
        f"{shaded - baked:.2f}",
        f"{baked - began:.1f}",
        f"{traced - drawn:.1f}",
    ]
    tiles = [
        tile(ours, exposure, f"{name}: matte, {LIGHTS} lights"),
        tile(truth, exposure, f"Mitsuba, {SAMPLES} paths"),
        tile(GAIN * np.abs(ours - truth) * inside[..., None], exposure, f"difference x {GAIN:g}"),
        tile(full, exposure, "with gloss and scattering"),
    ]
    write_sheet(DOCS / f"renderer_{name}.jpg", [tiles])
    record(
        f"Renderer: a scanned head beside Mitsuba, {name}",
        ["mean error, %", "mean light, %", "s", "s of shadow rays", "Mitsuba s"],
        [row],
        f"Matte head in direct light, {camera.width_px} x {camera.height_px} px, {TEXTURE} texels "
        f"a side, {LIGHTS} lights by median cut, against {SAMPLES} paths a pixel, whose noise is "
        "part of the error. Processor seconds of all threads.",
    )


def terms(person: Subject, camera: Camera) -> None:
    head = head_of(person, True)
    places = np.array([[900.0, 500, 900], [-1200, 200, 300], [0, 300, 1300]])
    rgb = np.array([[0.75, 0.7, 0.65], [0.3, 0.36, 0.45], [0.1, 0.1, 0.1]])
    lights = LightSet("studio", places, rgb, np.full(3, 0.05))
    seen = shadows_of(head, lights)
    bare = ShadeOptions(subsurface_mm=0)

    def drawn(
        who: TexturedHead = head,
        options: ShadeOptions = SOFT,
        mask: Any = seen,
        light: LightSet = lights,
    ) -> np.ndarray:
        return render_head(who, light, camera, 0.0, options=options, seen=mask)[0]

    bright = dataclasses.replace(lights, ambient_rgb=np.ones(3))
    smooth = to_batch(head.raster.normals(head.mesh))
    skin = dataclasses.replace(head.skin, specular_normal=smooth)
    coarse = dataclasses.replace(head, skin=skin)
    thick = dataclasses.replace(
        head,
        skin=dataclasses.replace(head.skin, translucency=torch.ones_like(head.skin.translucency)),
    )
    everything = drawn()
    without = {
        "gloss": drawn(matte(head)),
        "cast shadows": drawn(mask=None),
        "scattering": drawn(options=bare),
        "ambient light": drawn(light=dataclasses.replace(lights, ambient_rgb=np.zeros(3))),
    }
    waxen = drawn(thick, ShadeOptions(subsurface_mm=4.0))
    facets = drawn(options=ShadeOptions(mode="ggx"))
    printed = drawn(options=ShadeOptions(mode="paper"), mask=None, light=bright)
    even = drawn(coarse)

    def change(picture: np.ndarray, text: str) -> np.ndarray:
        return tile(GAIN * np.abs(picture - everything), 1.4, f"{text}: change x {GAIN:g}")

    rows = [
        [tile(picture, 1.4, f"without {name}") for name, picture in without.items()],
        [change(picture, name) for name, picture in without.items()],
        [
            tile(everything, 1.4, "all terms (physical)"),
            tile(waxen, 1.4, "translucency 1, 4 mm"),
            tile(facets, 1.4, "mode ggx"),
            tile(even, 1.4, "gloss on the mesh's normals"),
        ],
        [
            tile(printed, 1.4, "mode paper, ambient 1"),
            change(waxen, "translucency"),
            change(facets, "ggx"),
            change(even, "normals of the gloss"),
        ],
    ]
    write_sheet(DOCS / "renderer_terms.jpg", rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=("terms", *NAMES))
    chosen = parser.parse_args().only
    person = scanned_head(TEXTURE)
    camera = default_rig().scaled(SCALE).camera("cam0")
    if chosen in (None, "terms"):
        terms(person, camera)
    for name in NAMES:
        if chosen in (None, name):
            environment(person, camera, name)


if __name__ == "__main__":
    main()
