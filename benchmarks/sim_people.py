"""Run time of a made-up person, and errors of its colour and its normals."""

from __future__ import annotations

import multiprocessing
import resource
import time

import numpy as np
from scipy.optimize import least_squares

from benchmarks.record import record
from lightstage.formats.mesh import vertex_normals
from sim.camera.chart import CHART_SRGB
from sim.head.grid import COLUMNS, ROWS
from sim.head.maps import at_grid, surface_normals, to_tile
from sim.head.mesh import neutral_mesh
from sim.head.modes import EXPRESSIONS
from sim.people.person import person_expressions, person_skin
from sim.people.traits import Traits
from sim.skin.normals import bend_normals
from sim.skin.paint import make_skin, random_complexion
from sim.skin.parts import face_from
from sim.skin.pigments import PigmentConfig, lab, paint_pigments, skin_rgb, tone_angle_deg

SIZES = (1536, 3072, 6144)
WHO = Traits("male", 60.0, 2)
SEED = 3
HEADER = ("what", "size", "seconds", "peak memory, GiB", "figure")


def main() -> None:
    rows: list[tuple[object, ...]] = []
    for size in SIZES:
        # A process of its own, so that peak memory is this size's.
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            rows += pool.apply(cost, (size,))
    rows += colour_errors()
    rows += normal_errors()
    record(
        "People",
        HEADER,
        rows,
        "One person. An expression is its creases and normals; the skin is painted once. Colour: "
        "CIE 1976 difference of the chart's two skin patches from the nearest plausible (C_m, C_h, "
        "B_m), with the published formulas alone and as corrected. Normals: from the height map "
        "against those of a mesh displaced by it, one vertex a texel, on a sphere of 90 mm.",
    )


