"""kill -9 at every step of a capture: nothing lost, doubled or mislabelled, and the lights dark.

Real processes, SIGKILL, the command as a user runs it. Here each step meets each process that can
die at it once; benchmarks/kill_matrix.py has every shot, all at once, and those who die twice.
"""

import itertools

import pytest

from lightstage.formats.session import load_session
from lightstage.session import read_journal
from lightstage.steps import STEPS
from sim.devices.kill_trial import DARK_S, KillTrial
from sim.devices.kills import CAMERA_STEPS, DELETING, SEQUENCE, Kill, matrix

PATTERNS = itertools.cycle(SEQUENCE)
ONCE = [
    *(
        kill
        for step in STEPS
        for kill in matrix((next(PATTERNS),), ("camera", "capture"))
        if kill.step == step
        and (kill.who == "capture" or step in CAMERA_STEPS)
        and kill.event in ("", "begin", "exposed", "frame")
    ),
    Kill("downloaded", "all", "x+", "cam1"),
    Kill("journaled", "all", "x-", "cam0"),
    Kill("exposed", "camera", "full", "cam2"),
    Kill("hashed", "camera", "x-", "cam2"),
]


def test_the_cases_here_hold_every_step_and_every_process():
    assert {kill.step for kill in ONCE} == set(STEPS)
    for step in STEPS:
        whos = {kill.who for kill in ONCE if kill.step == step}
        assert whos >= ({"capture", "camera"} if step in CAMERA_STEPS else {"capture"})
    assert {kill.pattern for kill in ONCE} >= set(SEQUENCE)


@pytest.mark.parametrize("kill", ONCE, ids=str)
def test_a_killed_capture_goes_on_with_nothing_lost_doubled_or_mislabelled(tmp_path, kill):
    outcome = KillTrial(tmp_path, delete=kill.step in DELETING).run([kill])
    assert outcome.faults == ()
    assert outcome.killed == 1
    assert outcome.dark_after_s < DARK_S


@pytest.mark.parametrize(
    "kills",
    [
        (Kill("downloaded", "capture", "x+"), Kill("named", "capture", "x+")),
        (Kill("folder-flushed", "capture", "x+"), Kill("line-half-written", "all", event="resume")),
        (Kill("triggered", "all", "full"), Kill("session-written", "capture")),
    ],
    ids=lambda kills: " then ".join(map(str, kills)),
)
def test_one_killed_again_while_it_goes_on_does_no_worse(tmp_path, kills):
    outcome = KillTrial(tmp_path).run(kills)
    assert outcome.faults == ()
    assert outcome.killed == 2


@pytest.mark.parametrize(
    "kill",
    [
        Kill("line-half-written", "capture", event="retake"),
        Kill("triggered", "all", "x+", "cam1"),
        Kill("session-written", "capture"),
    ],
    ids=str,
)
def test_a_killed_retake_loses_nothing_and_its_second_call_finishes(tmp_path, kill):
    trial = KillTrial(tmp_path)
    outcome = trial.run([kill], retake="x+")
    assert outcome.faults == ()
    assert outcome.killed == 1
    assert outcome.dark_after_s < DARK_S
    lines = read_journal(trial.root / "journal.jsonl")
    assert [line["event"] for line in lines].count("retake") >= 1
    takes = {frame.path for frame in load_session(trial.root).file.frames if frame.pattern == "x+"}
    assert len(takes) == len(trial.rig.cameras)
    assert all(".take" in path for path in takes)
    # The takes of before are still there.
    there = {path.name for path in (trial.root / "frames/x+").iterdir()}
    assert there >= {f"{camera.id}.dng" for camera in trial.rig.cameras}
