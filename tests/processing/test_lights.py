"""What lights give: measured ones, polarised patterns, colour channels, stray light, fall-off."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from lightstage.errors import FormatError
from lightstage.formats.lights import (
    SCHEMA,
    MeasuredLights,
    read_measured_lights,
    write_measured_lights,
)
from lightstage.formats.session import Calibration, Session, SessionFile
from lightstage.patterns import SEQUENCES, pattern_levels
from lightstage.rig import Rig, default_rig
from processing.errors import ProcessingError
from processing.lighting.lamps import NO_STRAY, Lamps, measured_rig, nominal_lamps
from processing.lighting.lights import (
    cells_of,
    far_field,
    irradiance_vectors,
    lights_of,
    no_shadows,
    octahedral_normals,
    off_axis,
    pattern_lights,
    rank,
)
from processing.lighting.lobe import transport

RIG = default_rig()
COUNT = len(RIG.lights)
BINARY = SEQUENCES["binary"]


def measured(
    rng: np.random.Generator, stray: dict[str, np.ndarray] | None = None
) -> MeasuredLights:
    return MeasuredLights(
        position_mm=RIG.positions_mm + rng.normal(size=(COUNT, 3)) * 10,
        rgb_gain=np.exp(rng.normal(size=(COUNT, 3)) * 0.1),
        exponent=1.5,
        stray=stray or {},
        position_sigma_mm=np.full(COUNT, 2.0),
        residual_px=np.where(np.arange(COUNT) == 3, np.nan, 0.1),
        gain_sigma=np.full(COUNT, 0.01),
        facts={"mirror": {"residual_px": 0.1}},
    )


def session_with(folder: Path, lights: MeasuredLights | None, rig: Rig = RIG) -> Session:
    stated = None
    if lights is not None:
        write_measured_lights(lights, rig, folder / "lights.json")
        stated = "lights.json"
    file = SessionFile(
        id="a",
        created_utc="2026-01-01T00:00:00+00:00",
        subject="p",
        expression="neutral",
        sequence=list(BINARY),
        frames=[],
        calibration=Calibration(lights=stated),
    )
    return Session(folder, file, rig)


def white_twin(
    lamps: np.ndarray,
    rgb: np.ndarray,
    levels: np.ndarray,
    exponent: float,
    p: np.ndarray,
    n: np.ndarray,
) -> np.ndarray:
    """(3,) what one white place reads: the plain sum over lamps."""
    total = np.zeros(3)
    for lamp, gain, level in zip(lamps, rgb, levels, strict=True):
        way = lamp - p
        far = float(np.linalg.norm(way))
        aside = max(0.0, float(way @ lamp) / far / float(np.linalg.norm(lamp)))
        facing = max(0.0, float(n @ way) / far)
        total += level * gain * facing * float(lamp @ lamp) / far**2 * aside**exponent
    return total


def test_measured_lights_come_back_from_their_file(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    known = measured(rng, {"x+": rng.normal(size=(3, 3, 4))})
    found = read_measured_lights(write_measured_lights(known, RIG, tmp_path / "l.json"), RIG)
    for field in ("position_mm", "rgb_gain", "position_sigma_mm", "residual_px", "gain_sigma"):
        np.testing.assert_array_equal(getattr(found, field), getattr(known, field))
    np.testing.assert_array_equal(found.stray["x+"], known.stray["x+"])
    assert (found.exponent, found.facts) == (known.exponent, known.facts)


def test_lights_of_a_file_may_stand_in_any_order(tmp_path: Path) -> None:
    known = measured(np.random.default_rng(1))
    path = write_measured_lights(known, RIG, tmp_path / "l.json")
    value = json.loads(path.read_text())
    value["lights"].reverse()
    value["lights"][0]["id"] *= 1.0  # some programs write every number with a point
    path.write_text(json.dumps(value))
    np.testing.assert_array_equal(read_measured_lights(path, RIG).rgb_gain, known.rgb_gain)


def test_every_fault_of_a_lights_file_is_in_one_message(tmp_path: Path) -> None:
    path = write_measured_lights(measured(np.random.default_rng(2)), RIG, tmp_path / "l.json")
    value = json.loads(path.read_text())
    value["lights"][4]["position_mm"] = [0, 0, "far"]
    value["lights"][5]["rgb_gain"] = [1, -1, 1]
    del value["lights"][6]
    value["lights"].append(value["lights"][3])
    value["exponent"] = -1
    value["stray"] = {"x+": [1, 2]}
    path.write_text(json.dumps(value))
    with pytest.raises(FormatError) as caught:
        read_measured_lights(path, RIG)
    message = str(caught.value)
    faults = ("lamp 3 twice", "lamp 4.position_mm", "lamp 5.rgb_gain", "no lamp 6")
    for word in (*faults, "exponent", "stray.x+"):
        assert word in message


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda places: places / 1000,
            "a stage of 1.251 mm radius .* about 1250 mm, as in rig.json. .* metres",
        ),
        (lambda places: places / 10, "a stage of 125.1 mm radius"),
        (
            lambda places: places[:, [0, 2, 1]],
            "mm from their places in rig.json .* at most 312.5 mm",
        ),
        (lambda places: places[::-1], "mm from their places in rig.json"),
    ],
    ids=["metres", "centimetres", "other axes", "other lamps"],
)
def test_measured_places_that_are_not_the_rigs_are_refused(
    tmp_path: Path, change: Callable[[np.ndarray], np.ndarray], message: str
) -> None:
    known = measured(np.random.default_rng(2))
    other = dataclasses.replace(known, position_mm=change(known.position_mm))
    path = write_measured_lights(other, RIG, tmp_path / "l.json")
    with pytest.raises(FormatError, match=rf"lights\[\].position_mm: found .*{message}"):
        read_measured_lights(path, RIG)


def test_a_newer_lights_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "l.json"
    path.write_text(json.dumps({"schema": SCHEMA.replace("/1", "/2")}))
    with pytest.raises(FormatError, match="newer"):
        read_measured_lights(path, RIG)


def test_a_session_without_measured_lights_has_the_rigs_and_reports_it(tmp_path: Path) -> None:
    lights = pattern_lights(session_with(tmp_path, None), BINARY)
    assert lights.source == "nominal"
    assert lights.exponent == 0
    assert not lights.stray_rgb.any()


def test_measured_lights_light_as_the_plain_sum_over_lamps_says(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    known = measured(rng)
    lights = pattern_lights(session_with(tmp_path, known), BINARY)
    assert lights.source == "measured"
    rgb = known.rgb_gain / np.sum(known.position_mm**2, axis=1)[:, None]
    front = np.array([0.0, 0.0, 1.0])
    white = white_twin(known.position_mm, rgb, np.ones(COUNT), 0.0, np.zeros(3), front)
    points = rng.normal(size=(6, 3)) * 60
    normals = rng.normal(size=(6, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    for c in range(3):
        vectors = irradiance_vectors(lights.channel(c), points, normals, no_shadows(6, lights))
        for k, name in enumerate(BINARY):
            levels = pattern_levels(name, RIG)
            for i in range(6):
                want = white_twin(
                    known.position_mm, rgb / white, levels, 1.5, points[i], normals[i]
                )
                assert vectors[i, k] @ normals[i] == pytest.approx(want[c], abs=2e-6)


def test_transport_has_the_irradiance_of_the_vectors_off_the_centre_too(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    stray = {name: rng.normal(size=(3, 3, 4)) * 0.02 for name in BINARY}
    lights = pattern_lights(session_with(tmp_path, measured(rng, stray)), BINARY)
    points = rng.normal(size=(50, 3)) * 80
    normals = rng.normal(size=(50, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    vectors = irradiance_vectors(lights, points, normals, no_shadows(50, lights))
    e, lobe = transport(lights, points, normals, normals, 0.3, no_shadows(50, lights))
    np.testing.assert_allclose(e, np.einsum("npk,nk->np", vectors, normals), atol=3e-6)
    wide = dataclasses.replace(lights, exponent=0.0)
    _, brighter = transport(wide, points, normals, normals, 0.3, no_shadows(50, lights))
    assert (lobe <= brighter * (1 + 1e-5)).all()
    assert (lobe[:, 0] < brighter[:, 0]).all()


def test_a_white_that_faces_the_front_reads_one_in_each_channel(tmp_path: Path) -> None:
    lights = pattern_lights(session_with(tmp_path, measured(np.random.default_rng(4))), BINARY)
    front = np.array([[0.0, 0.0, 1.0]])
    for c in range(3):
        own = lights.channel(c)
        found = irradiance_vectors(own, np.zeros((1, 3)), front, no_shadows(1, own))
        assert found[0, 0] @ front[0] == pytest.approx(1.0, rel=1e-5)


def test_near_and_far_field_and_transport_agree_at_the_centre_with_stray_light(
    tmp_path: Path,
) -> None:
    rng = np.random.default_rng(5)
    stray = {name: rng.normal(size=(3, 3, 4)) * 0.02 for name in BINARY}
    known = measured(rng, stray)
    lights = pattern_lights(session_with(tmp_path, known), BINARY)
    plain = dataclasses.replace(lights, stray_rgb=np.zeros_like(lights.stray_rgb))
    some = np.arange(0, len(octahedral_normals()), 501)
    normals = octahedral_normals()[some]
    centre = np.zeros_like(normals)
    far = np.einsum("npk,nk->np", far_field(lights)[some], normals)
    vectors = irradiance_vectors(lights, centre, normals, no_shadows(len(some), lights))
    near = np.einsum("npk,nk->np", vectors, normals)
    e, _ = transport(lights, centre, normals, normals, 0.3, no_shadows(len(some), lights))
    np.testing.assert_allclose(near, far, atol=2e-6)
    np.testing.assert_allclose(e, far, atol=2e-6)
    dark, _ = transport(plain, centre, normals, normals, 0.3, no_shadows(len(some), lights))
    levels = np.array([pattern_levels(name, RIG) for name in BINARY])
    rgb = known.rgb_gain / np.sum(known.position_mm**2, axis=1)[:, None]
    facing = np.maximum(known.position_mm[:, 2], 0) / np.linalg.norm(known.position_mm, axis=1)
    around = levels @ (rgb / (facing @ rgb)) / 4
    for k, name in enumerate(BINARY):
        for i, n in enumerate(normals):
            each = [n @ (s[:, :3] @ n + s[:, 3]) for s in stray[name]]
            assert e[i, k] - dark[i, k] == pytest.approx(np.mean(around[k] * each), abs=5e-6)


def test_a_parallel_shot_shows_half_the_diffuse_light_and_all_of_the_mirrors() -> None:
    names = ("full", "full@parallel", "full@cross")
    levels = np.stack([pattern_levels(name, RIG) for name in names])
    lights = lights_of(nominal_lamps(RIG), names, levels)
    unpolarised = lights_of(nominal_lamps(RIG), ("a", "b", "c"), levels)
    assert lights.polarised
    assert not unpolarised.polarised
    front = np.array([[0.0, 0.0, 1.0]])
    points = (np.zeros((1, 3)), front, front, 0.3, no_shadows(1, lights))
    e, lobe = transport(lights, *points)
    plain_e, plain_lobe = transport(unpolarised, *points)
    np.testing.assert_allclose(e[0], plain_e[0] * [1, 0.5, 0.5], rtol=1e-6)
    np.testing.assert_allclose(lobe[0], plain_lobe[0] * [1, 1, 0], rtol=1e-6)
    cell = far_field(lights) / np.where(far_field(unpolarised), far_field(unpolarised), 1)
    np.testing.assert_allclose(cell[100, :, 2], [1, 0.5, 0.5])


def test_another_bank_is_refused() -> None:
    with pytest.raises(ProcessingError, match="@parallel, @cross"):
        lights_of(nominal_lamps(RIG), ("x+@left",), np.ones((1, COUNT)))


def coloured_rig() -> Rig:
    """The default rig with red, green and blue lights in turn."""
    return measured_rig(RIG, RIG.positions_mm, np.eye(3)[np.arange(COUNT) % 3])


def test_each_channel_of_coloured_lights_sees_its_own_gradient_under_mux() -> None:
    rig = coloured_rig()
    names = ("mux-1", "mux-2")
    lights = lights_of(nominal_lamps(rig), names, np.stack([pattern_levels(n, rig) for n in names]))
    sides = np.eye(3)
    for c, way in enumerate(sides):
        found = irradiance_vectors(
            lights.channel(c), np.zeros((2, 3)), np.stack([way, -way]), no_shadows(2, lights)
        )
        facing, away = (found[0] @ way, found[1] @ -way)
        assert facing[0] > 3 * facing[1]
        assert away[1] > 3 * away[0]
    assert rank(lights) == 3


def test_mux_of_white_lights_has_no_three_directions() -> None:
    names = ("mux-1", "mux-2")
    levels = np.stack([pattern_levels(n, RIG) for n in names])
    assert rank(lights_of(nominal_lamps(RIG), names, levels)) < 3
    full = np.stack([pattern_levels(n, RIG) for n in BINARY])
    assert rank(lights_of(nominal_lamps(RIG), BINARY, full)) == 3


def test_some_patterns_of_lights_are_those_of_the_whole() -> None:
    levels = np.stack([pattern_levels(n, RIG) for n in BINARY])
    lights = lights_of(nominal_lamps(RIG), BINARY, levels)
    some = lights.of(("z-", "x+"))
    assert some.patterns == ("z-", "x+")
    # A matrix product may add up in another order where it has fewer columns.
    np.testing.assert_allclose(far_field(some), far_field(lights)[:, [6, 1]], atol=1e-13)


def test_light_falls_off_a_lamps_axis_and_none_goes_backward() -> None:
    assert off_axis(0.0, -0.5) == 1.0
    assert off_axis(1.0, 0.25) == 0.25
    assert off_axis(2.0, 0.5) == 0.25
    assert off_axis(0.7, -0.1) == 0.0


@settings(max_examples=40)
@given(
    arrays(float, (COUNT, 3), elements=st.floats(0, 1e6)),
    st.floats(0, 5),
    st.sampled_from([1e-6, 1.0, 1e6]),
)
def test_any_gains_give_finite_light_that_scales_with_them(
    rgb: np.ndarray, exponent: float, scale: float
) -> None:
    rgb[0] += 1.0
    levels = np.stack([pattern_levels(n, RIG) for n in BINARY])
    points = np.array([[0.0, 0, 0], [80, -60, 90], [0, 0, 1.0]])
    normals = np.array([[0.0, 0, 1], [1, 0, 0], [0.6, 0, -0.8]])
    found = []
    for factor in (1.0, scale):
        lamps = Lamps(RIG.positions_mm, rgb * factor, exponent, NO_STRAY, "measured")
        lights = lights_of(lamps, BINARY, levels)
        found.append(irradiance_vectors(lights, points, normals, no_shadows(3, lights)))
    assert np.isfinite(found[0]).all()
    top = np.abs(found[0]).max()
    np.testing.assert_allclose(found[1] / scale, found[0], rtol=1e-4, atol=1e-5 * top)


def test_lights_without_any_in_front_are_refused(tmp_path: Path) -> None:
    known = measured(np.random.default_rng(6))
    gains = known.rgb_gain * (RIG.positions_mm[:, 2] < 0)[:, None]
    session = session_with(tmp_path, dataclasses.replace(known, rgb_gain=gains))
    with pytest.raises((ProcessingError, FormatError), match="faces \\+z"):
        pattern_lights(session, BINARY)


def test_directions_that_are_none_are_in_the_first_cell() -> None:
    none = [[0, 0, 0], [np.nan, 0, 1], [np.inf, 0, 0], [0, -np.inf, 1], [np.inf, -np.inf, 0]]
    assert (cells_of(np.array(none)) == 0).all()
