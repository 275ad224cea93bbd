"""Errors in which reading a damaged .npz ends."""

from __future__ import annotations

import zipfile
import zlib

UNREADABLE_NPZ = (
    OSError,
    EOFError,
    ValueError,
    KeyError,
    RuntimeError,
    zipfile.BadZipFile,
    zlib.error,
)
"""Whatever `np.load` and the arrays of its file raise where bytes are missing or changed: a flag of
encryption and another method of compression are RuntimeError."""
