"""What does a simulated photograph cost, and how far is it from plain float64?

Run `python -m benchmarks.sim_render`: one camera's rays, shadows and shading, each beside a plain
twin; shading against number of lights, pixels and patterns; a whole session with its memory.
"""

from __future__ import annotations

import dataclasses
import resource
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from benchmarks.record import record
from lightstage.commands import quiet
from lightstage.patterns import pattern_levels, sequence_patterns
from lightstage.rig import Rig, default_rig
from sim.light.facets import SKIN_F0
from sim.light.lamps import Lamps, lamps_of
from sim.light.olat import shade
from sim.light.scene import Scene, Surface
from sim.light.transmittance import transmittance
from sim.light.world import World
from sim.people.subject import Subject
from sim.people.subjects import load_subject
from sim.scans.lps import scan_folder
from sim.session import SessionConfig, write_direct

T = TypeVar("T")
SCALE = 1080 / 6016
SESSION_MEGAPIXELS = 1.5
EVERY = 40
"""The plain twin shades every 40th pixel; its time is multiplied."""
Row = tuple[object, ...]


def main() -> None:
    name = "lps" if scan_folder() is not None else "parametric"
    subject = load_subject(name, 1)
    rig = default_rig().scaled(SCALE)
    scene = Scene(subject)
    rows: list[Row] = []
    for camera_id in ("cam0", "cam3"):
        rows += measure(scene, rig, camera_id)
    rows += against_size(scene, rig)
    rows.append(session(subject))
    record(
        "Simulated photographs",
        ("camera", "step", "seconds", "CPU seconds", "twin, seconds", "ratio", "difference"),
        rows,
        f"{name}, 720 x 1080 pixels, 168 lights. Shading: numpy float64 on every {EVERY}th pixel, "
        "time scaled up, largest difference relative to the brightest pixel. Shadow rays: Open3D, "
        "every ray cast; difference of radiance under `full` relative to the brightest pixel, and "
        "the share of pairs of pixel and light that differ. Silhouette: nine rays in edge pixels "
        "beside one, against 64 in all. The session writes linear frames to disk.",
    )


def measure(scene: Scene, rig: Rig, camera_id: str) -> list[Row]:
    """Rows of one camera's steps."""
    camera, lamps = rig.camera(camera_id), lamps_of(rig)
    lights = rig.positions_mm
    see, surface = timed(lambda: scene.surface(camera))
    scene.visible_lights(surface, lights[:2])  # compile
    cast, bits = timed(lambda: scene.visible_lights(surface, lights))
    plain, plain_bits = timed(lambda: scene.visible_lights(surface, lights, coarse_px=1))
    weights = binary(rig, lamps)
    run(surface, bits, lamps, weights[:1])  # compile
    one, full = timed(lambda: run(surface, bits, lamps, weights[:1]))
    half, _ = timed(lambda: run(surface, bits, lamps, weights[1:2]))
    seven, _ = timed(lambda: run(surface, bits, lamps, weights))
    peak = float(full.max())
    off = np.abs(run(surface, plain_bits, lamps, weights[:1]) - full).max(axis=(0, 2)) / peak
    differ = int(np.unpackbits(bits ^ plain_bits).sum()) / (len(bits) * len(lights))
    chosen = np.arange(0, len(surface.pixel), EVERY)
    slow, known = timed(lambda: twin(surface, bits, lamps, weights[0], chosen))
    slow = Cost(*(s * len(surface.pixel) / len(chosen) for s in dataclasses.astuple(slow)))
    apart = float(np.abs(known - full[0, chosen]).max()) / peak
    thin = f"{off.max():.2g} on {int((off > 0.01).sum())} pixels over 0.01; {differ:.1e} of pairs"
    return [
        line(camera_id, f"what it sees, {len(surface.pixel)} pixels", see),
        line(camera_id, "shadow rays", cast, plain, thin),
        line(camera_id, "shading, full", one, slow, f"{apart:.1e}"),
        line(camera_id, "shading, one gradient", half),
        line(camera_id, "shading, seven patterns at once", seven),
        silhouette(scene, surface),
    ]


def against_size(scene: Scene, rig: Rig) -> list[Row]:
    """Rows of shading's cost against lights, patterns and pixels."""
    rows: list[Row] = []
    surface = scene.surface(rig.camera("cam0"))
    bits = scene.visible_lights(surface, rig.positions_mm)
    for step in (8, 4, 2, 1):
        few = dataclasses.replace(rig, lights=rig.lights[::step])
        lamps = lamps_of(few)
        seen = np.unpackbits(bits, axis=1, count=len(rig.lights), bitorder="little")[:, ::step]
        packed = np.packbits(seen, axis=1, bitorder="little")
        cost, _ = timed(partial(run, surface, packed, lamps, lamps.weights[None]))
        rows.append(line("cam0", f"{len(few.lights)} lights, one pattern", cost))
    lamps = lamps_of(rig)
    for count in (1, 4, 16, 64):
        rng = np.random.default_rng(count)
        weights = rng.random((count, len(rig.lights), 1)) * lamps.weights
        part = slice(0, len(surface.pixel) // 4)
        cost, _ = timed(partial(run, surface, bits, lamps, weights, part))
        rows.append(line("cam0", f"a quarter of the pixels, {count} patterns of all lights", cost))
    for factor in (0.25, 0.5, 1.5):
        camera = rig.camera("cam0").scaled(factor)
        other = scene.surface(camera)
        found = scene.visible_lights(other, rig.positions_mm)
        cost, _ = timed(partial(run, other, found, lamps, lamps.weights[None]))
        rows.append(line("cam0", f"{len(other.pixel)} pixels, one pattern", cost))
    return rows


def silhouette(scene: Scene, surface: Surface) -> Row:
    """How much nearer nine rays are to the share of an edge pixel that the subject fills."""
    cost, (edge, fine) = timed(lambda: scene.edge_samples(surface, 3))
    _, dense = scene.edge_samples(surface, 8)
    pixels = surface.camera.width_px * surface.camera.height_px
    filled = [np.bincount(s.pixel, minlength=pixels)[edge] / n for s, n in
              ((surface, 1), (fine, 9), (dense, 64))]  # fmt: skip
    error = [float(np.sqrt(np.mean((f - filled[2]) ** 2))) for f in filled[:2]]
    note = f"rms of the share {error[1]:.3f}, one ray {error[0]:.3f}"
    return line(surface.camera.id, f"silhouette, {len(edge)} pixels of nine rays", cost, None, note)


def session(subject: Subject) -> Row:
    """A whole session of nine cameras and seven patterns to disk."""
    rig = default_rig()
    camera = rig.cameras[0]
    rig = rig.scaled((SESSION_MEGAPIXELS * 1e6 / (camera.width_px * camera.height_px)) ** 0.5)

    def work() -> None:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name) / "session"
            write_direct(World(subject, rig), folder, SessionConfig(), 1, quiet)

    cost, _ = timed(work)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    what = f"session, {len(rig.cameras)} cameras of {SESSION_MEGAPIXELS} MP, 7 patterns"
    return line("all", what, cost, None, f"largest memory of the benchmark {peak:.1f} GiB")


