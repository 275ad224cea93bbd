"""Lamps that lie under a pattern of one lamp are found; good ones pass."""

import dataclasses

import numpy as np
import pytest

from lightstage.checks import ShotChecks, measure_photo
from lightstage.patterns import drive_levels
from lightstage.rig import Rig, default_rig
from lightstage.sequence import Shot
from sim.devices.coded_photographer import CodedPhotographer

STUCK = (3, 20, 41, 77, 102, 140)
COUNT = 60
BAD = "olat-021"


@pytest.fixture(scope="module")
def coded(tmp_path_factory):
    """Coded photographs of 48 x 64 pixels by three cameras: a function of levels."""
    whole = default_rig()
    chosen = [camera for camera in whole.cameras if camera.id in ("cam0", "cam1", "cam4")]
    small = [
        dataclasses.replace(camera.scaled(0.01), width_px=48, height_px=64) for camera in chosen
    ]
    rig = Rig(whole.lights, tuple(small))
    photographer = CodedPhotographer(rig, 3)
    path = tmp_path_factory.mktemp("coded") / "a.dng"

    def see(camera, levels):
        path.write_bytes(photographer.photograph(camera, photographer.lit(levels)))
        return measure_photo(path)

    names = ["full", *(f"olat-{k:03d}" for k in range(COUNT))]
    levels = {name: drive_levels(name, rig) for name in names}
    clean = {(n, c.id): see(c, levels[n]) for n in names for c in rig.cameras}
    return rig, levels, clean, see


def findings(coded, name=None, shone=None, last=None):
    rig, levels, clean, see = coded
    checks = ShotChecks(rig, [Shot(n, level) for n, level in levels.items()])
    out = []
    for pattern in sorted(levels, key=lambda each: each == last):
        for camera in rig.cameras:
            bad = see(camera, shone) if pattern == name else clean[pattern, camera.id]
            out += checks.add(pattern, camera.id, bad)
        out += checks.shot(pattern)
    return out


def test_a_session_of_sixty_single_lights_passes(coded):
    assert findings(coded) == []


def test_lamps_stuck_on_under_a_single_light_are_found(coded):
    levels = coded[1][BAD].copy()
    levels[list(STUCK)] = 1.0
    found = findings(coded, BAD, levels)
    assert {(f.code, f.pattern, f.camera) for f in found} == {("wrong-light", BAD, None)}


def test_a_neighbour_that_shines_instead_is_found(coded):
    """Banks swapped: the lamp beside it, 12.9 degrees away, shines."""
    levels = coded[1]
    found = findings(coded, "olat-040", levels["olat-041"], last="olat-040")
    assert {(f.code, f.pattern, f.camera) for f in found} == {("wrong-light", "olat-040", None)}
    assert "lamp 41" in found[0].found


def test_a_dead_light_is_found_under_its_own_pattern(coded):
    found = findings(coded, BAD, np.zeros(len(coded[0].lights)))
    assert {f.pattern for f in found} == {BAD}
    assert {f.code for f in found} == {"not-lit"}


def test_a_single_light_of_a_person_passes_and_five_more_lamps_are_found(stages):
    for stage in stages.values():
        assert stage.found(("full", *stage.lamps), stage.photo) == []
    stage = stages["light"]
    lit = max(stage.lamps, key=lambda name: float(stage.see("cam1", name).mean()))
    dim = min(stage.lamps, key=lambda name: float(stage.see("cam1", name).mean()))

    def stuck(camera, pattern):
        more = 5 * stage.see(camera, lit) * np.float32(pattern == dim)
        return stage.expose(camera, stage.see(camera, pattern) + more)

    found = stage.found(("full", *stage.lamps), stuck)
    assert {(f.code, f.pattern) for f in found} == {("wrong-light", dim)}
