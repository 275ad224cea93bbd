"""Temporary files go into memory only where that is one, large enough, and runs programs."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests import memory

GB = 10**9


@pytest.mark.parametrize(
    ("kind", "flags", "room_gb", "free_gb", "taken"),
    [
        ("tmpfs", 0, 3, 11, True),
        ("ext4", 0, 3, 11, False),
        ("tmpfs", os.ST_NOEXEC, 3, 11, False),
        ("tmpfs", 0, 1, 11, False),
        ("tmpfs", 0, 3, 9, False),
    ],
)
def test_only_memory_with_room_that_runs_programs_is_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    kind: str, flags: int, room_gb: int, free_gb: int, taken: bool,
) -> None:  # fmt: skip
    (tmp_path / "mounts").write_text(f"sysfs /sys sysfs ro 0 0\n{kind} {tmp_path} {kind} rw 0 0\n")
    (tmp_path / "meminfo").write_text(
        f"MemTotal: {99 * GB // 1024} kB\nMemAvailable: {free_gb * GB // 1024} kB\nHugePages: 0\n"
    )
    about = SimpleNamespace(f_flag=flags, f_bavail=room_gb * GB // 4096, f_frsize=4096)
    monkeypatch.setattr(memory, "TABLES", tmp_path)
    monkeypatch.setattr(os, "statvfs", lambda _: about)
    assert memory.has_room(tmp_path) is taken


def test_a_folder_or_tables_that_are_missing_are_no_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert not memory.has_room(tmp_path / "none")
    monkeypatch.setattr(memory, "TABLES", tmp_path)
    assert not memory.has_room(memory.MEMORY)
