"""kill -9 at every step of a capture: nothing lost, doubled or mislabelled, and the lights dark.

Real processes, SIGKILL, the command as a user runs it. Here each step meets each process that can
die at it once, several in one session; benchmarks/kill_matrix.py has every shot, all at once.
"""

import itertools

import pytest

from lightstage.formats.session import load_session
from lightstage.session import read_journal
from lightstage.steps import STEPS
from sim.devices.kill_trial import DARK_S, KillTrial
from sim.devices.kills import CAMERA_STEPS, DELETING, SEQUENCE, SESSION_STEPS, Kill, matrix

pytestmark = pytest.mark.usefixtures("forked")

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


def in_turn(kills: list[Kill]) -> list[tuple[Kill, ...]]:
    """Kills that one session can meet in turn, at most one at each pattern.

    A capture whose camera died ends by itself, so that nothing can be killed after that.
    """
    begin = [kill for kill in kills if kill.event == "begin"]
    end = [kill for kill in kills if kill.step in SESSION_STEPS]
    alone = [kill for kill in kills if kill.who == "camera"]
    rest = [kill for kill in kills if kill not in (*begin, *end, *alone)]
    by_pattern = [[kill for kill in rest if kill.pattern == name] for name in SEQUENCE]
    rows = itertools.zip_longest(begin, *by_pattern, end)
    return [tuple(filter(None, row)) for row in rows] + [(kill,) for kill in alone]


def in_words(kills: tuple[Kill, ...]) -> str:
    return " then ".join(map(str, kills))


def test_every_case_is_met_once():
    assert sorted(map(str, itertools.chain(*in_turn(ONCE)))) == sorted(map(str, ONCE))


@pytest.mark.parametrize("kills", in_turn(ONCE), ids=in_words)
def test_a_killed_capture_goes_on_with_nothing_lost_doubled_or_mislabelled(tmp_path, kills):
    delete = any(kill.step in DELETING for kill in kills)
    outcome = KillTrial(tmp_path, delete=delete).run(kills)
    assert outcome.faults == ()
    assert outcome.killed == len(kills)
    assert outcome.dark_after_s < DARK_S


@pytest.mark.parametrize(
    "kills",
    [
        (Kill("downloaded", "capture", "x+"), Kill("named", "capture", "x+")),
        (Kill("folder-flushed", "capture", "x+"), Kill("line-half-written", "all", event="resume")),
    ],
    ids=in_words,
)
def test_one_killed_again_while_it_goes_on_does_no_worse(tmp_path, kills):
    outcome = KillTrial(tmp_path).run(kills)
    assert outcome.faults == ()
    assert outcome.killed == 2


def test_a_retake_that_is_killed_three_times_loses_nothing_and_the_next_call_finishes(tmp_path):
    kills = (
        Kill("line-half-written", "capture", event="retake"),
        Kill("triggered", "all", "x+", "cam1"),
        Kill("session-written", "capture"),
    )
    trial = KillTrial(tmp_path)
    outcome = trial.run(kills, retake="x+")
    assert outcome.faults == ()
    assert outcome.killed == 3
    assert outcome.dark_after_s < DARK_S
    lines = read_journal(trial.root / "journal.jsonl")
    assert [line["event"] for line in lines].count("retake") >= 1
    takes = {frame.path for frame in load_session(trial.root).file.frames if frame.pattern == "x+"}
    assert len(takes) == len(trial.rig.cameras)
    assert all(".take" in path for path in takes)
    # The takes of before are still there.
    there = {path.name for path in (trial.root / "frames/x+").iterdir()}
    assert there >= {f"{camera.id}.dng" for camera in trial.rig.cameras}
