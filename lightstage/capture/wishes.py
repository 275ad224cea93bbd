"""What the operator wishes while a capture runs: none is lost, an abort is seen at once."""

from __future__ import annotations

from lightstage.operator import Operator, Wish


class Wishes:
    """The operator's commands, kept until somebody acts on them.

    Args:
        operator: polled.
    """

    def __init__(self, operator: Operator) -> None:
        self._operator = operator
        self._pending: list[Wish] = []

    def aborted(self) -> bool:
        """Whether the operator wants no more."""
        self._poll()
        return any(wish.do == "abort" for wish in self._pending)

    def take(self) -> Wish | None:
        """The oldest wish that nobody has acted on; None where there is none."""
        self._poll()
        return self._pending.pop(0) if self._pending else None

    def _poll(self) -> None:
        wish = self._operator.command()
        if wish is not None:
            self._pending.append(wish)
