"""Polarised photographs: cost, difference from plain operators and from Mitsuba, leakage."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from benchmarks.record import record
from lightstage.formats.mesh import Mesh
from lightstage.patterns import pattern_levels
from lightstage.rig import Camera, Light, Rig, default_rig
from sim.light.facets import SKIN_INDEX
from sim.light.lamps import Lamps
from sim.light.olat import shade
from sim.light.polarised import (
    PolarisedWorld,
    PolariserConfig,
    facet_shares,
    filters,
    lamp_axes,
)
from sim.light.polarised_factors import polarised_factors
from sim.light.polarised_reference import (
    PlainSkin,
    StokesConfig,
    analysed,
    polarised_variant,
    stokes_picture,
)
from sim.light.scene import Scene
from sim.light.world import World
from sim.people.subject import Subject
from sim.people.subjects import load_subject
from sim.scans.lps import scan_folder

T = TypeVar("T")
Row = tuple[object, ...]
WIDTH_PX = 480
SMALL_PX = 128
LAMPS_MM = (
    (420.0, 350.0, 1123.0),
    (-1050.0, 234.0, 637.0),
    (700.0, -600.0, 844.0),
)
BANDS_DEG = ((0, 15), (15, 30), (30, 45), (45, 60), (60, 90))


def main() -> None:
    name = "lps" if scan_folder() is not None else "parametric"
    subject = load_subject(name, 1)
    rows: list[Row] = [*cost(subject), *twin_rows()]
    rows += against_mitsuba("sphere", sphere_subject(subject))
    rows += against_mitsuba(name, subject)
    record(
        "Polarised photographs",
        ("what", "seconds", "plain or peer, seconds", "ratio", "difference"),
        rows,
        f"{name}. Peer: Mitsuba's `{polarised_variant()}`, pplastic, lamp behind a polariser, "
        f"Stokes vectors read through an upright analyser, three lamps of each bank at "
        f"{SMALL_PX} pixels across, direct light, 256 samples. Mirror light: share of the "
        "unpolarised highlight's peak, where it is over a hundredth of it. "
        "Diffuse light: difference of the share that passes.",
    )
    record(
        "Leakage of cross-polarised shots",
        ("camera", "incidence, degrees", "cross, mean", "cross, most", "parallel, mean"),
        leakage(),
        "Default rig, extinction 1000 of lamps and lenses, a facet at the origin that mirrors each "
        "lamp into the camera; share of the mirror light that unpolarised lamps send into a lens "
        "without polariser (parallel can exceed 1 near Brewster's angle).",
    )


def cost(subject: Subject) -> list[Row]:
    """Seconds of a plain and of a polarised photograph."""
    rig = default_rig()
    rig = dataclasses.replace(rig, cameras=rig.cameras[:1])
    world = World(subject, rig.scaled(WIDTH_PX / rig.cameras[0].width_px))
    levels = np.stack([pattern_levels("full@parallel", rig), pattern_levels("full@cross", rig)])
    lit = PolarisedWorld(world)
    world.photograph("cam0", levels), lit.photograph("cam0", levels)  # compile
    plain, _ = timed(lambda: world.photograph("cam0", levels))
    seconds, _ = timed(lambda: lit.photograph("cam0", levels))
    pixels = len(world.surfaces["cam0"].pixel)
    return [
        (
            f"parallel and cross, {pixels} pixels, beside the same without polarisers",
            f"{seconds:.2f}",
            f"{plain:.2f}",
            f"{plain / seconds:.2f}",
            "",
        )
    ]


def twin_rows(count: int = 300) -> list[Row]:
    """The kernel beside 3 x 3 operators on the field in plain float64."""
    rng = np.random.default_rng(1)
    rays = rng.normal(size=(2, count, 3))
    rays[..., 2] = np.abs(rays[..., 2]) + 0.05
    view, light = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    lamp = rng.normal(size=3)
    arguments = (
        np.zeros((count, 3)),
        np.broadcast_to([0.0, 0.0, 1.0], (count, 3)),
        view,
        1250 * light,
        np.broadcast_to(lamp, (count, 3)),
        np.array([0.0, 1.0, 0.0]),
        SKIN_INDEX,
        1000.0,
        1000.0,
    )
    polarised_factors(*arguments)
    seconds, (_, found) = timed(lambda: polarised_factors(*arguments))
    plain, known = timed(
        lambda: np.array(
            [
                [specular_twin(view[i], light[k], lamp) for k in range(0, count, 10)]
                for i in range(0, count, 10)
            ]
        )
    )
    plain *= 100.0
    apart = np.abs(found[::10, ::10] - known).max()
    return [
        (
            f"factors of {count} points and lamps, mirror light",
            f"{seconds:.4f}",
            f"{plain:.2f}",
            f"{plain / seconds:.0f}",
            f"{apart:.1e} at most",
        )
    ]


def specular_twin(view: np.ndarray, light: np.ndarray, lamp: np.ndarray) -> float:
    """Share of mirror light through an upright lens, by operators on the field."""
    s = np.cross(light, view)
    s = s / np.linalg.norm(s)
    cosine = np.sqrt(0.5 * (1 + light @ view))
    inside = np.sqrt(1 - (1 - cosine**2) / SKIN_INDEX**2)
    r_s = (cosine - SKIN_INDEX * inside) / (cosine + SKIN_INDEX * inside)
    r_p = (SKIN_INDEX * cosine - inside) / (SKIN_INDEX * cosine + inside)
    mirror = r_s * np.outer(s, s) + r_p * np.outer(np.cross(view, s), np.cross(-light, s))
    e = lamp - (lamp @ light) * light
    e /= np.linalg.norm(e)
    a = np.array([0.0, 1.0, 0.0]) - view[1] * view
    a /= np.linalg.norm(a)
    total = 0.0
    for field, strong in ((e, 1.0), (np.cross(light, e), 1e-3)):
        for passed, kept in ((a, 1.0), (np.cross(view, a), 1e-3)):
            total += strong / 1.001 * kept * float(passed @ mirror @ field) ** 2
    return total / (0.5 * (r_s**2 + r_p**2))


def sphere_subject(like: Subject) -> Subject:
    """A ball of 80 mm in place of a head."""
    v, u = np.meshgrid(np.linspace(0, 1, 129), np.linspace(0, 1, 257), indexing="ij")
    polar, turn = np.pi * (1 - v), 2 * np.pi * (u - 0.5)
    normal = np.stack(
        [np.sin(polar) * np.sin(turn), np.cos(polar), np.sin(polar) * np.cos(turn)], axis=-1
    )
    corner = np.arange(128)[:, None] * 257 + np.arange(256)
    faces = np.stack([corner, corner + 1, corner + 258, corner + 257], axis=-1)
    faces = faces.reshape(-1, 4).astype(np.int32)
    uvs = np.stack([u.ravel(), v.ravel()], axis=1)
    return dataclasses.replace(like, mesh=Mesh(80.0 * normal.reshape(-1, 3), faces, uvs, faces))


def against_mitsuba(name: str, subject: Subject) -> list[Row]:
    """The fast model of each bank's lamps beside Stokes vectors, on skin of one kind."""
    skin = PlainSkin()
    shape = subject.diffuse_albedo.shape
    subject = dataclasses.replace(
        subject,
        diffuse_albedo=np.full(shape, skin.diffuse, np.float32),
        specular_albedo=np.full(shape[:2], (0.4 / 2.4) ** 2, np.float32),
        roughness=np.full(shape[:2], skin.roughness, np.float32),
        normal=np.zeros(shape, np.float32),
        distribution="beckmann",
        anisotropy=None,
    )
    scene = Scene(subject)
    camera = default_rig().cameras[0]
    camera = camera.scaled(SMALL_PX / camera.width_px)
    rows: list[Row] = []
    for bank, shot in (("horizontal", "cross"), ("vertical", "parallel")):
        seconds = np.zeros(2)
        mirror, body, more = [], [], []
        for place in LAMPS_MM:
            lamp = Light(0, "lamp", place, bank)
            fast, peer, off_mirror, off_body, bounce = one_lamp(scene, camera, lamp, skin)
            seconds += fast, peer
            mirror.append(off_mirror)
            body.append(off_body)
            more.append(bounce)
        off, off_b = np.concatenate(mirror), np.concatenate(body)
        rows += [
            (
                f"{name}, {shot}, mirror light",
                f"{seconds[0]:.2f}",
                f"{seconds[1]:.1f}",
                f"{seconds[1] / seconds[0]:.0f}",
                f"median {np.median(off):.1e}, 99 % below {np.quantile(off, 0.99):.1e}",
            ),
            (
                f"{name}, {shot}, diffuse light",
                "",
                "",
                "",
                f"median {np.median(off_b):.1e}, 95 % below {np.quantile(off_b, 0.95):.1e}",
            ),
            (
                f"{name}, {shot}, what further bounces add to all light",
                "",
                "",
                "",
                f"{100 * float(np.mean(more)):.1f} %",
            ),
        ]
    return rows


