"""Who decides: the rule without anybody, and requests that are neither lost nor contradictory."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.errors import ConfigError, DeviceError
from lightstage.findings import Finding
from lightstage.formats.config import make_config
from lightstage.operator import OperatorConfig, Unattended, Wish
from lightstage.operator.attendance import Request, Requests, by_rule

BAD = Finding("retake", "blur", "x+ by cam0", "blurred", "sharp", pattern="x+", camera="cam0")
LOOK = Finding("warn", "dim", "x+ by cam0", "dim", "bright")
MISSING = Finding("retake", "not-taken", "x+ by cam0", "no answer", "a photograph")


def test_without_anybody_it_retakes_while_it_may_and_then_gives_up():
    nobody = Unattended(OperatorConfig(retakes=2))
    assert [nobody.decide([BAD], left) for left in (2, 1, 0)] == ["retake", "retake", "abort"]


@pytest.mark.parametrize(
    ("findings", "left", "then", "decision"),
    [
        ([LOOK], 0, "abort", "accept"),
        ([], 0, "abort", "accept"),
        ([LOOK, BAD], 1, "accept", "retake"),
        ([BAD], 0, "accept", "accept"),
        ([BAD, MISSING], 0, "accept", "abort"),
        ([BAD], 0, "abort", "abort"),
    ],
)
def test_the_rule(findings, left, then, decision):
    assert by_rule(findings, left, OperatorConfig(then=then)) == decision


def test_the_rule_comes_from_a_file_and_a_wrong_one_is_refused():
    config = make_config(OperatorConfig, {"retakes": 5, "then": "accept"}, "x.toml")
    assert config == OperatorConfig(5, "accept")
    with pytest.raises(ConfigError, match="then"):
        make_config(OperatorConfig, {"then": "shrug"}, "x.toml")


def test_an_abort_darkens_the_lights_before_anybody_who_waits_is_answered():
    requests, order = Requests(), []
    requests.at_abort(lambda: order.append("dark"))

    def wait():
        order.append(requests.ask(("retake", "accept", "abort")))

    waiting = threading.Thread(target=wait)
    waiting.start()
    while requests.possible != ("retake", "accept", "abort"):
        pass
    assert requests.request("abort") is None
    waiting.join(10)
    assert order == ["dark", "abort"]
    assert requests.command() == Wish("abort")
    assert requests.command() == Wish("abort")
    assert requests.request("abort") is None
    assert order == ["dark", "abort"]


def test_lights_that_fail_at_an_abort_do_not_swallow_it():
    requests, others = Requests(), []

    def fail():
        raise DeviceError("lights", found="silence")

    requests.at_abort(fail)
    requests.at_abort(lambda: others.append("done"))
    assert requests.request("abort") is None
    assert others == ["done"]
    assert requests.command() == Wish("abort")


def test_who_comes_after_the_abort_acts_at_once():
    requests, acted = Requests(), []
    requests.request("abort")
    requests.at_abort(lambda: acted.append("dark"))
    assert acted == ["dark"]


@pytest.mark.parametrize(
    ("lines", "asked", "do", "why"),
    [
        ([], [], "retake", "no pattern is done yet"),
        (["shot"], ["retake"], "retake", "asked for already"),
        ([], [], "accept", "nothing waits"),
        ([], [], "resume", "not paused"),
        (["shot"], ["pause"], "pause", "paused already"),
        ([], ["abort"], "pause", "ending"),
        (["end"], [], "pause", "ending"),
        (["aborted"], [], "abort", "over"),
        ([], [], "explode", "unknown: 'explode'"),
        ([], [], "x" * 1000, "unknown"),
    ],
)
def test_what_makes_no_sense_is_refused_with_the_reason(lines, asked, do, why):
    requests = Requests()
    for event in lines:
        requests.receive({"event": event})
    for each in asked:
        assert requests.request(each) is None
    assert why in requests.request(do)


@pytest.mark.parametrize("again", ["resume", "begin"])
@pytest.mark.parametrize("ended", ["aborted", "end"])
def test_a_resumed_session_and_the_next_pose_hear_what_is_asked_for(again, ended):
    """Lines of the earlier run, its end among them, are received before those of this one."""
    requests, acted = Requests(), []
    for event in ("begin", "lit", "shot", ended, again, "lit"):
        requests.receive({"event": event, "pattern": "x+", "sequence": ["x+", "x-"]})
    requests.at_abort(lambda: acted.append("dark"))
    assert "abort" in requests.possible
    assert requests.request("pause") is None
    with ThreadPoolExecutor(1) as pool:
        answer = pool.submit(requests.ask, ("retake", "accept", "abort"))
        until = time.monotonic() + 10
        while requests.request("accept") is not None and time.monotonic() < until:
            time.sleep(0.01)
        assert answer.result(10) == "accept"
    assert requests.request("abort") is None
    assert acted == ["dark"]


def test_wishes_come_in_their_order():
    requests = Requests()
    requests.receive({"event": "shot"})
    for do in ("retake", "pause"):
        assert requests.request(do) is None
    assert [requests.command() for _ in range(3)] == [Wish("retake"), Wish("pause"), None]
    for do in ("resume", "retake", "pause"):
        assert requests.request(do) is None
    wishes = [Wish("resume"), Wish("retake"), Wish("pause"), None]
    assert [requests.command() for _ in range(4)] == wishes
    assert requests.possible == ("retake", "resume", "abort")


def test_a_retake_is_of_the_pattern_that_is_named_or_was_shown_last():
    requests = Requests()
    for event, pattern in (("lit", "full"), ("shot", "full"), ("lit", "x+")):
        requests.receive({"event": event, "pattern": pattern})
    assert requests.request("retake", "full") is None
    assert requests.request("retake", "full") == "it is asked for already"
    assert requests.request("retake") is None
    assert "no pattern 'y+' was taken" in requests.request("retake", "y+")
    # In the gap before the next light, the one that was shown is meant, not the next one.
    requests.receive({"event": "shot", "pattern": "x+"})
    assert requests.shown == "x+"
    wishes = [Wish("retake", "full"), Wish("retake", "x+"), None]
    assert [requests.command() for _ in range(3)] == wishes


def test_a_retake_that_comes_after_the_last_pattern_is_refused_and_not_forgotten():
    requests = Requests()
    requests.receive({"event": "begin", "sequence": ["full", "x+"]})
    for pattern in ("full", "x+"):
        requests.receive({"event": "lit", "pattern": pattern})
        if pattern == "x+":
            assert requests.request("retake") is None
            assert requests.command() == Wish("retake", "x+")
        requests.receive({"event": "shot", "pattern": pattern})
    assert "all patterns are done" in requests.request("retake")
    assert "retake" not in requests.possible
    requests.receive({"event": "rejected", "pattern": "x+", "camera": "cam0"})
    assert requests.request("retake", "full") is None


def test_a_retake_is_heard_in_a_pause_too():
    requests = Requests()
    requests.receive({"event": "lit", "pattern": "x+"})
    requests.receive({"event": "shot", "pattern": "x+"})
    for do in ("pause", "retake", "resume"):
        assert requests.request(do) is None
    wishes = [Wish("pause"), Wish("retake", "x+"), Wish("resume")]
    assert [requests.command() for _ in range(2)] == [wishes[1], None]  # the pause was taken back
    for do in ("pause", "retake"):
        assert requests.request(do) is None
    assert requests.command() == wishes[0]
    assert requests.possible == ("retake", "resume", "abort")
    assert requests.command() == wishes[1]
    assert requests.request("resume") is None
    assert requests.command() == wishes[2]


def test_an_answer_to_another_question_than_the_one_that_waits_is_refused():
    requests, got = Requests(), []
    requests.receive({"event": "asked", "pattern": "x-"})
    choices = ("retake", "accept", "abort")
    waiting = threading.Thread(target=lambda: got.append(requests.ask(choices)))
    waiting.start()
    while requests.possible != choices:
        pass
    assert "a question about x- waits" in requests.request("accept", "x+")
    assert got == []
    assert requests.request("accept", "x-") is None
    waiting.join(10)
    assert got == ["accept"]


def test_a_pause_taken_back_before_it_came_to_it_is_none():
    requests = Requests()
    for _ in range(1000):
        assert requests.request("pause") is None
        assert requests.request("resume") is None
    assert requests.command() is None


@pytest.mark.parametrize("answer", ["retake", "accept"])
def test_a_question_is_answered_once_and_by_what_was_offered(answer):
    requests, got = Requests(), []
    choices = ("retake", answer, "abort") if answer == "accept" else ("retake", "abort")
    waiting = threading.Thread(target=lambda: got.append(requests.ask(choices)))
    waiting.start()
    while requests.possible != choices:
        pass
    assert requests.request("pause") == "a question waits for its answer"
    if answer == "retake":
        assert requests.request("accept") == "there is no photograph to accept"
    assert requests.request(answer) is None
    waiting.join(10)
    assert got == [answer]
    assert requests.command() is None


@given(st.lists(st.sampled_from([*get_args(Request), "take", "told"]), max_size=40))
def test_no_order_of_requests_leads_to_contradictory_wishes(steps):
    requests = Requests()
    paused = aborted = done = False
    for step in steps:
        if step == "told":
            requests.receive({"event": "shot"})
            done = True
        elif step != "take":
            accepted = requests.request(step) is None
            aborted = aborted or step == "abort"
            if aborted:
                assert accepted == (step == "abort")
        else:
            wish = requests.command()
            do = None if wish is None else wish.do
            if aborted:
                assert do == "abort"
                continue
            assert do != "accept"
            assert do != "retake" or done
            assert do != "pause" or not paused
            assert do != "resume" or paused
            paused = do == "pause" or (paused and do != "resume")


def test_clients_can_stop_a_capture_that_nobody_attends():
    nobody, dark = Unattended(), []
    nobody.at_abort(lambda: dark.append(True))
    assert nobody.request("abort") is None
    assert dark == [True]
    assert nobody.command() == Wish("abort")
    assert nobody.decide([BAD], 2) == "abort"
    nobody.receive({"event": "aborted"})
    assert nobody.request("abort") == "the capture is over"
