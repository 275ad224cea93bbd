"""Commands that the page starts: one that cannot be recorded does not run on unseen."""

from __future__ import annotations

import errno

import pytest

from lightstage.console import runner as module
from lightstage.console.runner import Runner


def test_a_command_that_cannot_be_recorded_is_stopped_again(monkeypatch, tmp_path):
    runner = Runner(tmp_path, tmp_path)

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(module, "write_json", full)
    with pytest.raises(OSError, match="No space left"):
        runner.start("capture", "a capture", "S", ["watch", str(tmp_path), "--wait", "600"])
    (child,) = runner._children.values()
    # Signal 15, or its orderly exit after it: not an end of its own, after 600 seconds.
    assert child.wait(timeout=60) != 0
    assert runner.state("capture") is None
