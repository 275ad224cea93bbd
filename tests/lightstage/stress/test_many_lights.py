"""A stage of 10,000 lights and three cameras, from lighting to the finished session."""

import dataclasses

import numpy as np

from lightstage.formats.session import load_session
from lightstage.rig import Light, Rig, save_rig

COUNT = 10_000
SEQUENCE = "full,x+,x-,olat-9999"


def many_lights(rig: Rig) -> Rig:
    """Lights evenly over the sphere, as sunflowers set their seeds."""
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(COUNT)
    y = 1 - 2 * (np.arange(COUNT) + 0.5) / COUNT
    around = np.sqrt(1 - y**2)
    places = 1250 * np.stack([around * np.sin(turn), y, around * np.cos(turn)], axis=1)
    lights = [
        Light(i, f"seed{i}", tuple(place), "horizontal" if i % 2 else "vertical")
        for i, place in enumerate(places.tolist())
    ]
    return dataclasses.replace(rig, lights=tuple(lights))


def test_ten_thousand_lights_are_driven_acknowledged_and_recorded(tmp_path, tools):
    rig = many_lights(tools.small_rig(3))
    with tools.bench_of(tmp_path, rig) as bench:
        done = bench.run(sequence=SEQUENCE)
        assert done.returncode == 0, done.stderr
        assert bench.stage.device.dark
        labels = bench.stage.labels(bench.out)
        assert labels == dataclasses.replace(type(labels)(), right=12)
        session = load_session(bench.out)
        lit = [state.counts for state in bench.stage.device.states if state.counts.any()]
        for pattern, counts in zip(SEQUENCE.split(","), lit, strict=True):
            assert len(counts) == COUNT
            levels = session.levels(pattern)
            assert np.array_equal(np.round(levels * 65535).astype(np.uint16), counts)
        half = session.levels("x+") + session.levels("x-")
        np.testing.assert_allclose(half, session.levels("full"), atol=1 / 65535)
        assert np.flatnonzero(session.levels("olat-9999")).tolist() == [9999]


def test_a_device_of_another_count_of_lights_is_reported(tmp_path, tools):
    rig = many_lights(tools.small_rig(1))
    with tools.bench_of(tmp_path, rig) as bench:
        fewer = dataclasses.replace(rig, lights=rig.lights[:-1])
        save_rig(fewer, bench.stage.rig_path)
        message = tools.message(bench.run(sequence="full"), "DeviceError")
        assert "LED device, lamp count: found 10000, expected 9999 (rig.json)" in message
        assert "Is this the rig file of this stage?" in message
        assert not bench.out.exists()
