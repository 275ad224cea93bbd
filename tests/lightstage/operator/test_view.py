"""The view stands as the journal says, and the same lines always give the same view."""

import itertools

import pytest

from lightstage.operator.view import View


def shown(lines):
    view = View("S")
    for line in lines:
        view.receive(line)
    return view


def standing(view):
    cameras = {name: vars(camera) for name, camera in view.cameras.items()}
    return (view.marks, view.takes, view.done, view.phase, view.pattern, cameras, view.left_s())


def test_a_whole_capture_is_complete_in_the_end(replay):
    view = shown(replay)
    assert view.phase == "complete"
    assert view.kept == view.wanted == 63
    assert view.left_s() == 0
    assert view.takes["y+", "cam4"] == 2
    assert view.lights == "168 lamps, firmware stage 1.4, boot 4711"
    assert view.acknowledged is True
    assert [camera.serial for camera in view.cameras.values()][:2] == ["6012305", "6012315"]
    assert not [words for words in view.news if words.tone == "problem"]  # it was mended


def test_each_step_of_a_shot_is_seen(story):
    journal = story(3)
    journal.begin()
    view = shown(journal.lines)

    def states():
        for line in journal.lines[view.last_id :]:
            view.receive(line)
        return [camera.state for camera in view.cameras.values()]

    assert states() == ["idle"] * 3
    journal.light("full", cameras=["cam0", "cam1"])
    assert states() == ["triggering", "triggering", "idle"]
    assert view.pattern == "full"
    journal.expose("full", "cam0")
    assert states() == ["downloading", "triggering", "idle"]
    journal.keep("full", "cam0")
    journal.add("failed", pattern="full", camera="cam1", take=1, said="gone")
    assert states() == ["kept", "failed", "idle"]
    assert view.marks == {"full": {"cam0": "kept", "cam1": "failed"}}
    journal.add("note", camera="cam1", said="restarting")
    assert states()[1] == "restarting"
    journal.add("note", camera="cam1", said="started again")
    assert states()[1] == "idle"


def test_a_rejected_take_does_not_count(story):
    journal = story(2)
    journal.begin()
    journal.shoot("full")
    journal.add("rejected", pattern="full", camera="cam1", take=1, why="blurred")
    view = shown(journal.lines)
    assert view.kept == 1
    assert view.marks["full"]["cam1"] == "again"
    assert view.done == set()


def test_a_retake_is_told_beside_the_first_take(story):
    journal = story(2)
    journal.begin()
    journal.shoot("full")
    journal.add("rejected", pattern="full", camera="cam1", take=1, why="blurred")
    journal.light("full", 2, ["cam1"])
    journal.keep("full", "cam1", 2)
    journal.add("shot", pattern="full")
    view = shown(journal.lines)
    assert view.kept == 2
    assert view.takes == {("full", "cam1"): 2}


def test_time_left_is_that_of_the_shots_so_far(story):
    journal = story(2)
    journal.begin()
    assert shown(journal.lines).left_s() is None
    for pattern in journal.patterns[:4]:
        journal.shoot(pattern)
    first = next(line["elapsed_s"] for line in journal.lines if line["event"] == "lit")
    shots = [first] + [line["elapsed_s"] for line in journal.lines if line["event"] == "shot"]
    gaps = sorted(after - before for before, after in itertools.pairwise(shots))
    wanted = 3 * (gaps[1] + gaps[2]) / 2
    assert abs(shown(journal.lines).left_s() - wanted) < 1e-9


def test_one_slow_shot_or_a_pause_does_not_change_the_time_left(story):
    journal = story(2)
    journal.begin()
    for pattern in journal.patterns[:3]:
        journal.shoot(pattern)
    each_s = shown(journal.lines).left_s() / 4
    journal.add("note", said="paused, the lights are dark")
    journal.s += 3600
    journal.shoot(journal.patterns[3])
    assert abs(shown(journal.lines).left_s() - 3 * each_s) < 1.0


def test_a_shot_in_which_a_camera_failed_is_no_measure_where_there_is_another(story):
    journal = story(2)
    journal.begin()
    journal.light("full")
    journal.keep("full", "cam0")
    journal.s += 25.0  # it is started again
    journal.not_taken("full", "cam1", "it is gone")
    journal.light("full", 2, ["cam1"])
    journal.keep("full", "cam1", 2)
    journal.add("shot", pattern="full")
    assert shown(journal.lines).left_s() > 6 * 25.0
    journal.shoot("x+")
    assert shown(journal.lines).left_s() < 5 * 3.0


def test_a_resumed_capture_goes_on_from_what_is_kept(story):
    journal = story(2)
    journal.begin()
    journal.shoot("full")
    journal.light("x+")
    journal.keep("x+", "cam0")
    journal.add("aborted", said="Ctrl-C")
    view = shown(journal.lines)
    assert view.phase == "aborted"
    assert view.pattern is None
    journal.s = 0.0
    journal.add("resume", schema="lightstage.journal/2")
    journal.light("x+", 2, ["cam1"])
    journal.keep("x+", "cam1", 2)
    journal.add("shot", pattern="x+")
    view = shown(journal.lines)
    assert view.phase == "running"
    assert view.kept == 4
    assert view.left_s() > 0


def test_a_capture_killed_in_the_middle_has_nothing_under_way_after_its_resume(story):
    journal = story(2)
    journal.begin()
    journal.light("full")
    journal.add("resume")
    view = shown(journal.lines)
    assert view.marks == {"full": {"cam0": "again", "cam1": "again"}}
    assert {camera.state for camera in view.cameras.values()} == {"idle"}


