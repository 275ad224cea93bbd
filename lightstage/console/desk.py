"""What the page's answers are made of: the plan, the sessions, the commands that run."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from lightstage.console.album import Album
from lightstage.console.config import ConsoleConfig
from lightstage.console.following import Followed, Following
from lightstage.console.runner import JobState, Runner
from lightstage.counting import counted
from lightstage.day import (
    DayPlan,
    Planned,
    Seen,
    next_open,
    planned,
    read_plan,
    sessions_of,
    write_plan,
)
from lightstage.day.sessions import session_folders
from lightstage.day.standing import sessions_folder
from lightstage.errors import CaptureError, ConfigError, FormatError, LightstageError
from lightstage.formats.paths import check_name
from lightstage.operator.client import answers, ask
from lightstage.session.opening import JOURNAL

ENDING_S = 10.0
"""Seconds within which a capture releases its cameras after its journal's last line."""
STAGE, LOOK, CHECK = "stage", "devices", "check"
"""Kinds of jobs: a capture, a check of the devices, a check of a session; one of each at a time."""


@dataclasses.dataclass(frozen=True)
class StageOptions:
    """The stage as options of `lightstage capture`, with absolute paths.

    Attributes:
        rig: rig.json.
        leds: the LED device's URL.
        cameras: a cameras file, or ``auto``.
        config: TOML of limits.
        calibration: the lab's folder of calibration shots.
        colour: a colour calibration for each session to carry.
    """

    rig: Path
    leds: str
    cameras: str = "auto"
    config: Path | None = None
    calibration: Path | None = None
    colour: Path | None = None

    def devices(self) -> list[str]:
        """Options of every command that opens the devices."""
        words = ["--leds", self.leds, "--cameras", self.cameras]
        return words if self.config is None else [*words, "--config", str(self.config)]

    def capture(self) -> list[str]:
        """Options of a new session."""
        words = ["--rig", str(self.rig), *self.devices()]
        for name, path in (("--calibration", self.calibration), ("--colour", self.colour)):
            words += [] if path is None else [name, str(path)]
        return words


