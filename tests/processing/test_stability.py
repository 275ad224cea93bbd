"""Whatever a camera gives: masked with confidence 0 or right, through decode, separate, refine."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lightstage.errors import FormatError
from lightstage.formats.exr import read_exr, write_exr
from lightstage.formats.files import sha256_file
from lightstage.formats.mesh import Mesh, write_ply
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.session import load_session
from processing.albedo import diffuse_light, specular_evidence
from processing.coarse_maps import write_as_views
from processing.decode.config import DecodeConfig
from processing.decode.stage import decode
from processing.frames.read import Frames, read_frames, write_foreground, write_frames
from processing.normals import chroma_signal, solve_normals
from processing.refinement.config import RefineConfig
from processing.refinement.stage import refine
from processing.separation.config import SeparateConfig
from processing.separation.stage import separate
from tests.processing import lit_ball
from tests.processing.lit_ball import PATTERNS, Ball

BALL = Ball(coated=True)
RIG = lit_ball.small_rig(1, 0.028)
CAMERA = RIG.cameras[0]
SIGHT = lit_ball.see(BALL, CAMERA)
MAPS = ("diffuse_albedo", "specular_albedo", "diffuse_normal", "specular_normal", "confidence")
STAGES = ("separate", "refine")
# Nothing casts a shadow on a ball: triangles need not be finer than pixels.
CONFIG = RefineConfig(gloss_pixels=20_000, occlusion_directions=32, finest_mm=5.0)
HALF_PX = 4
"""Patches of bad pixels are twice this and one more wide."""


def black(rgb: np.ndarray) -> np.ndarray:
    return np.zeros_like(rgb)


def grey(rgb: np.ndarray) -> np.ndarray:
    return np.repeat(rgb.mean(axis=-1, keepdims=True), 3, axis=-1)


def nearly_grey(rgb: np.ndarray) -> np.ndarray:
    """Saturation a hundredth of skin's."""
    return grey(rgb) + 0.01 * (rgb - grey(rgb))


def dead_channel(rgb: np.ndarray) -> np.ndarray:
    out = rgb.copy()
    out[..., 1] = 0
    return out


def negative(rgb: np.ndarray) -> np.ndarray:
    """What noise below the black level leaves."""
    return -0.003 * np.ones_like(rgb)


def no_number(rgb: np.ndarray) -> np.ndarray:
    out = rgb.copy()
    out[3, ..., 0] = np.nan
    return out


def infinite(rgb: np.ndarray) -> np.ndarray:
    out = rgb.copy()
    out[2] = np.inf
    return out


def minus_infinite(rgb: np.ndarray) -> np.ndarray:
    out = rgb.copy()
    out[5, ..., 2] = -np.inf
    return out


Fault = Callable[[np.ndarray], np.ndarray]
FAULTS: dict[str, tuple[Fault, tuple[float, float]]] = {
    "black": (black, (-0.5, -0.3)),
    "grey": (grey, (-0.5, 0.3)),
    "nearly grey": (nearly_grey, (0.0, 0.0)),
    "dead channel": (dead_channel, (-0.1, 0.55)),
    "negative": (negative, (0.5, -0.3)),
    "no number": (no_number, (0.5, 0.3)),
    "infinite": (infinite, (-0.1, -0.6)),
    "minus infinite": (minus_infinite, (0.0, 0.3)),
}
"""What (P, h, w, 3) readings become, and where on the ball: shares of its radius right and down."""


def patch(place: tuple[float, float]) -> tuple[slice, slice]:
    rows, columns = np.nonzero(SIGHT.mask)
    radius = np.ptp(columns) / 2
    y = round(rows.mean() + place[1] * radius)
    x = round(columns.mean() + place[0] * radius)
    return slice(y - HALF_PX, y + HALF_PX + 1), slice(x - HALF_PX, x + HALF_PX + 1)


def photographs() -> np.ndarray:
    """(P, h, w, 3) float32 of the ball."""
    images = np.zeros((len(PATTERNS), *SIGHT.mask.shape, 3), np.float32)
    images[:, SIGHT.mask] = lit_ball.photograph(BALL, SIGHT, RIG).transpose(1, 0, 2)
    return images


