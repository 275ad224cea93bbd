"""Which photographs are taken again where some contradict each other."""

from lightstage.capture.suspects import Suspects
from lightstage.findings import Finding

CAMERAS = ("cam0", "cam1", "cam2")


def bright(camera, pattern="x+", suspects=("full",)):
    return Finding("retake", "too-bright", "", "", "", "", pattern, camera, suspects)


def tries(suspects, findings, count):
    taken = []
    for _ in range(count):
        taken.append(suspects.retakes_for("x+", findings))
        suspects.count("x+", findings)
    return taken


def test_the_named_photograph_is_taken_first_and_then_the_others_of_the_same_camera():
    suspects = Suspects(CAMERAS, 2)
    found = [bright("cam0")]
    assert tries(suspects, found, 2) == [{"x+": {"cam0"}}, {"full": {"cam0"}}]
    assert suspects.left("x+", found) == 0


def test_all_that_take_part_in_a_sum_have_their_turn():
    found = [bright("cam1", suspects=("x-", "full"))]
    assert tries(Suspects(CAMERAS, 4), found, 4) == [
        {"x+": {"cam1"}},
        {"x+": {"cam1"}},
        {"x-": {"cam1"}, "full": {"cam1"}},
        {"x+": {"cam1"}, "x-": {"cam1"}, "full": {"cam1"}},
    ]


def test_retakes_hold_in_total_whichever_photograph_is_named():
    suspects = Suspects(CAMERAS, 2)
    tries(suspects, [bright("cam0")], 1)
    tries(suspects, [bright("cam0", "full", ("x+",))], 1)
    assert suspects.left("x+", [bright("cam0")]) == 0
    assert suspects.left("x+", [bright("cam1")]) == 2


def test_several_cameras_that_tell_the_same_are_the_light_and_nothing_else_is_taken_again():
    # A dead lamp would be in all photographs that are taken again: they would agree, and be wrong.
    both = [bright("cam0"), bright("cam1")]
    assert tries(Suspects(CAMERAS, 4), both, 4) == [{"x+": {"cam0", "cam1"}}] * 4
    assert tries(Suspects(CAMERAS, 4), [bright(None)], 4) == [{"x+": set(CAMERAS)}] * 4


def test_what_contradicts_nothing_is_taken_again_alone():
    found = [bright("cam0", suspects=())]
    assert tries(Suspects(CAMERAS, 2), found, 3) == [{"x+": {"cam0"}}] * 3
