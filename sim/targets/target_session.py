"""Calibration targets photographed in the stage: a session of them, with truth beside."""

from __future__ import annotations

import dataclasses
import datetime
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.commands import ProgressCallback
from lightstage.formats.files import sha256_file, write_bytes, write_json
from lightstage.formats.session import Driven, Frame, SessionFile, save_session, session_id
from lightstage.rig import Camera, Rig, save_rig
from sim.camera.chart import chart_reflectance
from sim.camera.dng import Exif, dng_bytes
from sim.camera.flaws import CaptureFlaws
from sim.camera.optics import Lens, make_lens, own_rng
from sim.camera.sensor import make_sensor
from sim.light.lamps import Lamps, lamps_of
from sim.session import truth_path
from sim.targets.ball import Ball, highlights_mm, photograph_grey, photograph_mirror
from sim.targets.boards import BoardConfig, board_poses, chart_patches_mm, chart_plane, facing
from sim.targets.plane import Plane, photograph_plane

SCHEMA = "lightstage.sim-targets/1"
LONGEST, SHORTEST = 16.0, 1e-4
"""Shutter times against the session's, between which a target's exposure is chosen."""

Picture = tuple[np.ndarray, np.ndarray]
"""Light (h, w, 3) and depth (h, w) in mm, 0 where nothing is."""


@dataclasses.dataclass(frozen=True)
class TargetsConfig:
    """Which targets, how often.

    Attributes:
        board: the ChArUco board.
        board_poses: photographs of it.
        ball_radius_mm: of both balls.
        mirror_reflectance: of the mirror ball.
        mirror_places_mm: where the mirror ball is.
        grey_reflectance: of the grey ball.
        chart_width_mm: of the 24-patch chart.
        flats: photographs of an even light that fills the lens.
        darks: photographs with the lens capped.
    """

    board: BoardConfig = dataclasses.field(default_factory=BoardConfig)
    board_poses: int = 16
    ball_radius_mm: float = 38.1
    mirror_reflectance: float = 0.6
    mirror_places_mm: tuple[tuple[float, float, float], ...] = ((0, 0, 0), (35, -20, 25))
    grey_reflectance: float = 0.18
    chart_width_mm: float = 168.0
    flats: int = 2
    darks: int = 2


@dataclasses.dataclass(frozen=True)
class Target:
    """One thing to photograph with all cameras.

    Attributes:
        lit: whether the stage is at `full`.
        picture: what an ideal lens shows of it to a camera.
        truth: what is known of it, JSON-ready.
        seen: what is known of it in a camera's picture, JSON-ready.
    """

    lit: bool
    picture: Callable[[Camera], Picture]
    truth: dict[str, Any]
    seen: Callable[[Camera], dict[str, Any]]


def make_targets(
    rig: Rig, lamps: Lamps, config: TargetsConfig, flaws: CaptureFlaws, seed: int
) -> dict[str, Target]:
    """All targets by pattern name, in the order in which they are shot."""
    ambient = flaws.room.ambient * np.array(flaws.room.ambient_rgb)
    out: dict[str, Target] = {}
    board = config.board
    corners = board.corners_mm()
    for index, pose in enumerate(board_poses(rig, board, config.board_poses, seed)):
        out[f"charuco-{index:02d}"] = _flat_target(
            board.plane(pose), lamps, ambient, "charuco", dataclasses.asdict(board), corners
        )
    size = np.array([config.chart_width_mm, config.chart_width_mm * 11.25 / 16.75])
    patches = chart_patches_mm(config.chart_width_mm)
    target = {"width_mm": config.chart_width_mm, "reflectance": chart_reflectance().tolist()}
    for index, camera in enumerate(rig.cameras):
        pose = facing(camera.centre_mm, np.zeros(3), size)
        plane = chart_plane(config.chart_width_mm, pose)
        out[f"chart-{index:02d}"] = _flat_target(
            plane, lamps, ambient, "chart", target, patches.mean(axis=1)
        )
    for index, place in enumerate(config.mirror_places_mm):
        ball = Ball(np.array(place, float), config.ball_radius_mm, config.mirror_reflectance)
        out[f"mirror-{index:02d}"] = _ball_target(ball, "mirror", lamps, ambient)
    grey = Ball(np.zeros(3), config.ball_radius_mm, config.grey_reflectance)
    out["grey-00"] = _ball_target(grey, "grey", lamps, ambient)
    for index in range(config.flats):
        out[f"flat-{index:02d}"] = Target(False, _even, {"kind": "flat"}, lambda _: {})
    for index in range(config.darks):
        out[f"dark-{index:02d}"] = Target(False, _capped, {"kind": "dark"}, lambda _: {})
    return out