def angle_deg(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angles between directions kept as half floats: by the chord, exact where they are small."""
    first, second = (
        x / np.maximum(np.linalg.norm(x, axis=-1, keepdims=True), 1e-9) for x in (a, b)
    )
    chord = np.linalg.norm(first - second, axis=-1)
    return np.asarray(np.degrees(2 * np.arcsin(np.clip(chord / 2, 0, 1))))


def mesh() -> Mesh:
    import trimesh

    shape = trimesh.creation.icosphere(3, BALL.radius_mm)
    return Mesh(np.asarray(shape.vertices), np.asarray(shape.faces, np.int32))


def replace_frames(session: Path, images: np.ndarray) -> None:
    """Photographs of a session, written anew as floats."""
    value = json.loads((session / "session.json").read_text())
    for frame in value["frames"]:
        path = session / frame["path"]
        write_exr(path, images[PATTERNS.index(frame["pattern"])], half=False)
        frame["sha256"] = sha256_file(path)
    (session / "session.json").write_text(json.dumps(value))


def maps_of(out: Path) -> dict[str, np.ndarray]:
    folder = ProcessedFolder(out)
    return {name: folder.read_view(CAMERA.id, name) for name in MAPS}


def both_stages(session: Path, out: Path) -> dict[str, dict[str, np.ndarray]]:
    """Maps after `separate` and after `refine`; any warning of a library is an error."""
    loaded = load_session(session)
    found = {}
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        separate(loaded, out, SeparateConfig(forced=True))
        write_as_views(out, [CAMERA.id])
        found["separate"] = maps_of(out)
        write_ply(mesh(), ProcessedFolder(out).base_mesh)
        refine(loaded, out, CONFIG)
        found["refine"] = maps_of(out)
    return found


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("stability")


@pytest.fixture(scope="module")
def session(folder: Path) -> Path:
    return lit_ball.write_session(BALL, RIG, folder / "session")


@pytest.fixture(scope="module")
def sound(folder: Path, session: Path) -> dict[str, dict[str, np.ndarray]]:
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        decode(load_session(session), folder / "sound", DecodeConfig())
    return both_stages(session, folder / "sound")


@pytest.fixture(scope="module")
def faulty(folder: Path) -> dict[str, dict[str, np.ndarray]]:
    """Every fault in one view, through decode."""
    root = lit_ball.write_session(BALL, RIG, folder / "faulty session")
    images = photographs()
    for spoil, place in FAULTS.values():
        rows, columns = patch(place)
        images[:, rows, columns] = spoil(images[:, rows, columns])
    replace_frames(root, images)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        decode(load_session(root), folder / "faulty", DecodeConfig())
    return both_stages(root, folder / "faulty")


@pytest.mark.parametrize("stage", STAGES)
@pytest.mark.parametrize("name", FAULTS)
def test_faulty_pixels_have_no_confidence(
    name: str, stage: str, faulty: dict[str, dict[str, np.ndarray]]
) -> None:
    where = patch(FAULTS[name][1])
    assert not faulty[stage]["confidence"][where].any()
    for values in faulty[stage].values():
        assert np.isfinite(values).all()
        assert np.abs(values).max() < 10


@pytest.mark.parametrize("stage", STAGES)
def test_faulty_pixels_leave_the_others_as_they_are(
    stage: str,
    sound: dict[str, dict[str, np.ndarray]],
    faulty: dict[str, dict[str, np.ndarray]],
) -> None:
    good = SIGHT.mask & (sound[stage]["confidence"] > 0.5)
    # In pictures as small as these, refine takes the ball's flanks for steps in depth.
    assert good[SIGHT.mask].mean() > (0.6 if stage == "separate" else 0.25)
    for _, place in FAULTS.values():
        rows, columns = patch(place)
        good[rows.start - 3 : rows.stop + 3, columns.start - 3 : columns.stop + 3] = False
    known, found = sound[stage], faulty[stage]
    assert found["confidence"][good].mean() > 0.95 * known["confidence"][good].mean()
    normals = angle_deg(known["diffuse_normal"], found["diffuse_normal"])
    assert np.quantile(normals[good], 0.99) < 1.0
    albedo = np.abs(known["diffuse_albedo"][good] - found["diffuse_albedo"][good])
    assert np.quantile(albedo, 0.99) < 0.02
    gloss = np.abs(known["specular_albedo"][good] - found["specular_albedo"][good])
    assert np.quantile(gloss, 0.99) < 0.006


def given_frames(folder: Path, images: np.ndarray, valid: np.ndarray) -> Path:
    """A processed folder with these photographs as decode leaves them."""
    write_frames(folder, CAMERA.id, Frames.of(PATTERNS, images, valid))
    write_foreground(folder, CAMERA.id, SIGHT.mask)
    return folder


@pytest.mark.parametrize("fault", ["clipped", "grey", "dark"])
def test_a_view_of_nothing_but_faults_has_no_confidence(
    session: Path, tmp_path: Path, fault: str
) -> None:
    images, valid = photographs(), np.ones(SIGHT.mask.shape, bool)
    if fault == "clipped":
        valid[:] = False
    elif fault == "grey":
        images = grey(images)
    else:
        images *= np.float32(1e-6)
    found = both_stages(session, given_frames(tmp_path, images, valid))
    for stage in STAGES:
        assert not found[stage]["confidence"].any()
        for values in found[stage].values():
            assert np.isfinite(values).all()


def test_one_clipped_channel_masks_its_pixels(session: Path, tmp_path: Path) -> None:
    images, valid = photographs(), np.ones(SIGHT.mask.shape, bool)
    where = patch((0.0, 0.0))
    valid[where] = False
    found = both_stages(session, given_frames(tmp_path, images, valid))
    for stage in STAGES:
        assert not found[stage]["confidence"][where].any()
        assert found[stage]["confidence"].max() > 0.9


# What is black in all patterns is none of the foreground.
@pytest.mark.parametrize("name", sorted(FAULTS.keys() - {"black", "negative"}))
def test_refine_lets_mesh_and_neighbours_stand_in_for_faulty_pixels(
    name: str, faulty: dict[str, dict[str, np.ndarray]]
) -> None:
    where, found = patch(FAULTS[name][1]), faulty["refine"]
    inner = tuple(slice(part.start + 2, part.stop - 2) for part in where)
    np.testing.assert_allclose(
        found["diffuse_albedo"][inner], np.broadcast_to(BALL.albedo, (5, 5, 3)), rtol=0.15
    )
    np.testing.assert_allclose(found["specular_albedo"][inner], BALL.specular, rtol=0.4)
    true = np.zeros((*SIGHT.mask.shape, 3))
    true[SIGHT.mask] = SIGHT.normals
    for each in ("diffuse_normal", "specular_normal"):
        assert angle_deg(found[each][inner], true[inner]).max() < 4


def test_normals_do_not_depend_on_the_scale_of_light(
    session: Path, tmp_path: Path, sound: dict[str, dict[str, np.ndarray]]
) -> None:
    images = photographs() / np.float32(4)
    out = given_frames(tmp_path, images, np.ones(SIGHT.mask.shape, bool))
    found = both_stages(session, out)
    for stage in STAGES:
        sure = (sound[stage]["confidence"] > 0.5) & (found[stage]["confidence"] > 0.5)
        assert sure.sum() > 1000
        apart = angle_deg(found[stage]["diffuse_normal"], sound[stage]["diffuse_normal"])
        assert np.median(apart[sure]) < 0.3
        for values in found[stage].values():
            assert np.isfinite(values).all()


def test_readings_a_million_times_white_are_refused(session: Path, tmp_path: Path) -> None:
    images = photographs() * np.float32(2.0**20)
    out = given_frames(tmp_path, images, np.ones(SIGHT.mask.shape, bool))
    with pytest.raises(FormatError, match=r"albedo.*above 65504.*Scale linear photographs"):
        separate(load_session(session), out, SeparateConfig())


def test_a_photograph_of_another_size_is_named(session: Path, tmp_path: Path) -> None:
    root = lit_ball.write_session(BALL, RIG, tmp_path / "session")
    value = json.loads((root / "session.json").read_text())
    frame = next(f for f in value["frames"] if f["pattern"] == "y+")
    write_exr(root / frame["path"], read_exr(root / frame["path"])[:-3], half=False)
    with pytest.raises(FormatError, match=r"y\+.*expected \d+ x \d+"):
        decode(load_session(root), tmp_path / "out", DecodeConfig())


SCALES = st.floats(-6, 6).map(lambda power: 10.0**power)
SEEDS = st.integers(0, 2**31)


@given(scale=SCALES, seed=SEEDS)
@settings(max_examples=25, deadline=None)
def test_chroma_in_float32_is_that_in_float64(scale: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    rgb = scale * rng.uniform(0.1, 1.0, (20, 7, 1)) * np.array([0.55, 0.33, 0.22])
    rgb += scale * rng.uniform(0, 0.05, rgb.shape)
    white = rng.uniform(0.8, 1.2, 3)
    signal, saturation = chroma_signal(rgb.astype(np.float32), white)
    unit = white / np.linalg.norm(white)
    total = rgb.sum(axis=1)
    hue = total - (total @ unit)[:, None] * unit
    length = np.linalg.norm(hue, axis=1)
    known = np.einsum("npc,nc->np", rgb, hue / length[:, None])
    np.testing.assert_allclose(signal, known, rtol=1e-4, atol=1e-4 * scale * 0.1)
    np.testing.assert_allclose(saturation, length / total.mean(axis=1), rtol=1e-4)


@given(scale=SCALES, seed=SEEDS)
@settings(max_examples=25, deadline=None)
def test_normals_in_float32_are_those_in_float64(scale: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    vectors = rng.normal(size=(20, 7, 3))
    signal = scale * np.einsum("npk,nk->np", vectors, rng.normal(size=(20, 3)))
    signal += 0.02 * scale * rng.normal(size=signal.shape)
    found = solve_normals(signal.astype(np.float32), vectors.astype(np.float32))
    for i in range(len(signal)):
        known = np.linalg.lstsq(vectors[i], signal[i], rcond=None)[0]
        np.testing.assert_allclose(found[i], known / np.linalg.norm(known), atol=1e-4)


@given(scale=SCALES, seed=SEEDS)
@settings(max_examples=25, deadline=None)
def test_albedo_in_float32_is_that_in_float64(scale: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    e, lobe = rng.uniform(0.05, 1, (30, 7)), rng.uniform(0, 2, (30, 7))
    rgb = scale * (e[..., None] * [0.55, 0.33, 0.22] + 0.03 * lobe[..., None])
    single = [x.astype(np.float32) for x in (rgb, e, lobe)]
    specular = np.full(30, 0.03 * scale)
    lit, power = diffuse_light(single[0], single[1], single[2], specular)
    np.testing.assert_allclose(
        lit / power[:, None], np.tile(scale * np.array([0.55, 0.33, 0.22]), (30, 1)), rtol=1e-4
    )
    evidence = specular_evidence(single[0].mean(axis=2), single[1], single[2])
    found = evidence.weighed / evidence.weight
    np.testing.assert_allclose(found, specular, rtol=2e-3, atol=1e-4 * scale)


def test_frames_keep_what_they_hold_over_scales(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for power in (-6, 0, 6):
        images = (10.0**power * rng.uniform(0, 1, (3, 5, 7, 3))).astype(np.float32)
        frames = Frames.of(("full", "x+", "x-"), images, np.ones((5, 7), bool))
        write_frames(tmp_path, "cam0", frames)
        found = read_frames(tmp_path, "cam0").images
        np.testing.assert_allclose(found, images, rtol=1e-3, atol=1e-4 * 10.0**power)
