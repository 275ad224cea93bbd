"""Who decides during a capture, and what they ask for until the capture takes it up."""

from __future__ import annotations

import collections
import contextlib
import dataclasses
import threading
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Literal, NamedTuple, Protocol, get_args

from lightstage.errors import LightstageError
from lightstage.findings import Finding
from lightstage.formats.config import require_bounds

Do = Literal["abort", "retake", "pause", "resume"]
"""``resume`` ends a pause."""
Decision = Literal["retake", "accept", "abort"]
Request = Literal["retake", "accept", "abort", "pause", "resume"]

NOT_TAKEN = "not-taken"
"""Code of a finding without a photograph: there is nothing to accept."""


class Wish(NamedTuple):
    """What a running capture shall do.

    Attributes:
        do: the request.
        pattern: of a ``retake``: which one is taken again, where it is known; otherwise empty.
    """

    do: Do
    pattern: str = ""


@dataclasses.dataclass(frozen=True)
class OperatorConfig:
    """What is decided where nobody is asked.

    Attributes:
        retakes: of each pattern, before a capture that nobody attends gives up.
        then: what it does then: ``abort`` (a later --resume continues there), or ``accept`` (keeps
            the photograph as it is, where there is one; the finding is in the journal).
    """

    retakes: int = 2
    then: Literal["abort", "accept"] = "abort"

    def __post_init__(self) -> None:
        """ConfigError on an impossible count: before a light goes on."""
        require_bounds(self, "operator", {"retakes": (0, 1000)})


class Operator(Protocol):
    """Somebody, or a rule, who decides. Several threads may call ``receive`` and ``request``."""

    def command(self) -> Wish | None:
        """The operator's next request, or None. After an abort every call returns the abort."""

    def decide(self, findings: Sequence[Finding], retakes_left: int) -> Decision:
        """Decide about photographs that failed a check. May wait for the operator without limit."""

    def receive(self, line: dict[str, Any], old: bool = False) -> None:
        """A line that is in the journal now, or `old` from before a resume; never waits."""

    def request(self, do: str, pattern: str = "") -> str | None:
        """Somebody asks for something from elsewhere; why not, or None where it is accepted.

        Args:
            do: a Request.
            pattern: that a retake is of, or that the question is of that is answered; where it is
                empty, the one that was lit last, or whatever question waits.
        """

    def at_abort(self, act: Callable[[], None]) -> None:
        """Have this done at once when somebody aborts, in the thread that hears it."""


def possible_answers(codes: Iterable[str]) -> tuple[Decision, ...]:
    """What can be answered to findings of these codes; without a photograph none is accepted."""
    return ("retake", "abort") if NOT_TAKEN in codes else ("retake", "accept", "abort")


def by_rule(findings: Sequence[Finding], retakes_left: int, config: OperatorConfig) -> Decision:
    """The decision without a question: retake while retakes are left, then as configured."""
    if not any(finding.severity in ("retake", "refuse") for finding in findings):
        return "accept"
    if retakes_left > 0:
        return "retake"
    then = config.then
    return then if then in possible_answers(finding.code for finding in findings) else "abort"


