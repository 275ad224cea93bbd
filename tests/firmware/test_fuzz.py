"""Damaged packets by the hundred thousand, with address and undefined-behaviour sanitizers."""

from __future__ import annotations

import re
import subprocess

import pytest


@pytest.mark.parametrize(("lights", "inputs"), [(3, 200_000), (168, 15_000)])
def test_no_damaged_frame_lights_a_lamp_and_no_sanitizer_finds_anything(
    compiled, lights, inputs
) -> None:
    done = subprocess.run(
        [compiled("fuzz", lights), str(inputs), "1"], capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, ""), done.stdout
    printed = [int(number) for number in re.findall(r"\d+", done.stdout)]
    assert printed[0] == inputs
    damaged, whole, replies, changes, silences = printed[1:]
    # It was put to the test: half were damaged, many were whole and did something.
    assert damaged > 0.4 * inputs
    assert whole > 0.3 * inputs
    assert replies > 0.2 * inputs
    assert changes > 0.1 * inputs
    assert silences > 0.005 * inputs
