"""A template's expressions as the morph targets that face tracking drives, named as ARKit's."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from learning.errors import MapsError
from lightstage.formats.expression_sides import left_share, rising
from lightstage.formats.mesh import Mesh
from lightstage.formats.template import load_template

SIDED = (
    "browDown", "browOuterUp", "cheekSquint", "eyeBlink", "eyeLookDown", "eyeLookIn", "eyeLookOut",
    "eyeLookUp", "eyeSquint", "eyeWide", "mouthDimple", "mouthFrown", "mouthLowerDown",
    "mouthPress", "mouthSmile", "mouthStretch", "mouthUpperUp", "noseSneer",
)  # fmt: skip
WHOLE = (
    "browInnerUp", "cheekPuff", "jawForward", "jawLeft", "jawOpen", "jawRight", "mouthClose",
    "mouthFunnel", "mouthLeft", "mouthPucker", "mouthRight", "mouthRollLower", "mouthRollUpper",
    "mouthShrugLower", "mouthShrugUpper", "tongueOut",
)  # fmt: skip
ARKIT = (*(f"{name}{side}" for name in SIDED for side in ("Left", "Right")), *WHOLE)
"""The 52 blend shapes of ARKit [ARKit17]."""

HEAD_FRAME_DEG = 10.0
"""Registered heads in the head frame are turned by less against the template."""
OURS = {
    "smile": ("mouthSmileLeft", "mouthSmileRight"),
    "jaw_open": ("jawOpen",),
    "brow_raise": ("browInnerUp", "browOuterUpLeft", "browOuterUpRight"),
    "brow_furrow": ("browDownLeft", "browDownRight"),
    "pucker": ("mouthPucker",),
    "eyes_closed": ("eyeBlinkLeft", "eyeBlinkRight"),
}
"""Of each expression of our own template, ARKit's whose sum it is."""
INNER_MM, OUTER_MM = 18.0, 42.0
"""From the middle: a raised brow is ARKit's inner one up to the first, its outer one beyond the
second."""
PHOTO = "photo"
"""Morph target from a neutral face to the expression of its photograph."""


def morph_names(own: str) -> tuple[str, ...]:
    """Names of the morph targets whose sum an expression of a template is.

    They are ARKit's where ARKit has the movement: eyeBlinkLeft of ICT's eyeBlink_L. The two halves
    of what ARKit knows as a whole, such as browInnerUp_L and _R, have its name both. Others are in
    the same style: noseDilatationLeft of MakeHuman's nose-left-dilatation. None for the numbered
    modes of a basis, which are no movements.
    """
    if own in OURS:
        return OURS[own]
    if re.search(r"\d$", own):
        return ()
    side = re.search(r"[-_](left|right|L|R)(?=[-_]|$)", own)
    sided = own if side is None else own[: side.start()] + own[side.end() :]
    first, *others = re.split(r"[-_ ]+", sided)
    camel = first[:1].lower() + first[1:] + "".join(word[:1].upper() + word[1:] for word in others)
    end = "" if side is None else "Left" if side[1] in ("left", "L") else "Right"
    return (camel if camel in WHOLE else camel + end,)


def morph_parts(own: str, offsets: np.ndarray, x_mm: np.ndarray) -> dict[str, np.ndarray]:
    """An expression as the morph targets of `morph_names`, whose sum it is.

    Args:
        own: name of the expression.
        offsets: (n, 3) of its vertices.
        x_mm: (n,) places of the vertices in the head frame, left of the head above 0.
    """
    names = morph_names(own)
    if len(names) < 2:
        return dict.fromkeys(names, offsets)
    left, outer = left_share(x_mm), rising(np.abs(x_mm), INNER_MM, OUTER_MM)
    parts = {}
    for name in names:
        share = np.ones(len(x_mm))
        if "Inner" in name or "Outer" in name:
            share = outer if "Outer" in name else 1 - outer
        if name.endswith(("Left", "Right")):
            share = share * (left if name.endswith("Left") else 1 - left)
        parts[name] = share[:, None] * offsets
    return parts


def axes_of(mesh: Mesh, head: Mesh) -> np.ndarray:
    """(3, 3) rotation from a mesh's axes to a template's, by vertices in the same order.

    A person is not the template: what turns a head less than `HEAD_FRAME_DEG` is the shape, and the
    mesh is in the head frame.
    """
    own, other = (each - each.mean(axis=0) for each in (mesh.vertices, head.vertices))
    rotation, _ = Rotation.align_vectors(other, own)
    return np.eye(3) if np.degrees(rotation.magnitude()) < HEAD_FRAME_DEG else rotation.as_matrix()


def morph_targets(
    template: Path, mesh: Mesh, head_from_mesh: np.ndarray | None
) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """A template's expressions under the names of `morph_names`, turned to a mesh's axes.

    Args:
        template: folder.
        mesh: of the template's vertices, in any rigid pose.
        head_from_mesh: (3, 4), to the template's axes; None estimates it from the vertices.

    Returns:
        By name (n, 3) offsets in mm; and the names of expressions that are no movements.

    Raises:
        MapsError: the mesh is of another template.
    """
    found = load_template(template)
    same = found.mesh.faces.shape == mesh.faces.shape and np.array_equal(
        found.mesh.faces, mesh.faces
    )
    if not same or len(found.mesh.vertices) != len(mesh.vertices):
        raise MapsError(
            template,
            field="--template",
            found=f"{len(found.mesh.vertices)} vertices, {len(found.mesh.faces)} faces",
            expected=f"the mesh's {len(mesh.vertices)} and {len(mesh.faces)}, in its order",
            hint="Give the template that the head was registered to.",
        )
    turn = axes_of(mesh, found.mesh) if head_from_mesh is None else head_from_mesh[:, :3]
    targets: dict[str, np.ndarray] = {}
    others = []
    if found.modes is not None:
        x_mm = found.mesh.vertices[:, 0]
        for own, offsets in zip(found.modes.expression_names, found.modes.expression, strict=True):
            parts = morph_parts(own, np.asarray(offsets, float), x_mm)
            if not parts:
                others.append(own)
            for name, part in parts.items():
                # Row vectors: the inverse of a rotation is its transpose.
                targets[name] = targets.get(name, 0.0) + part @ turn
    return targets, tuple(others)
