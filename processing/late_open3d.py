"""Open3D, imported when something of it is first used.

Its import takes over two seconds of processor time, mostly for its drawings. What reads no mesh
(decoding, separating, a refusal of bad input, `run --why`) ends without it.
"""

from __future__ import annotations

from typing import Any


def __getattr__(name: str) -> Any:
    if name.startswith("__"):  # what Python itself asks of a module
        raise AttributeError(name)
    import open3d

    return getattr(open3d, name)
