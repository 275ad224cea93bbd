"""A person's albedo does not depend on how the stage drove its lights: weighted, or on and off."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import trimesh

from lightstage.errors import FormatError
from lightstage.formats.environment import stage_lights, white_reading
from lightstage.formats.exr import write_exr
from lightstage.formats.files import sha256_file, write_json
from lightstage.formats.mesh import Mesh, write_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.scale import full_levels, raw_scale
from lightstage.formats.session import (
    Calibration,
    Driven,
    Frame,
    Session,
    SessionFile,
    load_session,
    save_session,
)
from lightstage.patterns import SEQUENCES, Drive, drive_levels
from lightstage.rig import Rig, default_rig, save_rig
from processing.decode import DecodeConfig, decode
from processing.refine import RefineConfig, refine
from sim.devices.capture import Photographer
from sim.light.world import World
from tests.sim.conftest import ball_subject

BINARY = SEQUENCES["binary"]
COLOUR = "calibration/colour.json"


@pytest.fixture(scope="module")
def world() -> World:
    rig = default_rig().scaled(0.03)
    return World(ball_subject(), dataclasses.replace(rig, cameras=rig.cameras[:1]))


def session_of(
    world: World,
    root: Path,
    drive: Drive,
    patterns: tuple[str, ...] = BINARY,
    chart_under: Drive | None = None,
    linear: bool = False,
) -> Session:
    """A session as a stage that drives so would leave it; its chart perhaps lit otherwise."""
    photographer = Photographer(world, 3, drive=drive)
    save_rig(world.rig, root / "rig.json")
    camera = world.rig.cameras[0]
    levels = {name: drive_levels(name, world.rig, drive) for name in patterns}
    frames = []
    for name, level in levels.items():
        path = root / "frames" / name / f"{camera.id}.{'exr' if linear else 'dng'}"
        path.parent.mkdir(parents=True)
        if linear:
            white = white_reading(world.rig, drive_levels("full", world.rig, drive))
            write_exr(path, world.photograph(camera.id, level[None])[0] / white, half=False)
        else:
            path.write_bytes(photographer.photograph(camera, level))
        where = str(path.relative_to(root))
        encoding = "linear" if linear else "raw"
        frames.append(
            Frame(
                pattern=name, camera=camera.id, path=where, sha256=sha256_file(path),
                encoding=encoding,
            )
        )  # fmt: skip
    if not linear:
        calibration = photographer.colour_calibration()
        if chart_under is not None:
            other = Photographer(world, 3, drive=chart_under)
            # The same camera at the same exposure: only the light on the chart was another one.
            other.sensors = photographer.sensors
            calibration = other.colour_calibration()
        write_json(root / COLOUR, calibration)
    save_session(
        root,
        SessionFile(
            id="s",
            created_utc="",
            subject="ball",
            expression="neutral",
            sequence=list(patterns),
            frames=frames,
            patterns={name: Driven(levels=level.tolist()) for name, level in levels.items()},
            calibration=Calibration(colour=None if linear else COLOUR),
        ),
    )
    return load_session(root)


def albedo_of(session: Session, out: Path) -> tuple[np.ndarray, np.ndarray]:
    """(h, w, 3) diffuse albedo by the ball's own shape, and (h, w) where it is sure."""
    folder = ProcessedFolder(out)
    decode(session, out, DecodeConfig())
    sphere = trimesh.creation.icosphere(5, 80.0)
    write_ply(Mesh(sphere.vertices, np.asarray(sphere.faces, np.int32)), folder.base_mesh)
    refine(session, out, RefineConfig())
    return folder.read_view("cam0", "diffuse_albedo"), folder.read_view("cam0", "confidence") > 0.5


@pytest.fixture(scope="module")
def plain(world, tmp_path_factory) -> tuple[np.ndarray, np.ndarray]:
    root = tmp_path_factory.mktemp("plain")
    return albedo_of(session_of(world, root / "s", "on-off"), root / "out")