def test_a_card_loses_what_is_put_on_it(story):
    journal = story(1)
    journal.begin()
    journal.shoot("full")
    free = shown(journal.lines).cameras["cam0"].card_free_bytes
    assert free == 61_000_000_000 - 24_300_000


def test_a_replay_gives_what_was_seen_live(replay):
    live = View("S")
    for count, line in enumerate(replay, 1):
        live.receive(line)
        assert standing(live) == standing(shown(replay[:count]))


def test_lights_that_do_not_acknowledge_are_known(story):
    journal = story(1)
    journal.begin()
    journal.add("lit", pattern="full", acknowledged=False)
    assert shown(journal.lines).acknowledged is False


def test_the_time_that_somebody_thinks_is_no_measure_of_what_is_left(story):
    journal, quick = story(2), story(2)
    for each, thinks_s in ((journal, 900.0), (quick, 0.0)):
        each.begin()
        each.shoot("full")
        each.light("x+")
        each.add("asked", pattern="x+")
        each.add("answered", thinks_s, pattern="x+", do="retake")
        each.shoot("x+")
    left = []
    for each in (journal, quick):
        view = View()
        for line in each.lines:
            view.receive(line)
        left.append(view.left_s())
    assert left[0] == pytest.approx(left[1])


def test_the_time_for_which_a_camera_that_hangs_is_waited_for_is_counted_and_no_measure(story):
    journal, quick = story(2), story(2)
    for each, hangs_s in ((journal, 30.0), (quick, 0.0)):
        each.begin()
        each.light("full")
        each.add("waiting", 1.0, pattern="full", cameras=["cam1"], lit=False, ended_in_s=hangs_s)
        each.add("lit", hangs_s, pattern="full")
        each.add("shot", pattern="full")
    views = [View(), View()]
    for view, each in zip(views, (journal, quick), strict=True):
        for line in each.lines:
            view.receive(line)
    assert views[0].left_s() == pytest.approx(views[1].left_s())
    usual_s = views[0].left_s()
    views[0].receive(
        journal.add("waiting", pattern="x+", cameras=["cam1"], lit=False, ended_in_s=30.0)
    )
    assert views[0].left_s() == pytest.approx(usual_s + 30.0, abs=2.0)


def test_a_kept_photograph_that_is_asked_about_is_in_question_until_it_is_decided(story):
    journal = story(2)
    journal.begin()
    journal.light("full")
    journal.keep("full", "cam0")
    journal.keep("full", "cam1")
    journal.add("finding", severity="retake", code="blur", pattern="full", camera="cam1", found="x")
    views = [View(), View()]
    for view in views:
        for line in journal.lines:
            view.receive(line)
        assert [view.mark("full", camera) for camera in view.cameras] == ["kept", "in question"]
        assert view.cameras["cam1"].state == "in question"
        assert view.kept == 2
    views[0].receive(journal.add("accepted", pattern="full", findings=[{}]))
    assert (views[0].mark("full", "cam1"), views[0].cameras["cam1"].state) == ("accepted", "kept")
    views[1].receive(journal.add("rejected", pattern="full", camera="cam1", take=1))
    assert views[1].mark("full", "cam1") == "again"


def test_what_holds_only_while_a_capture_runs_is_not_said_at_its_end(story):
    journal = story(2)
    journal.begin()
    journal.add("note", said="others can follow", socket="/run/1.sock")
    journal.add("note", camera="cam0", said="restarting")
    view = View()
    for line in journal.lines:
        view.receive(line)
    assert ["follow" in words.text for words in view.news if words.text][-1]
    assert not any("restarting" in words.text for words in view.news)
    view.receive(journal.add("aborted", said="Stopped by the operator."))
    assert not any("follow" in words.text for words in view.news)
    assert any("Stopped" in words.text for words in view.news)
    view.receive(journal.add("resume"))
    assert not any("Stopped" in words.text for words in view.news)


def test_while_a_question_waits_it_is_dark_and_waits_for_the_operator(story):
    journal = story(2)
    journal.begin()
    journal.light("x+")
    journal.add("asked", pattern="x+")
    view = View()
    for line in journal.lines:
        view.receive(line)
    assert (view.phase, view.pattern) == ("asked", None)
    view.receive(journal.add("answered", pattern="x+", do="retake"))
    assert view.phase == "running"


def test_what_was_accepted_is_no_news_once_its_photograph_is_taken_again(story):
    journal = story(1)
    journal.begin()
    journal.light("full", cameras=["cam0"])
    journal.expose("full", "cam0")
    journal.keep("full", "cam0")
    journal.add(
        "finding", severity="warn", code="clipped", pattern="full", camera="cam0", found="x"
    )
    journal.add("accepted", pattern="full", findings=[{"code": "clipped"}])
    journal.add("end", frames=1, capture={"accepted": 1, "accepted_findings": 1})
    view = shown(journal.lines)
    assert [words.tone for words in view.news].count("warning") == 2
    journal.add("resume")
    journal.add("retake", takes=[["full", "cam0", 1]])
    view = shown(journal.lines)
    assert not any(words.tone == "warning" for words in view.news)
    assert not any("complete" in words.text for words in view.news)
    assert view.mark("full", "cam0") == "again"


def test_a_question_about_the_same_pattern_is_counted(story):
    journal = story(1)
    journal.begin()
    for times in (1, 2):
        journal.light("full", cameras=["cam0"])
        journal.add("asked", pattern="full", findings=[])
        view = shown(journal.lines)
        assert (view.asked, view.asked_times, view.shown) == ("full", times, "full")
        journal.add("answered", pattern="full", do="retake")
    assert shown(journal.lines).asked == ""
