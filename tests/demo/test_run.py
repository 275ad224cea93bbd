"""The demo stops at the first step that fails, and touches no folder of somebody else's."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from demo import run as demo_run
from demo.steps import DemoConfig, Layout, Step, steps
from demo.tiny import tiny_config
from lightstage.errors import LightstageError
from lightstage.rig import load_rig


def planned(*arguments: tuple[str, ...]) -> object:
    def plan(config: DemoConfig, at: Layout) -> Iterator[Step]:
        for number, words in enumerate(arguments):
            yield Step(f"step {number}", "a step", words)

    return plan


def test_a_failing_step_stops_the_demo_with_its_status(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    bad = ("json.tool", str(tmp_path / "absent.json"))
    monkeypatch.setattr(demo_run, "steps", planned(("this",), bad, ("this",)))
    assert demo_run.run(DemoConfig("lps"), tmp_path / "demo") not in (0, 130)
    printed = capfd.readouterr()
    assert "absent.json" in printed.err
    assert "step 1 ended with status" in printed.err
    done = json.loads((tmp_path / "demo" / "steps.json").read_text())["steps"]
    assert [step["name"] for step in done] == ["step 0"]
    assert done[0]["seconds"] > 0
    assert done[0]["peak_mb"] > 1
    assert not (tmp_path / "demo" / "report.html").exists()


def test_an_earlier_demo_is_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo_run, "steps", planned(("json.tool", str(tmp_path / "no"))))
    demo_run.run(DemoConfig("lps"), tmp_path / "demo")
    (tmp_path / "demo" / "old").touch()
    demo_run.run(DemoConfig("lps"), tmp_path / "demo")
    assert not (tmp_path / "demo" / "old").exists()


def test_a_folder_that_no_demo_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "letter.txt").write_text("dear")
    with pytest.raises(LightstageError, match="no demo made"):
        demo_run.run(DemoConfig("lps"), tmp_path)
    assert (tmp_path / "letter.txt").read_text() == "dear"


def test_a_tiny_demo_writes_into_its_folder_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(demo_run, "steps", planned(("json.tool", str(tmp_path / "no"))))
    demo_run.run(tiny_config(), tmp_path / "demo")
    assert [path.name for path in tmp_path.iterdir()] == ["demo"]
    rig = load_rig(tmp_path / "demo" / "rig.json")
    assert (len(rig.cameras), len(rig.lights)) == (5, 42)


@pytest.mark.parametrize(("subject", "quick"), [(None, True), ("lps", False)])
def test_a_tiny_demo_refuses_options_that_it_would_ignore(
    tmp_path: Path, subject: str | None, quick: bool
) -> None:
    with pytest.raises(LightstageError, match="--tiny: found"):
        demo_run.main(tmp_path / "demo", subject, quick, tiny=True)
    assert not (tmp_path / "demo").exists()


def test_paths_with_spaces_stay_one_argument(tmp_path: Path) -> None:
    at = Layout(tmp_path / "my demo")
    (at.processed / "views").mkdir(parents=True)
    first = next(iter(steps(DemoConfig("parametric", tiny_rig=True), at)))
    assert str(at.session) in first.arguments
    assert first.arguments[first.arguments.index("--rig") + 1] == str(at.rig)


def test_every_step_runs_one_of_the_packages(tmp_path: Path) -> None:
    at = Layout(tmp_path)
    (at.processed / "views").mkdir(parents=True)
    (at.truth / "relit").mkdir(parents=True)
    (at.truth / "relit" / "key.json").touch()
    plan = list(steps(DemoConfig("lps"), at))
    assert {step.arguments[0] for step in plan} == {"sim", "lightstage", "processing", "learning"}
    assert len({step.name for step in plan}) == len(plan) >= 13