@pytest.mark.parametrize(
    ("drive", "patterns", "chart_under", "linear"),
    [
        ("solid-angle", BINARY, None, False),
        ("on-off", BINARY, "solid-angle", False),
        ("solid-angle", BINARY, "on-off", False),
        ("solid-angle", BINARY[1:], None, False),
        ("solid-angle", BINARY, None, True),
    ],
    ids=["weighted", "chart-weighted", "chart-on-off", "without-full", "linear"],
)
def test_albedo_is_that_of_an_on_off_session(
    world, plain, tmp_path, drive, patterns, chart_under, linear
):
    known, sure = plain
    session = session_of(world, tmp_path / "s", drive, patterns, chart_under, linear)
    found, also_sure = albedo_of(session, tmp_path / "out")
    both = sure & also_sure
    assert both.sum() > 1000
    off = found[both] / known[both] - 1
    # Taken to be driven at level 1, `full` would have put the scale off by a fifth.
    assert 0.75 < white_reading(world.rig, drive_levels("full", world.rig)) < 0.85
    assert np.abs(np.median(off, axis=0)).max() < 0.01
    assert np.abs(off).mean() < 0.015


def test_albedo_is_the_balls_own(world, plain):
    known, sure = plain
    green = known[sure][:, 1]  # 0.4 all over the ball
    assert np.median(green) == pytest.approx(0.4, rel=0.05)


def bare(
    rig: Rig, driven: dict[str, np.ndarray], root: Path = Path(), colour: object = None
) -> Session:
    if colour is not None:
        write_json(root / COLOUR, {"schema": "lightstage.colour/1", "full_levels": colour})
    file = SessionFile(
        id="s",
        created_utc="",
        subject="p",
        expression="neutral",
        sequence=list(driven),
        frames=[],
        patterns={name: Driven(levels=list(level)) for name, level in driven.items()},
        calibration=Calibration(colour=None if colour is None else COLOUR),
    )
    return Session(root, file, rig)


@pytest.mark.parametrize(
    "names",
    [
        ("full", "x+"),
        ("x+", "x-"),
        ("y+", "lin-z-", "lin-z+"),
        ("mux-1", "mux-2"),
        ("full@cross", "full@parallel"),
        ("y-@cross", "y+@parallel", "y-@parallel", "y+@cross"),
    ],
)
@pytest.mark.parametrize("drive", ["solid-angle", "on-off"])
def test_full_is_found_from_what_was_driven(names, drive):
    rig = default_rig()
    session = bare(rig, {name: drive_levels(name, rig, drive) for name in names})
    known = drive_levels("full", rig, drive)
    np.testing.assert_allclose(full_levels(session), known, rtol=0, atol=1e-12)


def test_where_full_cannot_be_told_the_chart_says_it_and_else_it_is_level_1(tmp_path):
    rig = default_rig()
    driven = {"x+": drive_levels("x+", rig), "olat-004": drive_levels("olat-004", rig)}
    assert np.array_equal(full_levels(bare(rig, driven)), np.ones(168))
    weighted = drive_levels("full", rig)
    session = bare(rig, driven, tmp_path, weighted.tolist())
    assert np.array_equal(full_levels(session), weighted)
    assert raw_scale(session) == 1


def test_a_chart_lit_half_as_brightly_halves_the_scale(tmp_path):
    rig = default_rig()
    session = bare(rig, {"full": np.ones(168)}, tmp_path, [0.5] * 168)
    assert raw_scale(session) == pytest.approx(0.5)


@pytest.mark.parametrize(
    "levels", [[1.0] * 3, [2.0] * 168, [None] * 168, [0.0] * 168, "bright", [["a"]]]
)
def test_a_charts_levels_that_do_not_fit_are_refused(tmp_path, levels):
    with pytest.raises(FormatError, match=r"colour.json, full_levels: .*expected 168 levels"):
        raw_scale(bare(default_rig(), {}, tmp_path, levels))


def test_white_reads_one_under_what_full_was_and_a_dark_full_is_refused():
    rig = default_rig()
    full = drive_levels("full", rig)
    lights = stage_lights(rig, full, "full", full)
    away = lights.position_mm / np.linalg.norm(lights.position_mm, axis=1, keepdims=True)
    assert np.allclose(np.clip(away[:, 2], 0, None) @ lights.rgb, 1)
    behind = (rig.positions_mm[:, 2] < 0).astype(float)
    with pytest.raises(FormatError, match="no light in front"):
        stage_lights(rig, full, "full", behind)
