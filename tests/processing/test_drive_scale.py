"""A person's albedo does not depend on how the stage drove its lights: weighted, or on and off."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import open3d
import pytest
import trimesh

from lightstage.formats.environment import white_reading
from lightstage.formats.exr import write_exr
from lightstage.formats.files import sha256_file, write_json
from lightstage.formats.mesh import Mesh, write_ply
from lightstage.formats.processed import ProcessedFolder
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
from lightstage.rig import default_rig, save_rig
from processing.decode.config import DecodeConfig
from processing.decode.stage import decode
from processing.refinement.config import RefineConfig
from processing.refinement.stage import refine
from sim.devices.photographer import Photographer
from sim.light.world import World
from tests.sim.conftest import ball_subject, one_person

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
    emitters: tuple[str, ...] = (),
) -> Session:
    """A session as a stage that drives so would leave it; its chart perhaps lit otherwise."""
    photographer = Photographer(world, 3, drive=drive)
    save_rig(world.rig, root / "rig.json")
    camera = world.rig.cameras[0]
    levels = {name: drive_levels(name, world.rig, drive, emitters=emitters) for name in patterns}
    frames = []
    for name, level in levels.items():
        path = root / "frames" / name / f"{camera.id}.{'exr' if linear else 'dng'}"
        path.parent.mkdir(parents=True)
        if linear:
            full = drive_levels("full", world.rig, drive, emitters=emitters)
            white = white_reading(world.rig, full)
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


def sphere() -> Mesh:
    """The ball's shape, of even triangles."""
    made = trimesh.creation.icosphere(4, 80.0)
    return Mesh(made.vertices, np.asarray(made.faces, np.int32))


def coarser(mesh: Mesh, triangles: int) -> Mesh:
    """The same surface, of so few triangles: light is carried from each to the others."""
    made = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(mesh.vertices), open3d.utility.Vector3iVector(mesh.faces)
    ).simplify_quadric_decimation(triangles)
    return Mesh(np.asarray(made.vertices), np.asarray(made.triangles).astype(np.int32))


def albedo_of(
    session: Session, out: Path, shape: Mesh | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """(h, w, 3) diffuse albedo by the subject's own shape, and (h, w) where it is sure."""
    folder = ProcessedFolder(out)
    decode(session, out, DecodeConfig())
    write_ply(shape or sphere(), folder.base_mesh)
    # Which family of lobes it is does not depend on the drive, nor on what is asserted here.
    refine(session, out, RefineConfig(finest_mm=3.0, choice_pixels=0))
    return folder.read_view("cam0", "diffuse_albedo"), folder.read_view("cam0", "confidence") > 0.5


@pytest.fixture(scope="module")
def plain(world, tmp_path_factory) -> tuple[np.ndarray, np.ndarray]:
    root = tmp_path_factory.mktemp("plain")
    return albedo_of(session_of(world, root / "s", "on-off"), root / "out")


@pytest.fixture(scope="module")
def plain_linear(world, tmp_path_factory) -> tuple[np.ndarray, np.ndarray]:
    """As `plain`, without a sensor's noise, which at this size alone turns albedo by a per cent."""
    root = tmp_path_factory.mktemp("plain_linear")
    return albedo_of(session_of(world, root / "s", "on-off", linear=True), root / "out")


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
    world, plain, plain_linear, tmp_path, drive, patterns, chart_under, linear
):
    known, sure = plain_linear if linear else plain
    session = session_of(world, tmp_path / "s", drive, patterns, chart_under, linear)
    found, also_sure = albedo_of(session, tmp_path / "out")
    both = sure & also_sure
    assert both.sum() > 1000
    off = found[both] / known[both] - 1
    # Taken to be driven at level 1, `full` would have put the scale off by a fifth.
    assert 0.75 < white_reading(world.rig, drive_levels("full", world.rig)) < 0.85
    assert np.abs(np.median(off, axis=0)).max() < 0.01
    assert np.abs(off).mean() < 0.015


def test_albedo_by_emitters_of_one_colour_among_others_is_the_same(world, plain_linear, tmp_path):
    """Warm and cool emitters in each place; the warm ones alone take the photographs."""
    gains = {"warm": (1.2, 1.0, 0.6), "cool": (0.8, 1.0, 1.4)}
    lights = tuple(
        dataclasses.replace(
            light, id=2 * light.id + k, name=f"{light.name}/{colour}", colour=colour, rgb_gain=gain
        )
        for light in world.rig.lights
        for k, (colour, gain) in enumerate(gains.items())
    )
    stage = World(world.subject, dataclasses.replace(world.rig, lights=lights))
    session = session_of(stage, tmp_path / "s", "solid-angle", linear=True, emitters=("warm",))
    levels = np.array(session.file.patterns["full"].levels)
    assert not levels[stage.rig.colours["cool"]].any()
    known, sure = plain_linear
    found, also_sure = albedo_of(session, tmp_path / "out")
    both = sure & also_sure
    assert both.sum() > 1000
    off = found[both] / known[both] - 1
    assert np.abs(np.median(off, axis=0)).max() < 0.01
    assert np.abs(off).mean() < 0.015


def test_albedo_is_the_balls_own(world, plain):
    known, sure = plain
    green = known[sure][:, 1]  # 0.4 all over the ball
    assert np.median(green) == pytest.approx(0.4, rel=0.05)


def test_a_persons_albedo_is_the_same_by_either_drive(tmp_path):
    """Through the cameras' mosaics and noise, with cast shadows."""
    rig = default_rig().scaled(0.03)
    person = one_person()
    world = World(person, dataclasses.replace(rig, cameras=rig.cameras[:1]))
    shape = coarser(Mesh(person.mesh.vertices, person.mesh.triangles()), 12_000)
    drives: tuple[Drive, Drive] = ("on-off", "solid-angle")
    found = []
    for drive in drives:
        session = session_of(world, tmp_path / drive, drive)
        found.append(albedo_of(session, tmp_path / f"{drive}-out", shape))
    surface = world.surfaces["cam0"]
    both = found[0][1] & found[1][1] & surface.picture(surface.skin)
    assert both.sum() > 2000
    off = found[1][0][both] / found[0][0][both] - 1
    assert np.abs(np.median(off, axis=0)).max() < 0.012
    assert np.abs(off).mean() < 0.02
