"""The processes that make pictures: one that hangs costs its own picture alone."""

from __future__ import annotations

import asyncio
import concurrent.futures
import dataclasses
import multiprocessing
import os
from pathlib import Path
from typing import Any

import pytest

from lightstage.console.album import Album, behind_is_ready
from lightstage.console.config import ConsoleConfig
from lightstage.console.following import Photograph
from lightstage.errors import FormatError
from tests.lightstage.console.conftest import wait_until

ONE = dataclasses.replace(ConsoleConfig(), makers=1, picture_s=8.0)
"""Long enough for a new process to begin, which the other photograph waits for."""


def endless(folder: Path, name: str) -> Photograph:
    """A photograph whose bytes never come, as on a disk of a network that is gone."""
    os.mkfifo(folder / name)
    return Photograph(folder / name, 1, name)


def test_a_photograph_that_is_read_for_ever_keeps_neither_others_nor_the_end_waiting(
    tmp_path: Path, dng
) -> None:
    before = set(multiprocessing.active_children())
    path = tmp_path / "good.dng"
    path.write_bytes(dng(3000))
    album = Album(ONE)

    async def shown() -> tuple[object, object]:
        hangs = asyncio.create_task(album.thumbnail(endless(tmp_path, "first.dng")))
        await asyncio.sleep(0.1)
        waits = asyncio.create_task(album.thumbnail(Photograph(path, 1, "good")))
        found = await asyncio.gather(hangs, waits, return_exceptions=True)
        # Another one hangs while the server ends.
        asyncio.create_task(album.thumbnail(endless(tmp_path, "last.dng")))  # noqa: RUF006
        await asyncio.sleep(0.1)
        return found[0], found[1]

    hung, other = asyncio.run(shown())
    assert isinstance(hung, FormatError)
    assert "no picture of it within 8 s" in str(hung)
    assert isinstance(other, bytes), other
    assert other.startswith(b"\xff\xd8")
    album.close()
    wait_until(lambda: set(multiprocessing.active_children()) <= before, "the processes' end")


class Made:
    """In place of the processes: holds the work that it is given, until a test ends it."""

    def __init__(self) -> None:
        self.given: list[concurrent.futures.Future[None]] = []

    def submit(self, *_: Any) -> concurrent.futures.Future[None]:
        self.given.append(concurrent.futures.Future())
        return self.given[-1]


class OwnTime(asyncio.SelectorEventLoop):
    """Its time passes where a test has it pass, however busy the machine is."""

    now_s = 0.0

    def time(self) -> float:
        return self.now_s


def test_a_picture_that_waits_for_others_has_its_own_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One process, and six pictures that take three quarters of the limit each."""
    loop, made = OwnTime(), Made()

    async def settled() -> None:
        for _ in range(20):
            await asyncio.sleep(0)

    async def all_made() -> list[object]:
        album = Album(ONE)
        monkeypatch.setattr(album, "_executor", lambda: made)
        work = [album._make(tmp_path / "any.dng", behind_is_ready) for _ in range(6)]
        waiting = asyncio.gather(*work, return_exceptions=True)
        for count in range(1, 7):
            await settled()
            assert len(made.given) == count
            loop.now_s += 0.75 * ONE.picture_s
            await settled()
            made.given[-1].set_result(None)
        return await waiting

    try:
        assert loop.run_until_complete(all_made()) == [None] * 6
    finally:
        loop.close()