def one_lamp(
    scene: Scene, camera: Camera, lamp: Light, skin: PlainSkin
) -> tuple[float, float, np.ndarray, np.ndarray, float]:
    """Seconds of both, differences of mirror and of diffuse light, and the bounces' share."""
    config = PolariserConfig(np.inf, np.inf)
    rig = Rig((lamp,), (camera,))
    place, axis = rig.positions_mm, lamp_axes(rig)
    surface = scene.surface(camera)
    points = Lamps(place, np.ones((1, 3)), -place / np.linalg.norm(place), 1.0, 0.0)
    bits = scene.visible_lights(surface, place, coarse_px=1)
    fields = (surface.position, surface.geometric, surface.normal, surface.view)
    maps = (surface.albedo, surface.specular, surface.roughness)
    optics = filters(rig, camera, config)

    def photograph() -> tuple[np.ndarray, np.ndarray]:
        _, plain = shade(*fields, *maps, bits, points, np.ones((1, 1, 3)))
        shares = optics(surface.position, surface.normal, surface.view, np.arange(1))
        return plain[0, :, 1], np.concatenate(shares, axis=1)

    photograph()
    fast, (highlight, shares) = timed(photograph)
    mesh = scene.subject.mesh

    def stokes(part: PlainSkin, field: np.ndarray | None, bounces: int = 1) -> np.ndarray:
        wanted = StokesConfig(256, bounces)
        return stokes_picture(mesh, camera, place[0], field, part, wanted).reshape(-1, 4)

    def passed(part: PlainSkin, bounces: int = 1) -> np.ndarray:
        found = stokes(part, axis[0], bounces)[:, None]
        return analysed(found, config)[surface.pixel, 0]

    peer, known = timed(lambda: passed(dataclasses.replace(skin, diffuse=0.0)))
    # A pixel's middle represents its area only where the surface does not turn away within it.
    facing = np.einsum("nk,nk->n", surface.normal, surface.view) > 0.3
    shines = facing & (highlight > 0.01 * highlight.max())
    off_mirror = np.abs(highlight * shares[:, 1] - known)[shines] / highlight.max()
    matte = dataclasses.replace(skin, specular=0.0)
    plain = stokes(matte, None)[surface.pixel, 0]
    bright = facing & (plain > 0.1 * plain.max())
    off_body = np.abs(passed(matte)[bright] / plain[bright] - shares[bright, 0])
    direct, all_light = passed(skin).sum(), passed(skin, 6).sum()
    return fast, peer, off_mirror, off_body, float(all_light / direct - 1)


