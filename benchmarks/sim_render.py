"""What does a simulated photograph cost, and how far is it from plain float64?"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from benchmarks.record import record
from lightstage.patterns import pattern_levels, sequence_patterns
from lightstage.rig import default_rig
from sim.lamps import light_weights
from sim.render import shade
from sim.scan import scan_folder
from sim.scene import Scene, Surface
from sim.subjects import load_subject

T = TypeVar("T")
SCALE = 1080 / 6016
CAMERAS = ("cam0", "cam3")
EVERY = 40
"""The plain twin shades every 40th pixel; its time is multiplied."""


def main() -> None:
    name = "lps" if scan_folder() is not None else "parametric"
    rig = default_rig().scaled(SCALE)
    scene = Scene(load_subject(name, 1))
    levels = np.stack([pattern_levels(p, rig) for p in sequence_patterns("binary")])
    weights = levels[:, :, None] * light_weights(rig)
    rows: list[tuple[object, ...]] = []
    for camera_id in CAMERAS:
        rows += measure(scene, rig.camera(camera_id).id, weights)
    record(
        "Simulated photographs",
        ("camera", "step", "seconds", "plain twin, seconds", "ratio", "largest difference"),
        rows,
        f"{name}, 720 x 1080 pixels, 168 lights. Shading: numpy float64 on every {EVERY}th pixel, "
        "time scaled up, difference relative to the brightest pixel. Shadow rays: Open3D, every "
        "ray cast; difference of radiance under `full` relative to the brightest pixel, and the "
        "share of pairs of pixel and light that differ.",
    )


def measure(scene: Scene, camera_id: str, weights: np.ndarray) -> list[tuple[object, ...]]:
    """Rows of one camera."""
    rig = default_rig().scaled(SCALE)
    lights = rig.positions_mm
    seconds_see, surface = timed(lambda: scene.surface(rig.camera(camera_id)))
    scene.visible_lights(surface, lights[:2])  # compile
    seconds_fast, bits = timed(lambda: scene.visible_lights(surface, lights))
    seconds_all, plain_bits = timed(lambda: scene.visible_lights(surface, lights, coarse_px=1))
    run(surface, bits, lights, weights[:1])  # compile
    seconds_full, full = timed(lambda: run(surface, bits, lights, weights[:1]))
    seconds_half, _ = timed(lambda: run(surface, bits, lights, weights[1:2]))
    seconds_seven, _ = timed(lambda: run(surface, bits, lights, weights))
    peak = float(full.max())
    exact = run(surface, plain_bits, lights, weights[:1])
    off = np.abs(exact - full).max(axis=(0, 2)) / peak
    differ = int(np.unpackbits(bits ^ plain_bits).sum()) / (len(bits) * len(lights))
    chosen = np.arange(0, len(surface.pixel), EVERY)
    seconds_twin, known = timed(lambda: twin(surface, bits, lights, weights[:1], chosen))
    seconds_twin *= len(surface.pixel) / len(chosen)
    apart = float(np.abs(known - full[:, chosen]).max()) / peak
    pixels = len(surface.pixel)
    return [
        (camera_id, f"what it sees, {pixels} pixels", f"{seconds_see:.2f}", "", "", ""),
        (
            camera_id,
            "shadow rays",
            f"{seconds_fast:.2f}",
            f"{seconds_all:.2f}",
            f"{seconds_all / seconds_fast:.1f}",
            f"{off.max():.2g} on {int((off > 0.01).sum())} pixels over 0.01; {differ:.1e} of pairs",
        ),
        (
            camera_id,
            "shading, full",
            f"{seconds_full:.2f}",
            f"{seconds_twin:.1f}",
            f"{seconds_twin / seconds_full:.0f}",
            f"{apart:.1e}",
        ),
        (camera_id, "shading, one gradient", f"{seconds_half:.2f}", "", "", ""),
        (camera_id, "shading, seven patterns at once", f"{seconds_seven:.2f}", "", "", ""),
    ]


def run(surface: Surface, bits: np.ndarray, lights: np.ndarray, weights: np.ndarray) -> np.ndarray:
    diffuse, specular = shade(
        surface.position,
        surface.geometric,
        surface.normal,
        surface.view,
        surface.albedo,
        surface.specular,
        surface.roughness,
        bits,
        lights,
        weights,
    )
    return diffuse + specular


def twin(
    surface: Surface,
    bits: np.ndarray,
    lights: np.ndarray,
    weights: np.ndarray,
    chosen: np.ndarray,
) -> np.ndarray:
    """The same light by plain numpy in float64: (s, chosen, 3)."""
    fields = (surface.position, surface.geometric, surface.normal, surface.view, surface.albedo)
    position, geometric, normal, view, albedo = (f[chosen].astype(float) for f in fields)
    f0, m = surface.specular[chosen, None].astype(float), surface.roughness[chosen, None]
    seen = np.unpackbits(bits[chosen], axis=1, count=len(lights), bitorder="little")
    toward = lights[None] - position[:, None]
    distance = np.linalg.norm(toward, axis=-1)
    light = toward / distance[..., None]
    n_l = np.einsum("nk,nmk->nm", normal, light)
    lit = (seen > 0) & (n_l > 0) & (np.einsum("nk,nmk->nm", geometric, light) > 0)
    falloff = np.where(lit, (np.linalg.norm(lights, axis=1) / distance) ** 2, 0.0)
    half = light + view[:, None]
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    n_h = np.einsum("nk,nmk->nm", normal, half)
    n_v = np.maximum(np.einsum("nk,nk->n", normal, view), 1e-4)[:, None]
    cosine = np.einsum("nmk,nmk->nm", light, half)
    index = (1 + np.sqrt(f0)) / (1 - np.sqrt(f0))
    inside = np.sqrt(1 - (1 - cosine**2) / index**2)
    crossed = (cosine - index * inside) / (cosine + index * inside)
    parallel = (index * cosine - inside) / (index * cosine + inside)
    fresnel = (crossed**2 + parallel**2) / 2
    spread = np.where(n_h > 0, np.exp((1 - 1 / n_h**2) / m**2) / (m**2 * n_h**4), 0.0)
    masking = 1 / (1 + smith(np.where(lit, n_l, 1.0), m) + smith(n_v, m))
    lobe = spread * masking * fresnel / (4 * n_v) * falloff
    diffuse = np.einsum("smc,nm,nc->snc", weights, n_l * falloff, albedo)
    return diffuse + np.einsum("smc,nm->snc", weights, lobe)


def smith(cosine: np.ndarray, m: np.ndarray) -> np.ndarray:
    a = cosine / (m * np.sqrt(np.maximum(1 - cosine**2, 1e-300)))
    return np.where(a < 1.6, (1 - 1.259 * a + 0.396 * a**2) / (3.535 * a + 2.181 * a**2), 0.0)


def timed(work: Callable[[], T]) -> tuple[float, T]:
    begun = time.perf_counter()
    result = work()
    return time.perf_counter() - begun, result


if __name__ == "__main__":
    main()