def cost(size: int) -> list[tuple[object, ...]]:
    """Seconds and memory of one person with all expressions at one size."""
    person_skin(SEED, WHO, 96)
    begun = time.perf_counter()
    skin = person_skin(SEED, WHO, size)
    painted = time.perf_counter() - begun
    head = neutral_mesh()
    surface_normals(head, skin.height_mm("smile")[:96, :64])
    begun = time.perf_counter()
    surface_normals(head, skin.height_mm("smile"))
    expressed = time.perf_counter() - begun
    del skin
    begun = time.perf_counter()
    for subject in person_expressions("p", SEED, ["neutral"], size, WHO):
        assert np.isfinite(subject.normal).all()
    whole = time.perf_counter() - begun
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    texels = size * (size * 2 // 3)
    count = 1 + len(EXPRESSIONS)
    label = f"{size} x {size * 2 // 3}"
    return [
        ("skin", label, f"{painted:.1f}", "", f"{texels / painted / 1e6:.2f} million texels/s"),
        ("one more expression", label, f"{expressed:.2f}", "", ""),
        (
            "one person, neutral",
            label,
            f"{whole:.1f}",
            f"{peak:.2f}",
            f"{(painted + count * expressed) / count:.1f} s each of {count} expressions",
        ),
    ]


def colour_errors() -> list[tuple[object, ...]]:
    """Distance to the chart's patches, the table's error, the range of tones."""
    rows: list[tuple[object, ...]] = []
    for name, patch in (("dark skin", 0), ("light skin", 1)):
        target = ((CHART_SRGB[patch] / 255 + 0.055) / 1.055) ** 2.4
        found, distance = nearest(target, PigmentConfig())
        _, plain = nearest(target, PigmentConfig(backscatter=1e-4, dermis_base=1.0))
        pigments = "C_m {:.3f}, C_h {:.3f}, B_m {:.2f}".format(*found)
        figure = f"{distance:.2f} ({pigments}); formulas alone {plain:.2f}"
        rows.append((f"chart, {name}", "", "", "", figure))
    rng = np.random.default_rng(0)
    melanin = np.exp(rng.uniform(np.log(0.001), np.log(0.6), (1024, 1024))).astype(np.float32)
    blood = np.exp(rng.uniform(np.log(0.001), np.log(0.4), (1024, 1024))).astype(np.float32)
    paint_pigments(melanin[:8, :8], blood[:8, :8], 0.6)
    begun = time.perf_counter()
    table = paint_pigments(melanin, blood, 0.6)
    fast = time.perf_counter() - begun
    begun = time.perf_counter()
    exact = skin_rgb(melanin[:128], blood[:128], 0.6)
    slow = (time.perf_counter() - begun) * 8
    error = float(np.abs(table[:128] / exact - 1).max())
    rows.append(
        (
            "colour by table",
            "1024 x 1024",
            f"{fast:.3f}",
            "",
            f"34 wavelengths each texel {slow:.1f} s, ratio {slow / fast:.0f}; error {error:.1e}",
        )
    )
    tones = []
    for tone in (1, 2, 3, 4, 5, 6):
        people = [random_complexion(rng, Traits("male", 30.0, tone)) for _ in range(200)]
        colours = np.array([skin_rgb(c.melanin, c.blood, c.eumelanin) for c in people])
        tones.append(tone_angle_deg(colours))
    spread = ", ".join(f"{np.median(t):.0f}" for t in tones)
    both = np.concatenate(tones)
    figure = f"medians {spread}; all {both.min():.0f} to {both.max():.0f} degrees"
    rows.append(("typology angle of tones 1 to 6", "", "", "", figure))
    return rows


def nearest(target: np.ndarray, config: PigmentConfig) -> tuple[np.ndarray, float]:
    """Pigments of the nearest colour and its distance."""

    def off(p: np.ndarray) -> np.ndarray:
        return lab(skin_rgb(float(np.exp(p[0])), float(np.exp(p[1])), p[2], config)) - lab(target)

    bounds = ([np.log(0.005), np.log(0.003), 0.05], [np.log(0.4), np.log(0.1), 0.95])
    starts = ([-4, -4, 0.5], [-2, -3, 0.6], [-3, -4.5, 0.3])
    best = min((least_squares(off, s, bounds=bounds) for s in starts), key=lambda r: r.cost)
    found = np.array([*np.exp(best.x[:2]), best.x[2]])
    return found, float(np.linalg.norm(best.fun))


def normal_errors() -> list[tuple[object, ...]]:
    """Normals of the relief against a displaced mesh, by texel size; and the specular range."""
    rows: list[tuple[object, ...]] = []
    for size, texel in ((3072, 0.12), (6144, 0.06), (12288, 0.03)):
        found, displaced, smooth = close_up(size, texel)
        apart, tilt = angles_deg(found, displaced), angles_deg(displaced, smooth)
        figure = (
            f"{np.median(apart):.2f} median, {np.percentile(apart, 95):.2f} at 95 % degrees; "
            f"the relief tilts by {np.median(tilt):.1f}, {np.percentile(tilt, 95):.1f}"
        )
        rows.append((f"normals, texels of {texel} mm", "240 x 240", "", "", figure))
    skin = person_skin(SEED, WHO, 1536)
    place = to_tile(neutral_mesh().vertices, 1536, 1024)
    face = skin.skin & (place[..., 2] > 20) & (place[..., 1] > -115)
    low, high = np.percentile(skin.specular_albedo[face], (5, 95))
    figure = f"{low:.4f} to {high:.4f}, ratio {high / low:.2f}"
    rows.append(("specular albedo, 5 % to 95 % of the face", "1536 x 1024", "", "", figure))
    return rows


def close_up(rows: int, texel_mm: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normals by the height, of the displaced mesh, and of the sphere below: (k, k, 3) each."""
    side, columns = 240, rows * 2 // 3
    u = (np.arange(side) + round(0.62 * columns)) / columns
    v = 1 - (np.arange(side) + round(0.45 * rows)) / rows
    uv = np.stack(np.meshgrid(u, v), axis=-1).astype(np.float32)
    places = at_grid(neutral_mesh().vertices, (1 - uv[..., 1]) * ROWS, uv[..., 0] * COLUMNS)
    face = face_from(places, uv, np.ones((side, side), bool), SEED)
    rng = np.random.default_rng(SEED)
    height = make_skin(random_complexion(rng, WHO), face, rng).height_mm("smile").astype(float)
    a, b = np.meshgrid(np.arange(side) - side / 2, np.arange(side) - side / 2)
    x, y = a * texel_mm / 90, -b * texel_mm / 90
    unit = np.stack([np.sin(x) * np.cos(y), np.sin(y), np.cos(x) * np.cos(y)], axis=-1)
    found = bend_normals(90 * unit, unit, height)
    points = ((90 + height[..., None]) * unit).reshape(-1, 3)
    index = np.arange(side * side).reshape(side, side)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    halves = ((a, b, c), (a, c, d), (a, b, d), (b, c, d))
    triangles = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in halves])
    displaced = vertex_normals(points, triangles).reshape(side, side, 3)
    inner = np.s_[2:-2, 2:-2]
    return found[inner], displaced[inner], unit[inner]


def angles_deg(one: np.ndarray, two: np.ndarray) -> np.ndarray:
    return np.degrees(np.arccos(np.clip((one * two).sum(axis=-1), -1, 1)))


if __name__ == "__main__":
    main()
