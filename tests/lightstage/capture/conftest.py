"""A stage of recording devices and a session on a real disk."""

import dataclasses
from pathlib import Path

import pytest

from lightstage.cameras.process import Deadlines
from lightstage.capture.camera_shot import Photographer
from lightstage.capture.config import CaptureConfig
from lightstage.capture.run import CaptureReport, Run
from lightstage.preflight import PreflightConfig
from lightstage.safety import SafetyConfig
from lightstage.sequence import plan_shots
from lightstage.session import SessionPlan, SessionWriter, read_journal
from tests.lightstage.capture.fakes import (
    TOLD,
    FakeCamera,
    Lights,
    ScriptedChecks,
    ScriptedOperator,
)

FAST = CaptureConfig(
    trigger_lead_s=0.0,
    deadlines=Deadlines.all(5.0),
    safety=SafetyConfig(light_interval_s=0.0),
    preflight=PreflightConfig(max_trigger_skew_s=60.0),
)


@dataclasses.dataclass
class Bench:
    """Everything that a run needs."""

    root: Path
    rig: object
    log: list[str]
    lights: Lights
    cameras: list[FakeCamera]
    shots: tuple
    writer: SessionWriter
    checks: ScriptedChecks
    operator: ScriptedOperator
    config: CaptureConfig = FAST

    def run(self, before=None) -> CaptureReport:
        """Take what is wanted."""
        cards = {camera.id: camera.card() for camera in self.cameras}
        summaries = {camera.id: camera.open() for camera in self.cameras}
        photographer = Photographer(
            self.rig, self.writer, self.checks, self.config, summaries, cards
        )
        run = Run(
            self.shots, self.writer.state.wanted(), self.cameras, self.lights, photographer,
            self.writer, self.checks, self.operator, self.config, before,
        )  # fmt: skip
        return run.take_all()

    def events(self, *kinds: str) -> list[dict]:
        """Lines of the journal of these kinds."""
        lines = read_journal(self.root / "journal.jsonl")
        return [line for line in lines if line["event"] in kinds]

    def kept(self, pattern: str) -> list[str]:
        """Names of a pattern's files, hidden ones too; none where nothing came to be kept."""
        folder = self.root / "frames" / pattern
        return sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []


@pytest.fixture
def bench(tmp_path, small_rig, dng):
    log: list[str] = []
    lights = Lights(log)
    cameras = [FakeCamera(camera.id, log, lights, dng) for camera in small_rig.cameras]
    shots = plan_shots(["full", "x+", "x-"], small_rig, "on-off")
    root = tmp_path / "S"
    plan = SessionPlan(
        tuple(shot.pattern for shot in shots),
        levels={shot.pattern: shot.levels.tolist() for shot in shots},
    )
    writer = SessionWriter.new(
        root, small_rig, plan, facts={"told": {"cam0": dataclasses.asdict(TOLD)}}
    )
    yield Bench(
        root, small_rig, log, lights, cameras, shots, writer, ScriptedChecks(), ScriptedOperator()
    )
    writer.close()
