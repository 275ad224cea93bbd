"""What was freed goes back to the system."""

import ctypes
from pathlib import Path

import numpy as np
import pytest

from processing.pipeline import give_back

PIECES, PIECE_BYTES = 4000, 64 * 1024


def resident_bytes():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="asks Linux for its memory")
def test_pieces_that_were_freed_between_others_go_back():
    if not hasattr(ctypes.CDLL(None), "malloc_trim"):
        pytest.skip("not glibc")
    pieces = [np.ones(PIECE_BYTES, np.uint8) for _ in range(PIECES)]
    held = pieces[::100] + pieces[-1:]
    del pieces
    before = resident_bytes()
    give_back()
    assert before - resident_bytes() > PIECES * PIECE_BYTES // 2
    assert all(piece.all() for piece in held)
