"""Reflectance of one simulated view: published formula, far-field pass, pass with the mesh.

Run `python -m benchmarks.reflectance`. The simulator renders the views without sensor noise
(parametric person), pixel noise of .001 is added, and each method solves the frontal view; `refine`
gets the true mesh and three views, and its seconds hold the mesh's rays and all three.
"""

from __future__ import annotations

import dataclasses
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.record import record
from lightstage.formats.mesh import read_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import Session, load_session
from lightstage.rig import default_rig, save_rig
from processing.decode import DecodeConfig, decode
from processing.frames import Frames, read_foreground, read_frames, write_frames
from processing.lights import PatternLights, pattern_lights
from processing.methods.colour import separate_pixels
from processing.methods.config import SeparateConfig
from processing.normals import ratio_normals
from processing.pixels import PixelMaps
from processing.readings import px_per_mm
from processing.refine import RefineConfig, read_view, solve_albedo, solve_pixels
from processing.specular import add_view, no_sums, solve_gloss
from processing.surface import lit_surface

NOISE = 0.001
CAMERAS = ("cam0", "cam1", "cam2")


@dataclasses.dataclass(frozen=True)
class Photographs:
    """One view's pixels: (n, P, 3) readings, (n,) valid, (h, w) mask, (n, 3) toward the camera."""

    rgb: np.ndarray
    valid: np.ndarray
    mask: np.ndarray
    views: np.ndarray


def published(photos: Photographs, patterns: tuple[str, ...]) -> PixelMaps:
    """Kampouris 2018 as printed: ratio normals of the mean channel, saturation's delta per axis.

    The diffuse albedo is that of `full`, less the specular part.

    Source: [Kampouris2018].
    """
    index = {name: k for k, name in enumerate(patterns)}
    normal = ratio_normals(photos.rgb.mean(axis=2), patterns)
    deltas = []
    for axis in "xyz":
        pair = np.stack([photos.rgb[:, index[axis + sign]] for sign in "+-"])
        brighter = pair.mean(axis=2).argmax(axis=0)
        g, c = (
            pair[brighter, np.arange(pair.shape[1])],
            pair[1 - brighter, np.arange(pair.shape[1])],
        )
        chroma_g, chroma_c = (x.max(axis=1) - x.min(axis=1) for x in (g, c))
        saturation = chroma_c / np.maximum(c.max(axis=1), 1e-6)
        deltas.append(g.max(axis=1) - chroma_g / np.maximum(saturation, 1e-3))
    specular = np.clip(np.median(deltas, axis=0), 0, 0.2)
    albedo = np.maximum(photos.rgb[:, index["full"]] - specular[:, None], 0)
    one = np.ones(len(normal))
    return PixelMaps(normal, normal, albedo, specular, one, one)


def with_mesh(
    session: Session, out: Path, lights: PatternLights, truth: ProcessedFolder
) -> tuple[PixelMaps, np.ndarray]:
    """The frontal view's maps by `refine` with the true mesh, and their (h, w) mask."""
    config = RefineConfig()
    surface = lit_surface(
        read_ply(truth.base_mesh),
        lights,
        offset_mm=config.shadow_offset_mm,
        smoothing_mm=config.smoothing_mm,
        directions=config.occlusion_directions,
        most_faces=config.most_faces,
    )
    sums = no_sums(config.roughness, len(surface.vertices))
    solved = []
    for camera in CAMERAS:
        view = read_view(session, out, camera, surface)
        found = solve_pixels(view, lights, config)
        few = np.flatnonzero(found.confidence > 0)[::4]
        add_view(
            sums,
            lights,
            (view.rgb[few] / lights.colour).mean(axis=2),
            view.sight.points_mm[few],
            found.normal[few],
            view.sight.views[few],
            view.sight.shadows.of(few),
            found.confidence[few],
        )
        solved.append((view, found))
    gloss = solve_gloss(
        sums,
        surface.average,
        rounds_roughness=surface.rounds(config.roughness_pool_mm),
        rounds_specular=surface.rounds(config.specular_pool_mm),
        prior_specular=config.specular_prior,
        prior_pixels=config.gloss_prior_pixels,
    )
    view, found = solved[0]
    return solve_albedo(view, found, lights, gloss, config), view.sight.mask


