"""A camera's process ends with its parent, however that ends and whatever the driver is doing."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

HERE = Path(__file__).parent

PARENT = """
import sys, threading, time
from lightstage.cameras.process import CameraProcess
c = CameraProcess("cam0", "cam0", None, 60.0, "camera_drivers:" + sys.argv[1])
made = threading.Thread(target=c.open); made.start(); made.join()  # the thread that made it ends
print(c.pid, flush=True)
c.delete("x") if sys.argv[1] == "HoldingTheLock" else None
c.trigger(0.0) if sys.argv[1] == "Looping" else None
time.sleep(60)
"""


@pytest.mark.parametrize("kind", ["Fine", "Looping", "HoldingTheLock"])
def test_a_camera_process_ends_when_its_parent_is_killed_whatever_the_driver_does(
    monkeypatch, gone, kind
):
    monkeypatch.setenv("PYTHONPATH", str(HERE))
    parent = subprocess.Popen([sys.executable, "-c", PARENT, kind], stdout=subprocess.PIPE)
    pid = int(parent.stdout.readline())
    time.sleep(0.3)  # it hangs by now
    os.kill(pid, 0)
    parent.kill()
    parent.wait()
    gone(pid)


def test_a_stopped_camera_process_ends_with_its_parent_too(monkeypatch, gone):
    monkeypatch.setenv("PYTHONPATH", str(HERE))
    parent = subprocess.Popen([sys.executable, "-c", PARENT, "Fine"], stdout=subprocess.PIPE)
    pid = int(parent.stdout.readline())
    os.kill(pid, signal.SIGSTOP)
    parent.kill()
    parent.wait()
    gone(pid)
