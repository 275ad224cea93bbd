"""A template's expressions as the morph targets that face tracking drives, named as ARKit's."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from learning.errors import MapsError
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


def arkit_name(own: str) -> str | None:
    """ARKit's name of an expression, such as eyeBlinkLeft of eyeBlink_L; None where it has none.

    The two halves of what ARKit knows as a whole, such as browInnerUp_L and _R, have its name both.
    """
    sided = re.sub("_L$", "Left", re.sub("_R$", "Right", own))
    camel = re.sub("_([a-z])", lambda found: found[1].upper(), sided)
    half = re.sub("(Left|Right)$", "", camel)
    return camel if camel in ARKIT else half if half in WHOLE else None


def morph_targets(
    template: Path, mesh: Mesh, head_from_mesh: np.ndarray
) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """A template's expressions that ARKit has, turned to a mesh's axes.

    Args:
        template: folder.
        mesh: of the template's vertices, in any rigid pose.
        head_from_mesh: (3, 4), to the template's axes.

    Returns:
        By ARKit's name (n, 3) offsets in mm; and the names of expressions that ARKit lacks.

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
    targets: dict[str, np.ndarray] = {}
    others = []
    if found.modes is not None:
        for own, offsets in zip(found.modes.expression_names, found.modes.expression, strict=True):
            name = arkit_name(own)
            if name is None:
                others.append(own)
                continue
            # Row vectors: the inverse of a rotation is its transpose.
            turned = np.asarray(offsets, float) @ head_from_mesh[:, :3]
            targets[name] = targets.get(name, 0.0) + turned
    return targets, tuple(others)
