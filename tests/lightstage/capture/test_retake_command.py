"""`lightstage retake`: what is refused before a device is opened."""

import dataclasses

import pytest

from lightstage.sequence import plan_shots
from lightstage.session import SessionPlan, SessionWriter
from tests.lightstage.capture.fakes import TOLD


@pytest.fixture
def session(tmp_path, small_rig):
    """A session of one pattern that was begun with a consent."""
    levels = {s.pattern: s.levels.tolist() for s in plan_shots(["full"], small_rig, "on-off")}
    plan = SessionPlan(tuple(levels), "P07", levels=levels, consent="C-1")
    facts = {"told": {"cam0": dataclasses.asdict(TOLD)}, "led_device": {}}
    SessionWriter.new(tmp_path / "S", small_rig, plan, facts=facts).close()
    return tmp_path / "S"


def test_a_person_whose_consent_was_withdrawn_is_not_photographed_again(
    session, tmp_path, run_command, monkeypatch
):
    registry = tmp_path / "consents.toml"
    words = ["retake", session, "full", "--leds", "serial:///dev/null-none"]
    consent = 'schema = "lightstage.consents/1"\n[[consent]]\nid = "C-1"\npurposes = ["capture"]\n'
    registry.write_text(consent + 'withdrawn = "2026-01-01"\n')
    monkeypatch.setenv("LIGHTSTAGE_CONSENTS", str(registry))
    refused = run_command("lightstage", *words)
    assert refused.code == 2
    assert f"{registry}, purpose capture: found C-1 (P07) was withdrawn" in refused.err
    registry.write_text(consent)
    allowed = run_command("lightstage", *words)
    assert "C-1" not in allowed.err
    assert "/dev/null-none" in allowed.err  # only the device is missing