def write_targets(
    rig: Rig,
    out: Path,
    config: TargetsConfig,
    flaws: CaptureFlaws,
    seed: int,
    progress: ProgressCallback,
) -> Path:
    """Write a session of targets as DNG files, and OUT.truth/targets.json.

    All cameras expose a target alike, so that the brightest pixel is at the sensors' headroom.
    An even light and darkness keep the session's own exposure.

    Args:
        rig: the stage.
        out: session folder, new.
        config: which targets.
        flaws: what lens, room and sensor do. Targets stand still, and `full` has no pulses.
        seed: of poses, lenses, sensors and noise.
        progress: of photographs.

    Returns:
        `out`. session.json is written last, so a folder without it is unfinished.
    """
    created = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    lamps = lamps_of(rig, flaws.lamps, seed)
    lenses = {c.id: make_lens(c, flaws.lens, seed) for c in rig.cameras}
    sensors = {
        c.id: make_sensor(flaws.sensor, np.ones(3), own_rng(seed, c.id, b"sensor"))
        for c in rig.cameras
    }
    targets = make_targets(rig, lamps, config, flaws, seed)
    save_rig(rig, out / "rig.json")
    frames, truth = [], {}
    for name, target in targets.items():
        lights = {c.id: _formed(lenses[c.id], target.picture(c)) for c in rig.cameras}
        factor = 1.0
        if target.lit:
            raw = [(sensors[k].raw_from_linear @ light.max(axis=(0, 1))).max()
                   for k, light in lights.items()]  # fmt: skip
            factor = float(np.clip(flaws.sensor.headroom / max(max(raw), 1e-9), SHORTEST, LONGEST))
        for camera in rig.cameras:
            sensor, lens = sensors[camera.id].exposed(factor), lenses[camera.id]
            rng = own_rng(seed, camera.id, name.encode())
            exif = Exif(camera.model, camera.serial, lens.config.f_number, lens.focal_mm)
            path = f"frames/{name}/{camera.id}.dng"
            counts = sensor.expose(lights[camera.id], rng)
            write_bytes(out / path, dng_bytes(counts, sensor, exif))
            digest = sha256_file(out / path)
            frames.append(
                Frame(pattern=name, camera=camera.id, path=path, sha256=digest, encoding="raw")
            )
            progress(len(frames), len(targets) * len(rig.cameras))
        seen = {camera.id: target.seen(camera) for camera in rig.cameras}
        truth[name] = target.truth | {"exposure_factor": factor, "cameras": seen}
    value = {
        "schema": SCHEMA,
        "seed": seed,
        "flaws": dataclasses.asdict(flaws),
        "lamps": {
            "positions_mm": lamps.positions_mm.tolist(),
            "weights": lamps.weights.tolist(),
            "radius_mm": lamps.radius_mm,
            "exponent": lamps.exponent,
        },
        "sensors": {
            camera_id: {
                "raw_from_linear": sensor.raw_from_linear.tolist(),
                "exposure_s": sensor.exposure_s,
                "electrons_per_dn": sensor.config.gain_e_per_dn,
                "read_noise_e": sensor.config.noise_e,
            }
            for camera_id, sensor in sensors.items()
        },
        "targets": truth,
    }
    write_json(truth_path(out) / "targets.json", value)
    driven = {
        name: Driven(levels=[1.0 if target.lit else 0.0] * len(rig.lights))
        for name, target in targets.items()
    }
    file = SessionFile(
        id=session_id("targets", "none", created),
        created_utc=created,
        subject="targets",
        expression="none",
        sequence=list(targets),
        frames=frames,
        patterns=driven,
    )
    save_session(out, file)
    return out


def _flat_target(
    plane: Plane,
    lamps: Lamps,
    ambient: np.ndarray,
    kind: str,
    target: dict[str, Any],
    places_mm: np.ndarray,
) -> Target:
    full = np.ones(len(lamps.weights))

    def seen(camera: Camera) -> dict[str, Any]:
        pixels, _ = camera.project(plane.world(places_mm))
        if (camera.centre_mm - plane.world_from_target[:, 3]) @ plane.normal <= 0:
            pixels[:] = np.nan
        outside = (pixels < 0) | (pixels > [camera.width_px, camera.height_px])
        pixels[outside.any(axis=1)] = np.nan
        return {"places_px": _known_px(pixels)}

    truth = {
        "kind": kind,
        **target,
        "world_from_target": plane.world_from_target.tolist(),
        "places_mm": places_mm.tolist(),
    }
    return Target(
        True, lambda camera: photograph_plane(plane, camera, lamps, full, ambient), truth, seen
    )


def _ball_target(ball: Ball, kind: str, lamps: Lamps, ambient: np.ndarray) -> Target:
    full = np.ones(len(lamps.weights))
    photograph = photograph_mirror if kind == "mirror" else photograph_grey

    def seen(camera: Camera) -> dict[str, Any]:
        if kind == "grey":
            return {}
        places = highlights_mm(ball, camera, lamps.positions_mm)
        return {"highlights_px": _known_px(camera.project(places)[0])}

    truth = {
        "kind": kind,
        "centre_mm": ball.centre_mm.tolist(),
        "radius_mm": ball.radius_mm,
        "reflectance": ball.reflectance,
    }
    return Target(True, lambda camera: photograph(ball, camera, lamps, full, ambient), truth, seen)


def _formed(lens: Lens, picture: Picture) -> np.ndarray:
    return lens.form(*picture)


def _even(camera: Camera) -> Picture:
    """The opening of an integrating sphere, before the lens: half of what white reads."""
    shape = (camera.height_px, camera.width_px)
    return np.full((*shape, 3), 0.5, np.float32), np.zeros(shape, np.float32)


def _capped(camera: Camera) -> Picture:
    shape = (camera.height_px, camera.width_px)
    return np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32)


def _known_px(pixels: np.ndarray) -> list[list[float] | None]:
    """Pixels as JSON, null where not seen."""
    return [[float(x), float(y)] if np.isfinite(x + y) else None for x, y in pixels]