def binary(rig: Rig, lamps: Lamps) -> np.ndarray:
    levels = np.stack([pattern_levels(p, rig) for p in sequence_patterns("binary")])
    return np.asarray(levels[:, :, None] * lamps.weights)


def run(
    surface: Surface,
    bits: np.ndarray,
    lamps: Lamps,
    weights: np.ndarray,
    part: slice = slice(None),
) -> np.ndarray:
    diffuse, specular = shade(
        surface.position[part],
        surface.geometric[part],
        surface.normal[part],
        surface.view[part],
        surface.albedo[part],
        surface.specular[part],
        surface.roughness[part],
        bits[part],
        lamps,
        weights,
        surface.lobe.of(part),
    )
    return diffuse + specular


def twin(
    surface: Surface, bits: np.ndarray, lamps: Lamps, weights: np.ndarray, chosen: np.ndarray
) -> np.ndarray:
    """The same light of Beckmann facets by plain numpy in float64: (chosen, 3)."""
    fields = (surface.position, surface.geometric, surface.normal, surface.view, surface.albedo)
    position, geometric, normal, view, albedo = (f[chosen].astype(float) for f in fields)
    f0, m = surface.specular[chosen, None].astype(float), surface.roughness[chosen, None]
    lights = lamps.positions_mm
    seen = np.unpackbits(bits[chosen], axis=1, count=len(lights), bitorder="little")
    toward = lights[None] - position[:, None]
    distance = np.linalg.norm(toward, axis=-1)
    light = toward / distance[..., None]
    n_l = np.einsum("nk,nmk->nm", normal, light)
    lit = (seen > 0) & (n_l > 0) & (np.einsum("nk,nmk->nm", geometric, light) > 0)
    shine = np.maximum(-np.einsum("mk,nmk->nm", lamps.axes, light), 0) ** lamps.exponent
    falloff = np.where(lit, shine * (np.linalg.norm(lights, axis=1) / distance) ** 2, 0.0)
    half = light + view[:, None]
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    n_h = np.einsum("nk,nmk->nm", normal, half)
    n_v = np.maximum(np.einsum("nk,nk->n", normal, view), 1e-4)[:, None]
    cosine = np.einsum("nmk,nmk->nm", light, half)
    inside = np.sqrt(1 - (1 - cosine**2) / 1.4**2)
    crossed = (cosine - 1.4 * inside) / (cosine + 1.4 * inside)
    parallel = (1.4 * cosine - inside) / (1.4 * cosine + inside)
    fresnel = (crossed**2 + parallel**2) / 2 * f0 / SKIN_F0
    spread = np.where(n_h > 0, np.exp((1 - 1 / n_h**2) / m**2) / (m**2 * n_h**4), 0.0)
    masking = 1 / (1 + smith(np.where(lit, n_l, 1.0), m) + smith(n_v, m))
    lobe = spread * masking * fresnel / (4 * n_v) * falloff
    out, mean = transmittance(n_v, m)
    body = n_l * falloff * transmittance(n_l, m)[0] * out / mean
    return albedo * (body @ weights) + lobe @ weights


def smith(cosine: np.ndarray, m: np.ndarray) -> np.ndarray:
    a = cosine / (m * np.sqrt(np.maximum(1 - cosine**2, 1e-18)))
    return np.where(a < 1.6, (1 - 1.259 * a + 0.396 * a**2) / (3.535 * a + 2.181 * a**2), 0.0)


@dataclasses.dataclass(frozen=True)
class Cost:
    """Seconds by the clock, and of all cores together."""

    seconds: float
    cpu_seconds: float


def timed(work: Callable[[], T]) -> tuple[Cost, T]:
    begun, spent = time.perf_counter(), time.process_time()
    result = work()
    return Cost(time.perf_counter() - begun, time.process_time() - spent), result


def line(camera: str, step: str, cost: Cost, plain: Cost | None = None, note: str = "") -> Row:
    """A row of the table."""
    twin_seconds = "" if plain is None else f"{plain.seconds:.1f}"
    ratio = "" if plain is None else f"{plain.seconds / cost.seconds:.1f}"
    seconds = (f"{cost.seconds:.2f}", f"{cost.cpu_seconds:.2f}")
    return (camera, step, *seconds, twin_seconds, ratio, note)


if __name__ == "__main__":
    main()