def leakage() -> list[Row]:
    """By camera and angle of incidence; then both ways round of the lenses."""
    rig = default_rig()
    horizontal = np.array([light.bank == "horizontal" for light in rig.lights])
    rows: list[Row] = []
    for camera_id in ("cam0", "cam4", "cam5", "cam7"):
        incidence, share = facet_shares(rig, rig.camera(camera_id))
        for low, high in BANDS_DEG:
            band = (incidence >= low) & (incidence < high)
            cross, parallel = share[band & horizontal], share[band & ~horizontal]
            rows.append(
                (
                    camera_id,
                    f"{low} to {high}",
                    f"{cross.mean():.4f}",
                    f"{cross.max():.4f}",
                    f"{parallel.mean():.3f}",
                )
            )
    for angle, bank, lenses in ((90.0, horizontal, "upright"), (0.0, ~horizontal, "horizontal")):
        incidence, share = facet_shares(rig, rig.cameras[0], PolariserConfig(lens_deg=angle))
        near = incidence < 60
        rows.append(
            (
                f"cam0, lenses {lenses}",
                "0 to 60",
                f"{share[near & bank].mean():.4f}",
                f"{share[near & bank].max():.4f}",
                f"{share[near & ~bank].mean():.3f}",
            )
        )
    return rows


def timed(work: Callable[[], T]) -> tuple[float, T]:
    begun = time.perf_counter()
    result = work()
    return time.perf_counter() - begun, result


if __name__ == "__main__":
    main()
