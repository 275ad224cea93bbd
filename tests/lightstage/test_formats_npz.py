"""Damaged .npz files: in which errors reading them ends."""

from __future__ import annotations

import io

import numpy as np

from lightstage.formats.npz import UNREADABLE_NPZ


def test_a_changed_or_missing_byte_ends_in_one_of_the_errors_or_changes_nothing() -> None:
    rng = np.random.default_rng(0)
    bits = np.packbits(rng.random(4000) > 0.3)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, bits=bits)
    good = buffer.getvalue()

    def read(data: bytes) -> bool:
        try:
            with np.load(io.BytesIO(data), allow_pickle=False) as file:
                np.testing.assert_array_equal(file["bits"], bits)
        except UNREADABLE_NPZ:
            return False
        return True

    assert read(good)
    refused = 0
    for place in range(len(good)):
        for flip in (0xFF, 0x01, 0x10):
            damaged = bytearray(good)
            damaged[place] ^= flip
            refused += not read(bytes(damaged))
        refused += not read(good[:place])
    assert refused > 3 * len(good)