class Desk:
    """Everything that an operator can do from the page; several threads may call.

    Args:
        plan: the day's plan; a missing file is an empty plan until somebody adds to it.
        stage: the devices; None for a page that cannot capture.
        processed: folder of processed folders.
        config: of the page's server.
    """

    def __init__(
        self,
        plan: Path,
        stage: StageOptions | None,
        processed: Path | None,
        config: ConsoleConfig,
    ) -> None:
        self.path = plan.absolute()
        self.stage = stage
        self.processed = processed
        self.config = config
        self.folder = sessions_folder(self._read(), self.path)
        self.following = Following(config.page_events)
        self.album = Album(config)
        self.runner = Runner(self.folder, Path.cwd())
        self.closing = threading.Event()
        self._changing = threading.Lock()

    def plan(self) -> DayPlan:
        """The plan as its file has it now.

        Raises:
            ConfigError: as `read_plan`, or another folder of sessions than when the console began.
        """
        plan = self._read()
        if sessions_folder(plan, self.path) != self.folder:
            raise ConfigError(
                self.path,
                field="sessions",
                found=ascii(plan.sessions),
                expected=str(self.folder),
                hint="Its folder was changed: end the console, and start it again.",
            )
        return plan

    def _read(self) -> DayPlan:
        return read_plan(self.path) if self.path.exists() else DayPlan()

    def stamp(self) -> str:
        """A hash of the plan's file: a page that was loaded before a change holds another one."""
        data = self.path.read_bytes() if self.path.is_file() else b""
        return hashlib.sha256(data).hexdigest()[:16]

    def takes(self) -> list[Planned]:
        """Every take with its sessions."""
        return planned(self.plan(), self.path)

    def change(self, stamp: str, how: Callable[[DayPlan], DayPlan]) -> None:
        """Change the plan; the page that asks for it must show the present plan, by its stamp.

        Raises:
            CaptureError: the file was changed after the page was loaded.
            ConfigError: the changed plan would not be valid.
        """
        with self._changing:
            if stamp != self.stamp():
                raise CaptureError(
                    self.path,
                    found="a plan that was changed meanwhile",
                    expected="the one that your page shows",
                    hint="Reload the page, and try again.",
                )
            write_plan(self.path, how(self.plan()))

    def start(self, take: str | None) -> None:
        """Start the next take of the plan, or one by its name, in a process of its own.

        Raises:
            CaptureError: a capture runs, or nothing is left to do.
            ConfigError: no such take, or no stage was named.
        """
        stage = self._stage()
        self._require_idle()
        found = next_open(self.plan(), self.path, take)
        words = ["capture", "--plan", str(self.path), "--take", found.take.name, "--attended"]
        # An unfinished session keeps the rig and the calibration that it began with.
        words += stage.devices() if found.stand == "begun" else stage.capture()
        self.runner.start(STAGE, found.take.name, found.folder.name, words)

    def resume(self, name: str) -> None:
        """Resume an unfinished session; errors as `start`."""
        stage = self._stage()
        self._require_idle()
        root = self.root(name)
        words = ["capture", "--resume", "--out", str(root), "--attended", *stage.devices()]
        self.runner.start(STAGE, name, name, words)

    def retake(self, name: str, pattern: str, camera: str) -> None:
        """Retake one photograph of a session that is not being captured; errors as `start`."""
        stage = self._stage()
        self._require_idle()
        root = self.root(name)
        check_name(pattern, name, "pattern")
        check_name(camera, name, "camera")
        words = ["retake", str(root), pattern, camera, "--attended", *stage.devices()]
        self.runner.start(STAGE, f"{name}: {pattern} by {camera}", name, words)

    def remove(self, stamp: str, subject: str) -> None:
        """Remove a person who has no session from the plan; errors as `change`."""

        def without(plan: DayPlan) -> DayPlan:
            own = f"{subject}+"  # also of a session that is damaged, or begins just now
            names = {each.root.name for each in self.sessions() if each.subject == subject}
            names |= {path.name for path in self._folders() if path.name.startswith(own)}
            state = self.runner.state(STAGE)
            if state is not None and state.running and state.job.session.startswith(own):
                names.add(state.job.session)
            if names:
                raise CaptureError(
                    subject,
                    found=f"{counted(len(names), 'session')} ({', '.join(sorted(names)[:5])})",
                    expected="a person without a session",
                    hint="A person with a session stays in the plan, with its consent.",
                )
            return plan.without_subject(subject)

        self.change(stamp, without)

    def ask(self, name: str, do: str, pattern: str = "") -> str | None:
        """Send a request to a running capture; why it is refused, None where it is accepted.

        Args:
            name: of the session.
            do: a request.
            pattern: that the page showed; empty for the latest.
        """
        root = self.root(name)
        try:
            return ask(root, do, pattern)
        except (CaptureError, FormatError) as error:
            state = self.runner.state(STAGE)
            own = state is not None and state.running and state.job.session == name
            # It has no journal yet, or is ending: a signal ends it in order, with lights dark.
            if do == "abort" and own and self.runner.stop(STAGE):
                return None
            return f"no capture runs in this session ({error.found or 'it is over'})"

    def look_at_devices(self) -> None:
        """Start a check of the devices; errors as `start`."""
        stage = self._stage()
        self._require_idle()
        words = ["devices", "--rig", str(stage.rig), *stage.devices()]
        words += ["--folder", str(self.folder), "--json"]
        self.runner.start(LOOK, "devices", "", words)

    def check(self, name: str) -> None:
        """Start a check of a session, which records its result in the folder."""
        self.runner.start(CHECK, name, name, ["check", str(self.root(name)), "--record"])

    def root(self, name: str) -> Path:
        """A session's folder by its name; FormatError where there is none such."""
        found = [path for path in self._folders() if path.name == name]
        if not found:
            state = self.runner.state(STAGE)
            if state is not None and state.running and state.job.session == name:
                return self.folder / name
            raise FormatError(
                "session", found=ascii(name[:80]), expected="a session of this folder"
            )
        return found[0]

    def followed(self, name: str) -> Followed:
        """A session in its present state; FormatError where it has no journal."""
        return self.following.of(self.root(name))

    def sessions(self) -> list[Seen]:
        """Every session of the folder; none where there is no folder yet."""
        if not self.folder.is_dir():
            return []
        return sessions_of(self.folder, self.processed)

    def current(self) -> tuple[str, JobState | None]:
        """Name of the session that runs or ran last, and the last capture that the page started."""
        state = self.runner.state(STAGE)
        if state is not None and state.running:
            return state.job.session, state
        dated = []
        for path in self._folders():
            with contextlib.suppress(OSError):
                dated.append(((path / JOURNAL).stat().st_mtime, path))
        if not dated:
            return ("" if state is None else state.job.session), state
        newest = max(dated)[1]
        # A job that failed or was stopped before its session began has no journal.
        ended = state is not None and (state.failed or state.stopped)
        if state is not None and ended and not (self.folder / state.job.session).exists():
            return state.job.session, state
        return newest.name, state

    def running(self) -> str:
        """Name of the session that is being captured, from the page or a terminal; else empty."""
        name, state = self.current()
        if state is not None and state.running:
            return name
        return name if name and answers(self.folder / name) else ""

    def _is_over(self, name: str) -> bool:
        """Whether a session's journal has its last line, after which the devices are released."""
        try:
            return self.followed(name).view.over
        except LightstageError:
            return False

    def _folders(self) -> Sequence[Path]:
        try:
            return session_folders(self.folder)
        except LightstageError:
            return []

    def _stage(self) -> StageOptions:
        if self.stage is None:
            raise ConfigError(
                "the console",
                found="no stage",
                expected="--rig and --leds",
                hint="Start it again with them: lightstage console --help.",
            )
        return self.stage

    def _require_idle(self) -> None:
        """CaptureError where the stage is in use; waits for a capture that is just ending."""
        until = time.monotonic() + ENDING_S
        while (running := self.running()) and time.monotonic() < until and self._is_over(running):
            time.sleep(0.1)
        looking = self.runner.state(LOOK)
        if running or (looking is not None and looking.running):
            raise CaptureError(
                "the stage",
                found=f"{running} is being captured"
                if running
                else "the devices are being checked",
                expected="an idle one",
                hint="Wait for its end, or stop it.",
            )
