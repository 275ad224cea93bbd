"""The pictures that the page shows: the processes that make them, and those that are kept."""

from __future__ import annotations

import asyncio
import collections
import concurrent.futures
import importlib
import multiprocessing
import threading
import weakref
from collections.abc import Callable, Sequence
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

from lightstage.console.config import ConsoleConfig
from lightstage.console.following import Photograph
from lightstage.console.pictures import Facts, Focus, behind, focus, large, thumbnail
from lightstage.console.sums import SumFacts, sum_picture
from lightstage.errors import FormatError, LightstageError

LARGE_KEPT = 4


class Album:
    """Makes each picture once; a process that a broken photograph ends or holds up is replaced.

    Args:
        config: sizes and numbers.
    """

    def __init__(self, config: ConsoleConfig) -> None:
        self._config = config
        self._lock = threading.Lock()
        # As many are given out as are made at a time: none waits while its own time runs.
        self._free = asyncio.Semaphore(config.makers)
        self._pool: concurrent.futures.ProcessPoolExecutor | None = None
        # Those whose processes were ended for one that hung: the others' pictures are made anew.
        self._ended: weakref.WeakSet[concurrent.futures.ProcessPoolExecutor] = weakref.WeakSet()
        self._small = _Kept(config.thumbnails)
        self._large = _Kept(LARGE_KEPT)
        self._focus = _Kept(config.thumbnails)
        self._sums = _Kept(LARGE_KEPT)

    async def thumbnail(self, photograph: Photograph) -> bytes:
        """A small JPEG; FormatError where the photograph cannot be read."""
        key = (photograph.path, photograph.sha256)
        pixels = self._config.thumbnail_px
        data: bytes = await self._small.get(
            key, lambda: self._make(photograph.path, thumbnail, photograph.path, pixels)
        )
        return data

    async def large(self, photograph: Photograph) -> tuple[bytes, Facts]:
        """A large JPEG and its figures; FormatError as `thumbnail`."""
        key = (photograph.path, photograph.sha256)
        pixels = self._config.large_px
        made: tuple[bytes, Facts] = await self._large.get(
            key, lambda: self._make(photograph.path, large, photograph.path, pixels)
        )
        return made

    async def focus(self, photograph: Photograph, other: Photograph | None) -> Focus:
        """How sharp it is, also against another one; FormatError as `thumbnail`."""
        beside = None if other is None else other.path
        key = (photograph.path, photograph.sha256, beside)
        measured: Focus = await self._focus.get(
            key, lambda: self._make(photograph.path, focus, photograph.path, beside)
        )
        return measured

    async def sums(self, photographs: Sequence[Photograph]) -> tuple[bytes, SumFacts]:
        """How two photographs sum to a third, as a JPEG and figures; FormatError as `thumbnail`."""
        paths = [each.path for each in photographs]
        key = tuple((each.path, each.sha256) for each in photographs)
        pixels = self._config.sum_px
        made: tuple[bytes, SumFacts] = await self._sums.get(
            key, lambda: self._make(paths[-1], sum_picture, *paths, pixels)
        )
        return made

    def start(self) -> None:
        """Start the processes, so that the first photograph does not wait for them."""
        for _ in range(self._config.makers):
            self._executor().submit(behind_is_ready)

    def close(self) -> None:
        """End the processes."""
        with self._lock:
            pool, self._pool = self._pool, None
        if pool is not None:
            _end(pool, cancel=True)

    async def _make(self, path: Path, make: Callable[..., Any], *arguments: Any) -> Any:
        async with self._free:
            return await self._make_now(path, make, *arguments)

    async def _make_now(self, path: Path, make: Callable[..., Any], *arguments: Any) -> Any:
        while True:
            pool = self._executor()
            work: concurrent.futures.Future[Any] | None = None
            try:
                work = pool.submit(make, *arguments)
                return await asyncio.wait_for(asyncio.wrap_future(work), self._config.picture_s)
            except BrokenProcessPool:
                self._drop(pool)
                if pool in self._ended:
                    continue
                raise FormatError(
                    path,
                    found="a file that ends the program that reads it",
                    expected="a photograph",
                ) from None
            except TimeoutError:
                if work is not None and not work.cancelled():
                    # It is being read still, and may be for ever: nothing else ends that.
                    self._ended.add(pool)
                    self._drop(pool)
                    _end(pool, cancel=False)
                found = f"no picture of it within {self._config.picture_s:g} s"
                raise FormatError(path, found=found, expected="a photograph") from None

    def _drop(self, pool: concurrent.futures.ProcessPoolExecutor) -> None:
        """Have the next picture made by new processes."""
        with self._lock:
            self._pool = None if self._pool is pool else self._pool

    def _executor(self) -> concurrent.futures.ProcessPoolExecutor:
        with self._lock:
            if self._pool is None:
                # Spawned: a server with threads must not be copied.
                context = multiprocessing.get_context("spawn")
                self._pool = concurrent.futures.ProcessPoolExecutor(
                    self._config.makers, context, initializer=behind
                )
            return self._pool


def _end(pool: concurrent.futures.ProcessPoolExecutor, cancel: bool) -> None:
    """End processes, also one that hangs, for which the server's own end would wait.

    Args:
        pool: theirs.
        cancel: whether work that waits for them is cancelled, not failed.
    """
    processes = list((pool._processes or {}).values())
    pool.shutdown(wait=False, cancel_futures=cancel)
    for process in processes:
        process.kill()


def behind_is_ready() -> bool:
    """The first work of a new process: it imports this file, and rawpy."""
    importlib.import_module("rawpy")  # else the first photograph waits for it
    return True


class _Kept:
    """Results that were made and that are being made: no two tasks make the same one."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._made: collections.OrderedDict[Any, Any] = collections.OrderedDict()
        self._making: dict[Any, asyncio.Future[Any]] = {}

    async def get(self, key: Any, make: Callable[[], Any]) -> Any:
        if key in self._made:
            self._made.move_to_end(key)
            return self._made[key]
        if key not in self._making:
            self._making[key] = asyncio.ensure_future(make())
            self._making[key].add_done_callback(lambda done: self._done(key, done))
        return await asyncio.shield(self._making[key])

    def _done(self, key: Any, made: asyncio.Future[Any]) -> None:
        self._making.pop(key, None)
        if made.cancelled() or made.exception() is not None:
            return  # it is read again: the file may have been repaired meanwhile
        self._made[key] = made.result()
        while len(self._made) > self._most:
            self._made.popitem(last=False)


def why_not(error: BaseException) -> str:
    """Why there is no picture, in words."""
    return str(error) if isinstance(error, LightstageError) else type(error).__name__
