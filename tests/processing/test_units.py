"""The unit of a mesh by its size."""

from __future__ import annotations

import numpy as np
import pytest

from processing.units import CM, METRES, MM, Unit, likely_unit


@pytest.mark.parametrize(
    ("side", "unit"),
    [(250, MM), (1800, MM), (25, CM), (60, CM), (0.25, METRES), (0.9, METRES), (1.8, METRES)],
)
def test_a_head_a_bust_and_a_body_have_the_unit_in_which_they_are_no_smaller_than_a_face(
    side: float, unit: Unit
) -> None:
    assert likely_unit(np.array([[0.0, -side / 2, 1.0], [0.1, side / 2, 1.0]])) is unit