def far(photos: Photographs, lights: PatternLights, px_mm: float) -> PixelMaps:
    """The stage `separate` on one view."""
    return separate_pixels(
        photos.rgb, photos.valid, photos.views, photos.mask, lights, px_mm, SeparateConfig()
    )


def timed(
    call: Callable[[], tuple[PixelMaps, np.ndarray]],
) -> tuple[PixelMaps, np.ndarray, float]:
    """Result and seconds of a second call; the first one compiles."""
    call()
    start = time.perf_counter()
    maps, mask = call()
    return maps, mask, time.perf_counter() - start


def errors(maps: PixelMaps, mask: np.ndarray, truth: ProcessedFolder) -> tuple[float, ...]:
    """Mean and median normal error in deg, albedo RMSE, specular RMSE as share of a constant's."""
    scored = truth.read_mask(CAMERAS[0])[mask] & (maps.confidence > 0)
    normal, albedo, specular = (
        truth.read_view(CAMERAS[0], name)[mask][scored]
        for name in ("diffuse_normal", "diffuse_albedo", "specular_albedo")
    )
    cosine = np.einsum("nk,nk->n", maps.diffuse_normal[scored], normal)
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    rmse = np.sqrt(((maps.albedo[scored] - albedo) ** 2).mean())
    gloss = np.sqrt(((maps.specular[scored] - specular) ** 2).mean()) / specular.std()
    return float(angle.mean()), float(np.median(angle)), float(rmse), float(gloss)


def simulate(folder: Path) -> Path:
    """A session of linear frames by the simulator's own command; its truth lies beside it."""
    rig = default_rig()
    save_rig(dataclasses.replace(rig, cameras=rig.cameras[: len(CAMERAS)]), folder / "rig.json")
    command = [sys.executable, "-m", "sim", "session", "--subject", "parametric", "--seed", "5"]
    options = ["--direct", "--scale", "0.1", "--rig", str(folder / "rig.json")]
    subprocess.run([*command, *options, "--out", str(folder / "session")], check=True)
    return folder / "session"


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        root = simulate(Path(name))
        truth = ProcessedFolder(root.with_name("session.truth"))
        session, out = load_session(root), Path(name) / "out"
        decode(session, out, DecodeConfig())
        rng = np.random.default_rng(0)
        for camera in CAMERAS:
            clean = read_frames(out, camera)
            noise = rng.normal(0, NOISE, (len(clean.patterns), *clean.shape, 3)).astype(np.float32)
            noisy = Frames.of(clean.patterns, clean.images + noise, clean.valid)
            write_frames(out, camera, noisy)
        frames, mask = read_frames(out, CAMERAS[0]), read_foreground(out, CAMERAS[0])
        camera0 = session.rig.camera(CAMERAS[0])
        rgb = frames.pixels(mask)
        photos = Photographs(rgb, frames.valid[mask], mask, -camera0.pixel_rays()[1][mask])
        lights = pattern_lights(session, frames.patterns)
        methods: dict[str, Callable[[], tuple[PixelMaps, np.ndarray]]] = {
            "published formula": lambda: (published(photos, frames.patterns), mask),
            "far field (separate)": lambda: (far(photos, lights, px_per_mm(camera0)), mask),
            "true mesh, 3 views (refine)": lambda: with_mesh(session, out, lights, truth),
        }
        rows, first = [], None
        for method, call in methods.items():
            maps, where, seconds = timed(call)
            found = (*errors(maps, where, truth), seconds)
            first = first or found
            ratios = " ".join(f"{x / y:.2f}" for x, y in zip(found, first, strict=True))
            rows.append([method, *(f"{x:.3f}" for x in found), ratios])
    record(
        "Reflectance of one view",
        ["method", "normal mean deg", "median deg", "albedo RMSE", "specular, share of constant",
         "seconds", "ratios to the first"],
        rows,
        f"Parametric person, {mask.shape[1]} x {mask.shape[0]}, cast shadows, noise {NOISE}; "
        "face skin of the frontal view.",
    )  # fmt: skip


if __name__ == "__main__":
    main()