class Requests:
    """What keys and clients ask for; none is lost, and an abort acts at once.

    ``request`` may be called from any thread, the rest is the capture's.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._wishes: collections.deque[Wish] = collections.deque()
        self._acts: list[Callable[[], None]] = []
        self._question: tuple[Decision, ...] = ()
        self._answer: Decision | None = None
        self._asked = ""  # pattern of the latest question
        self._left: set[str] | None = None  # patterns that are not done; None: not known
        self._lit: dict[str, None] = {}  # patterns, the one that was lit last at the end
        self._aborted = self._paused = self._over = self._shot = False

    @property
    def aborted(self) -> bool:
        """Whether somebody aborted."""
        return self._aborted

    @property
    def shown(self) -> str:
        """The pattern that was lit last; a retake without a pattern means this one."""
        with self._changed:
            return next(reversed(self._lit), "")

    @property
    def possible(self) -> tuple[Request, ...]:
        """What makes sense to ask for now."""
        with self._changed:
            if self._over or self._aborted:
                return ()
            if self._question:
                return self._question
            waits: tuple[Request, ...] = ("resume" if self._pausing() else "pause", "abort")
            return ("retake", *waits) if self._shot and self._left != set() else waits

    def receive(self, line: dict[str, Any]) -> None:
        """Know what can be asked for."""
        event, pattern = line.get("event"), line.get("pattern")
        if event == "lit" and isinstance(pattern, str):
            with self._changed:
                self._lit.pop(pattern, None)
                self._lit[pattern] = None
        elif event == "asked":
            self._asked = pattern if isinstance(pattern, str) else ""
        elif event in ("begin", "resume"):
            # The lines of an earlier run, up to its end, come before those of this one.
            with self._changed:
                self._over = self._paused = False
            if event == "begin":
                sequence = line.get("sequence")
                self._left = set(sequence) if isinstance(sequence, list) else None
        elif event == "rejected" and self._left is not None:
            self._left.add(str(pattern))
        elif event == "retake" and self._left is not None:
            self._left |= {str(each[0]) for each in line.get("takes", ())}
        elif event == "shot":
            self._shot = True
            if self._left is not None:
                self._left.discard(str(pattern))
        elif event in ("aborted", "end"):
            self._over = True

    def at_abort(self, act: Callable[[], None]) -> None:
        """Do this when somebody aborts; at once where somebody did."""
        with self._changed:
            self._acts.append(act)
            late = self._aborted
        if late:
            _do(act)

    def request(self, do: str, pattern: str = "") -> str | None:
        """Ask for something; why not, or None where it is accepted (arguments as `Operator`'s)."""
        if do not in get_args(Request):
            return f"unknown: {do[:40]!r}; there are {', '.join(get_args(Request))}"
        if do == "abort":
            return self._abort()
        with self._changed:
            if self._over or self._aborted:
                return "the capture is ending"
            if self._question:
                return self._take_answer(do, pattern)
            if do == "retake":
                pattern = pattern or next(reversed(self._lit), "")
            why = self._why_not(do, pattern)
            if why is None and do == "resume" and Wish("pause") in self._wishes:
                self._wishes.remove(Wish("pause"))  # it did not come to it
            elif why is None:
                of = pattern if do == "retake" else ""
                self._wishes.extend(Wish(wish, of) for wish in get_args(Do) if wish == do)
            return why

    def command(self) -> Wish | None:
        """The oldest wish that was not taken up yet."""
        with self._changed:
            if self._aborted:
                return Wish("abort")
            if not self._wishes:
                return None
            wish = self._wishes.popleft()
            if wish.do in ("pause", "resume"):
                self._paused = wish.do == "pause"
            return wish

    def ask(self, choices: tuple[Decision, ...]) -> Decision:
        """Wait until somebody answers; an abort always does."""
        with self._changed:
            self._answer, self._question = None, choices
            try:
                while self._answer is None and not self._aborted:
                    self._changed.wait()
                return "abort" if self._aborted or self._answer is None else self._answer
            finally:
                self._question = ()

    def _abort(self) -> str | None:
        with self._changed:
            if self._over:
                return "the capture is over"
            acts = [] if self._aborted else list(self._acts)
            self._aborted = True
        for act in acts:  # before anybody waiting is notified: the lights come first
            _do(act)
        with self._changed:
            self._changed.notify_all()
        return None

    def _take_answer(self, do: str, pattern: str) -> str | None:
        if pattern and self._asked and pattern != self._asked:
            return f"a question about {self._asked} waits; this answer is about {pattern[:40]}"
        for choice in self._question:
            if choice == do:
                if self._answer is not None:
                    return "it is answered already"
                self._answer = choice
                self._changed.notify_all()
                return None
        if do == "accept":
            return "there is no photograph to accept"
        return "a question waits for its answer"

    def _pausing(self) -> bool:
        """Whether it is paused when all wishes are taken up."""
        wishes = [wish.do for wish in self._wishes if wish.do in ("pause", "resume")]
        return wishes[-1] == "pause" if wishes else self._paused

    def _why_not(self, do: str, pattern: str) -> str | None:
        """Why a wish cannot be had now, besides a question that waits."""
        pausing = self._pausing()
        if do == "accept":
            return "nothing waits to be accepted"
        if do == "resume":
            return None if pausing else "it is not paused"
        if do == "pause":
            return "it is paused already" if pausing else None
        if not self._shot:
            return "no pattern is done yet"
        if self._left == set():
            return "all patterns are done; take it again once the session is complete"
        if pattern and pattern not in self._lit:
            return f"no pattern {pattern[:40]!r} was taken"
        return "it is asked for already" if Wish("retake", pattern) in self._wishes else None


def _do(act: Callable[[], None]) -> None:
    # What fails here is done again, and reported, on the capture's own way out.
    with contextlib.suppress(LightstageError):
        act()


class Unattended:
    """Nobody is asked: retakes while there are any left, then by the configuration.

    Args:
        config: the rule.
    """

    def __init__(self, config: OperatorConfig | None = None) -> None:
        self._config = config or OperatorConfig()
        self._requests = Requests()

    def command(self) -> Wish | None:
        """What clients of the event stream ask for."""
        return self._requests.command()

    def decide(self, findings: Sequence[Finding], retakes_left: int) -> Decision:
        """By the rule, at once."""
        if self._requests.aborted:
            return "abort"
        return by_rule(findings, retakes_left, self._config)

    def receive(self, line: dict[str, Any], old: bool = False) -> None:
        """Know what can be asked for."""
        del old
        self._requests.receive(line)

    def request(self, do: str, pattern: str = "") -> str | None:
        """Asked from elsewhere; why not, or None where it is accepted."""
        return self._requests.request(do, pattern)

    def at_abort(self, act: Callable[[], None]) -> None:
        """Do this when somebody aborts."""
        self._requests.at_abort(act)
