"""The number of lights that an environment needs, and their run time."""

from __future__ import annotations

import dataclasses
import time

import numpy as np

from benchmarks.record import record
from lightstage.rig import default_rig
from sim.light.environments import Panorama, directions, panorama_lights, solid_angles
from sim.light.relight import SKIES, relit
from sim.light.scene import Scene
from sim.light.sky import mitsuba_sky
from sim.light.street import street
from sim.people.subjects import load_subject
from sim.scans.lps import scan_folder

WIDTH_PX = 160
COUNTS = (16, 64, 256, 1024)
KNOWN = 4096
NORMALS = 400


def main() -> None:
    name = "lps" if scan_folder() is not None else "parametric"
    camera = default_rig().camera("cam0")
    camera = camera.scaled(WIDTH_PX / camera.width_px)
    scene = Scene(load_subject(name, 1))
    skin = scene.surface(camera)
    face = skin.pixel[skin.skin]
    rows: list[tuple[object, ...]] = []
    pictures = [street(0)]
    pictures += [
        mitsuba_sky(dataclasses.replace(SKIES[sky], rows=256), sky) for sky in ("noon", "sunset")
    ]
    for picture in pictures:
        given = picture.radiance * solid_angles(256)[:, None, None] / np.pi
        truth = falling(picture)
        known = relit(scene, camera, panorama_lights(picture, KNOWN), samples=1)
        known_face = known.reshape(-1, 3)[face]
        level = known_face.mean()
        for count in COUNTS:
            begun = time.perf_counter()
            lights = panorama_lights(picture, count)
            seconds_cut = time.perf_counter() - begun
            begun = time.perf_counter()
            found = relit(scene, camera, lights, samples=1).reshape(-1, 3)[face]
            seconds = time.perf_counter() - begun
            kept = np.abs(lights.rgb.sum(axis=0) / given.sum(axis=(0, 1)) - 1).max()
            toward = lights.position_mm / np.linalg.norm(lights.position_mm, axis=1, keepdims=True)
            falls = np.maximum(ball() @ toward.T, 0) @ lights.rgb
            off = np.abs(found - known_face)
            rows.append(
                (
                    picture.name,
                    len(lights.rgb),
                    f"{kept:.0e}",
                    f"{100 * np.abs(falls - truth).mean() / truth.mean():.2f}",
                    f"{100 * off.mean() / level:.2f}",
                    f"{100 * np.quantile(off, 0.99) / level:.1f}",
                    f"{seconds_cut:.2f}",
                    f"{seconds:.1f}",
                )
            )
    record(
        "Environments",
        (
            "picture",
            "lights",
            "light lost or won",
            "unshadowed ball, mean error, %",
            "face, mean error, %",
            "face, 99 % of pixels below, %",
            "cutting, s",
            "rendering, s",
        ),
        rows,
        f"{name}, {camera.width_px} x {camera.height_px} pixels, pictures of 512 x 256 texels. The "
        f"ball's light against the sum over all texels; the face's, with shadows and highlights, "
        f"against {KNOWN} lights; shares of the mean.",
    )


def ball() -> np.ndarray:
    """(n, 3) normals all around."""
    z = 1 - 2 * (np.arange(NORMALS) + 0.5) / NORMALS
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(NORMALS)
    flat = np.sqrt(1 - z * z)
    return np.stack([flat * np.cos(turn), z, flat * np.sin(turn)], axis=1)


def falling(picture: Panorama) -> np.ndarray:
    """(n, 3) what white diffusers of these normals read, texel by texel."""
    toward = directions(256).reshape(-1, 3)
    given = (picture.radiance * solid_angles(256)[:, None, None] / np.pi).reshape(-1, 3)
    return np.stack([np.maximum(toward @ n, 0) @ given for n in ball()])


if __name__ == "__main__":
    main()
