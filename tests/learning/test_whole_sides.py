"""A network's answer to a face and to its mirror image."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from learning.checkpoint import load_whole_face, shipped_weights
from learning.networks.whole_face import WholeFaceNetwork, face_input
from learning.whole.sides import answer_of, sides_mirror


def test_the_shipped_weights_have_faces_with_two_sides() -> None:
    network, _ = load_whole_face(shipped_weights())
    position_mm = network.mean_position_mm[0].permute(1, 2, 0).numpy()
    assert sides_mirror(position_mm)
    assert not sides_mirror(np.roll(position_mm, 12, axis=1))
    assert not sides_mirror(np.zeros_like(position_mm))


def shipped() -> WholeFaceNetwork:
    return load_whole_face(shipped_weights())[0]


def lit_from_one_side(network: WholeFaceNetwork, side: float) -> Tensor:
    """A dark mean person, lit by a lamp at one side: x is `side`."""
    position_mm = network.mean_position_mm
    normal = torch.nn.functional.normalize(position_mm, dim=1)
    light = (0.15 + normal[:, :1] * side).clamp_min(0.02)
    texture = network.mean_log_albedo.exp() * 0.4 * light
    seen = (position_mm != 0).any(dim=1, keepdim=True).float()
    return face_input(texture * seen, normal * seen, position_mm, seen)


def in_a_mirror(inputs: Tensor) -> Tensor:
    """The twin: columns in reverse, and x of normals and positions with the other sign."""
    out = inputs.clone().flip(-1)
    for channel in range(inputs.shape[1]):
        if channel in (3, 6):
            out[:, channel] = -out[:, channel]
    return out


def test_what_a_face_has_beside_the_mean_person_is_the_same_in_a_mirror() -> None:
    network = shipped()
    inputs = lit_from_one_side(network, 0.8)
    mean = network.mean_log_albedo
    beside = [
        answer_of(network, given).diffuse_albedo.log() - mean
        for given in (inputs, in_a_mirror(inputs))
    ]
    torch.testing.assert_close(beside[0], beside[1].flip(3), atol=1e-5, rtol=1e-4)
    with torch.inference_mode():
        alone = [
            network(given).diffuse_albedo.double().log() - mean.double()
            for given in (inputs, in_a_mirror(inputs))
        ]
    assert float((alone[0] - alone[1].flip(3)).abs().max()) > 0.05
    plain = 0.5 * (alone[0] + alone[1].flip(3))
    torch.testing.assert_close(beside[0].double(), plain, atol=1e-5, rtol=1e-4)


def test_a_layout_without_two_sides_has_the_networks_own_answer() -> None:
    network = shipped()
    inputs = lit_from_one_side(network, 0.8)
    network.mean_position_mm.copy_(network.mean_position_mm.roll(12, dims=3))
    with torch.inference_mode():
        alone = network(inputs)
    torch.testing.assert_close(answer_of(network, inputs).diffuse_albedo, alone.diffuse_albedo)


@pytest.mark.parametrize("value", [0.0, 1e-6, 1e6])
def test_answers_are_finite_at_all_exposures(value: float) -> None:
    network = shipped()
    inputs = lit_from_one_side(network, 0.0)
    texture = torch.full((1, 3, *inputs.shape[2:]), value)
    given = face_input(texture, inputs[:, 3:6], network.mean_position_mm, inputs[:, 9:])
    found = answer_of(network, given)
    for image in (found.diffuse_albedo, found.specular_albedo, found.deviation):
        assert np.isfinite(image.numpy()).all()
        assert (image > 0).all()
