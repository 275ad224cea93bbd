"""Work behind its giver: in order of asking, no more at once than allowed, no error lost."""

import threading

import pytest

from processing.parallel import Behind


def test_all_that_was_given_is_done_when_the_block_ends():
    done = []
    with Behind(2) as behind:
        for k in range(7):
            behind.do(done.append, k)
    assert sorted(done) == list(range(7))


def test_the_giver_waits_where_as_many_as_allowed_are_under_way():
    gate, under_way, most = threading.Event(), [], []

    def work(k):
        under_way.append(k)
        most.append(len(under_way))
        gate.wait(5)
        under_way.remove(k)

    with Behind(2) as behind:
        behind.do(work, 0)
        behind.do(work, 1)
        threading.Timer(0.05, gate.set).start()
        behind.do(work, 2)
        assert gate.is_set()
    assert max(most) <= 2


def test_an_error_is_raised_at_the_end_and_what_had_not_begun_is_left_out():
    def fail():
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"), Behind(1) as behind:
        behind.do(fail)
    done = []

    def both():
        with Behind(1) as behind:
            behind.do(fail)
            behind.do(done.append, 1)

    with pytest.raises(OSError, match="disk full"):
        both()
    assert not done


def test_the_givers_own_error_is_the_one_raised():
    def both():
        with Behind(1) as behind:
            behind.do(lambda: None)
            raise ValueError("own")

    with pytest.raises(ValueError, match="own"):
        both()
