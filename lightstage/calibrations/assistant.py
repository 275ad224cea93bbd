"""Who is asked for each pose: the operator at the terminal, or nobody."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import TypeVar

from lightstage.calibrations.run import Verdict
from lightstage.findings import Finding

Meaning = TypeVar("Meaning")


class TerminalAssistant:
    """Asks in plain words and waits for a line.

    Args:
        print_line: prints a line.
        ask: prints a question and returns the answer; EOFError where nobody is there.
    """

    def __init__(self, print_line: Callable[[str], None], ask: Callable[[str], str]) -> None:
        self._print_line = print_line
        self._ask = ask

    def ready(self, number: int, count: int, question: str) -> bool:
        """Ask for a pose; any answer but ``q`` takes it."""
        self._print_line(f"Pose {number} of {count}: {question}")
        return self._answer("Enter takes it, q stops: ", {"": True, "q": False})

    def judge(self, number: int, findings: Sequence[Finding], left: int) -> Verdict:
        """Report what is amiss and ask what to do; where no take is left, whether to keep it."""
        for finding in findings:
            self._print_line(f"  {finding}")
        if left <= 0:
            return self._answer(
                f"Pose {number}: this was its last take. k keeps it, Enter or q stops: ",
                {"": "stop", "k": "keep", "q": "stop"},
            )
        answers: dict[str, Verdict] = {"": "again", "k": "keep", "q": "stop"}
        return self._answer(
            f"Pose {number}: Enter takes it again (at most {left} more), k keeps it, q stops: ",
            answers,
        )

    def _answer(self, question: str, answers: dict[str, Meaning]) -> Meaning:
        while True:
            try:
                answer = self._ask(question).strip().lower()
            except EOFError:
                answer = "q"  # nobody is there
            if answer in answers:
                return answers[answer]


class UnattendedAssistant:
    """Takes pose after pose with a pause between them, and again while any retakes are left.

    Args:
        print_line: prints a line.
        pause_s: seconds before each pose, to change what is held.
        retakes: of each pose.
        sleep: waits.
    """

    def __init__(
        self,
        print_line: Callable[[str], None],
        pause_s: float,
        retakes: int,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._print_line = print_line
        self._pause_s = pause_s
        self._retakes = retakes
        self._sleep = sleep
        self._taken: dict[int, int] = {}

    def ready(self, number: int, count: int, question: str) -> bool:
        """Announce what will be taken, and wait."""
        self._print_line(f"Pose {number} of {count} in {self._pause_s:g} s: {question}")
        self._sleep(self._pause_s)
        return True

    def judge(self, number: int, findings: Sequence[Finding], left: int) -> Verdict:
        """Retake while retakes are left, then stop. It never keeps a faulty pose."""
        for finding in findings:
            self._print_line(f"  {finding}")
        self._taken[number] = self._taken.get(number, 0) + 1
        return "again" if left > 0 and self._taken[number] <= self._retakes else "stop"
