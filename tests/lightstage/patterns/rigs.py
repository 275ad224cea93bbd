"""Rigs for tests of patterns: lights at given places, or anywhere."""

import numpy as np
from hypothesis import strategies as st

from lightstage.rig import Light, Rig


def rig_at(places, gains=None):
    """Lights at (n, 3) places in mm, banks in turn."""
    lights = [
        Light(
            i,
            f"arc{i // 4:02d}/light{i % 4:02d}",
            tuple(float(c) for c in place),
            "horizontal" if i % 2 else "vertical",
            (1.0, 1.0, 1.0) if gains is None else tuple(float(g) for g in gains[i]),
        )
        for i, place in enumerate(places)
    ]
    return Rig(tuple(lights), ())


numbers = st.floats(-1, 1) | st.sampled_from([0.0, -0.0, 1e-9, -1e-7, 1e-5, 0.5, 1.0, -1.0])
places = st.lists(
    st.tuples(numbers, numbers, numbers).filter(lambda v: np.linalg.norm(v) > 1e-3),
    min_size=1,
    max_size=14,
)


@st.composite
def any_rig(draw):
    """Any number of lights in any directions, crowded, doubled or in a plane; any distances."""
    directions = np.array(draw(places))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    scale = draw(st.floats(1.0, 1e6))
    far = np.array([draw(st.sampled_from([1.0, 1.0, 1.7])) for _ in directions])
    return rig_at(directions * scale * far[:, None])
