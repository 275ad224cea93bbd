"""How many of something, in words."""

from __future__ import annotations


def counted(count: int, what: str, many: str = "") -> str:
    """``1 warning``, ``2 warnings``.

    Args:
        count: how many.
        what: one of them.
        many: several of them, where that is not `what` with an ``s``.
    """
    return f"{count} {what if count == 1 else many or what + 's'}"
