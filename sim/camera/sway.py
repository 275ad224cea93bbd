"""A subject that sways from photograph to photograph."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from sim.camera.flaws import SwayConfig
from sim.people.subject import Subject


def poses(config: SwayConfig, shots: int, seed: int) -> np.ndarray:
    """Where the head is at each photograph, against the first one.

    A first-order autoregressive walk in three shifts and three rotation angles about the neck.

    Args:
        config: see there.
        shots: how many.
        seed: of the walk.

    Returns:
        (shots, 3, 4) rigid, mm: world places from those at the first photograph.
    """
    rng = np.random.default_rng([seed, 0x5A5])
    scale = np.array([config.sway_mm] * 3 + [config.sway_deg] * 3)
    state = np.zeros(6)
    neck = np.array(config.neck_mm, float)
    out = np.zeros((shots, 3, 4))
    for shot in range(shots):
        if shot:
            fresh = np.sqrt(1 - config.memory**2) * scale * rng.standard_normal(6)
            state = config.memory * state + fresh
        rotation = Rotation.from_rotvec(state[3:], degrees=True).as_matrix()
        out[shot, :, :3] = rotation
        out[shot, :, 3] = neck + state[:3] - rotation @ neck
    return out


def moved(subject: Subject, world_from_still: np.ndarray) -> Subject:
    """The subject elsewhere.

    Args:
        subject: as it was.
        world_from_still: (3, 4) rigid, mm.
    """
    rotation, shift = world_from_still[:, :3], world_from_still[:, 3]
    still_from_world = np.eye(4)
    still_from_world[:3, :3] = rotation.T
    still_from_world[:3, 3] = -rotation.T @ shift
    vertices = subject.mesh.vertices @ rotation.T + shift
    return dataclasses.replace(
        subject,
        mesh=dataclasses.replace(subject.mesh, vertices=vertices),
        normal=(subject.normal @ rotation.T.astype(np.float32)).astype(np.float32),
        landmarks_mm=subject.landmarks_mm @ rotation.T + shift,
        head_from_world=subject.head_from_world @ still_from_world,
    )
