"""Disk, cards and this computer's clock."""

import datetime
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from lightstage.cameras.camera import Summary
from lightstage.preflight.config import Plan, PreflightConfig
from lightstage.preflight.disk import (
    card_findings,
    disk_findings,
    photograph_bytes,
)

CONFIG = PreflightConfig()
NOW = datetime.datetime(2026, 5, 1, 12, tzinfo=datetime.UTC)


def codes(findings):
    return [finding.code for finding in findings]


def test_a_good_folder_is_left_as_it_was(tmp_path, small_rig):
    out = tmp_path / "sessions" / "one"
    assert disk_findings(small_rig, out, Plan(7), CONFIG) == []
    assert list(tmp_path.iterdir()) == []


def test_a_plan_larger_than_the_disk_is_refused(tmp_path, small_rig):
    free = shutil.disk_usage(tmp_path).free
    fits = Plan(1, free // 2 // 3)
    assert disk_findings(small_rig, tmp_path / "s", fits, CONFIG) == []
    (finding,) = disk_findings(small_rig, tmp_path / "s", Plan(3, free // 2 // 3), CONFIG)
    assert (finding.severity, finding.code) == ("refuse", "disk-space")
    assert "free" in finding.found


def test_the_margin_counts(tmp_path, small_rig):
    exact = Plan(1, round(shutil.disk_usage(tmp_path).free / 3 * 0.8))
    assert disk_findings(small_rig, tmp_path, exact, CONFIG) == []
    assert codes(disk_findings(small_rig, tmp_path, exact, PreflightConfig(space_margin=0.5))) == [
        "disk-space"
    ]


def test_a_photographs_size_is_guessed_from_its_pixels(small_rig):
    camera = small_rig.cameras[0]
    assert photograph_bytes(camera, Plan(1)) == 2 * 32 * 48 + 2**20
    assert photograph_bytes(camera, Plan(1, 12_345)) == 12_345


def test_a_session_inside_a_file_is_refused(tmp_path, small_rig):
    (tmp_path / "file").write_text("x")
    for out in (tmp_path / "file", tmp_path / "file" / "s"):
        (finding,) = disk_findings(small_rig, out, Plan(1), CONFIG)
        assert (finding.severity, finding.found) == ("refuse", "a file, not a folder")


def test_a_place_that_takes_no_folders_is_refused(small_rig):
    found = disk_findings(small_rig, Path("/proc/nothing/session"), Plan(1, 10), CONFIG)
    assert "disk" in codes(found)


def test_a_folder_without_the_right_to_write_is_refused(small_rig):
    """In a process of a user who is not the superuser: that one may write anywhere."""
    script = (
        "import os, sys, pathlib\n"
        "from lightstage.preflight import Plan, PreflightConfig\n"
        "from lightstage.preflight.disk import disk_findings\n"
        "from lightstage.rig import default_rig\n"
        "rig = default_rig()\n"
        "os.geteuid() == 0 and (os.setgroups([]), os.setgid(65534), os.setuid(65534))\n"
        "found = disk_findings(rig, pathlib.Path(sys.argv[1]) / 's', Plan(1, 10), "
        "PreflightConfig())\n"
        "print([(f.code, f.found) for f in found])\n"
    )
    with tempfile.TemporaryDirectory() as name:
        os.chmod(name, 0o555)
        printed = subprocess.run(
            [sys.executable, "-c", script, name], capture_output=True, text=True, check=True
        )
    assert "('disk', 'Permission denied')" in printed.stdout


def test_names_too_long_for_the_disk_are_refused(tmp_path, small_rig):
    plan = Plan(1, patterns=("x" * 300,))
    found = disk_findings(small_rig, tmp_path / "s", plan, CONFIG)
    assert "path-length" in codes(found)
    assert "300 bytes" in str(found[0])
    deep = tmp_path.joinpath(*["d" * 200] * 21)
    assert "path-length" in codes(disk_findings(small_rig, deep, Plan(1), CONFIG))


def test_cards_too_small_for_the_plan_are_refused(small_rig):
    values = {
        "cam0": Summary(card_free_bytes=10**9),
        "cam1": Summary(card_free_bytes=50_000_000),
        "cam2": Summary(),
    }
    (finding,) = card_findings(small_rig, values, Plan(10, 5_000_000), CONFIG)
    assert finding.camera == "cam1"
    assert "50.0 MB free" in finding.found
    assert "55.0 MB for 10 photographs" in finding.expected
