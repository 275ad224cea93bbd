"""Links that lead out of the folders in which a person is searched for."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from lightstage.errors import LightstageError, one_error
from processing.dataset.scan import DatasetError


def require_no_links_out(folders: Sequence[Path]) -> None:
    """Refuse links that lead out of the folders: what they lead to would neither go nor be found.

    Raises:
        DatasetError: one for each of them, in one message.
    """
    roots = [folder.resolve() for folder in folders]
    problems: list[LightstageError] = []
    for folder in roots:
        for root, below, names in os.walk(folder):
            for path in (Path(root) / name for name in sorted([*below, *names])):
                if not path.is_symlink() or not path.exists():
                    continue
                there = path.resolve()
                if not any(there.is_relative_to(each) for each in roots):
                    problems.append(
                        DatasetError(
                            path,
                            found=f"a link to {there}",
                            expected="links within the folders that are searched alone",
                            hint=f"Search there as well: --in {there}.",
                        )
                    )
    if problems:
        raise one_error(problems)
