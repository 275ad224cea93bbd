"""A person of ICT Face Model Light, with our skin on it, sitting in the stage."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from lightstage.formats.mesh import Mesh, vertex_normals
from sim.errors import SimError
from sim.head_modes import EXPRESSIONS
from sim.ict import SOURCE, IctModel, load_ict
from sim.ict_match import head_from_ict, own_uv_of
from sim.ict_paint import paint_inner_parts
from sim.ict_tile import parts_of
from sim.normals import bend_normals
from sim.person import FACE_MIDDLE_MM
from sim.skin import face_from, make_skin, random_complexion
from sim.subject import Subject
from sim.texture import raster_uv, texture_of
from sim.traits import Traits, random_traits

LARGEST_DRAW = 2.0
"""Standard deviations at which a draw is cut off, as the parametric head's are."""
SEAM_MM = 8.0

# Our expressions as blends of the model's shapes; _L and _R together where the name has no side.
BLENDS: dict[str, dict[str, float]] = {
    "smile": {"mouthSmile": 0.85, "cheekSquint": 0.5, "eyeSquint": 0.25},
    "jaw_open": {"jawOpen": 0.55},
    "brow_raise": {"browInnerUp": 0.9, "browOuterUp": 0.9, "eyeWide": 0.4},
    "brow_furrow": {"browDown": 1.0, "noseSneer": 0.3, "eyeSquint": 0.4},
    "pucker": {"mouthPucker": 0.9, "mouthFunnel": 0.15},
    "eyes_closed": {"eyeBlink": 1.0},
}


@dataclasses.dataclass(frozen=True)
class _Draws:
    """All that a person's seed decides but the skin."""

    identity: np.ndarray
    turn: np.ndarray
    place_mm: np.ndarray
    traits: Traits


def ict_subject(
    name: str,
    path: Path,
    seed: int,
    expression: str = "neutral",
    texture_rows: int = 1536,
    traits: Traits | None = None,
) -> Subject:
    """A person drawn from the model.

    Identity coefficients are independent standard normal draws, as the model's makers sample them,
    cut off at two deviations; skin, traits and pose have their own streams of the seed. Sex and age
    of the traits show in the skin alone: the model's modes do not name them.

    Args:
        name: pseudonym.
        path: the model, see `sim.ict.load_ict`.
        seed: chooses the person.
        expression: ``neutral`` or one of `sim.head_modes.EXPRESSIONS`.
        texture_rows: rows of the maps, a multiple of 3 of at least 96; columns are two thirds.
        traits: who the person is; None draws it from the seed.

    Raises:
        SimError: see `load_ict`; an unknown expression, one whose shapes the copy lacks, or a size
            that the tile cannot have.
    """
    if texture_rows < 96 or texture_rows % 3:
        raise SimError(
            f"subject {name}",
            field="texture_rows",
            found=str(texture_rows),
            expected="a multiple of 3, at least 96",
        )
    model = load_ict(path)
    parts = parts_of(model)
    drawn = _draw(seed, len(model.identity), traits)
    person = model.mesh.vertices.copy()
    for weight, mode in zip(drawn.identity, model.identity, strict=True):
        person += weight * mode
    motion = head_from_ict(person, model)
    neutral = person @ motion[:, :3].T + motion[:, 3]
    moved = (person + blend(model, expression)) @ motion[:, :3].T + motion[:, 3]
    shift = drawn.place_mm - drawn.turn @ FACE_MIDDLE_MM
    world = moved @ drawn.turn.T + shift
    mesh = parts.mesh(world[parts.vertices])
    resting = parts.mesh(neutral[parts.vertices])

    face, weights = raster_uv(mesh, texture_rows, texture_rows * 2 // 3)
    triangles = mesh.triangles()
    own_uv, on_skin = own_uv_of(model, texture_rows)
    positions = texture_of(resting.vertices, triangles, face, weights)
    rng = np.random.default_rng([seed, 1])
    complexion = random_complexion(rng, drawn.traits)
    painted = face_from(positions, own_uv, on_skin, int(rng.integers(2**20)))
    skin = make_skin(complexion, painted, rng)
    inner = paint_inner_parts(skin, positions, face, parts, resting, complexion)
    height = np.where(on_skin, skin.height_mm(expression), 0).astype(np.float32)
    smooth = texture_of(vertex_normals(mesh.vertices, triangles), triangles, face, weights)
    placed = texture_of(mesh.vertices, triangles, face, weights)
    return Subject(
        name=name,
        expression=expression,
        mesh=mesh,
        diffuse_albedo=inner.diffuse_albedo,
        specular_albedo=inner.specular_albedo,
        roughness=inner.roughness,
        normal=bend_normals(placed, smooth, height, face >= 0, SEAM_MM),
        translucency=inner.translucency,
        landmarks_mm=world[model.landmarks],
        skin=skin.skin & on_skin,
        head_from_world=np.concatenate([drawn.turn.T, -(drawn.turn.T @ shift)[:, None]], axis=1),
        source=SOURCE,
        distribution=skin.distribution,
        anisotropy=skin.anisotropy,
    )


def blend(model: IctModel, expression: str) -> np.ndarray:
    """(n, 3) mm displacement of all the model's vertices; SimError when it cannot be made."""
    out = np.zeros_like(model.mesh.vertices)
    if expression == "neutral":
        return out
    if expression not in BLENDS:
        raise SimError(
            "subject ict",
            field="expression",
            found=repr(expression),
            expected="neutral, " + ", ".join(EXPRESSIONS),
        )
    missing = []
    for name, strength in BLENDS[expression].items():
        sides = [name] if name in model.expression else [f"{name}_L", f"{name}_R"]
        for side in sides:
            if side in model.expression:
                out += strength * model.expression[side]
            else:
                missing.append(side)
    if missing:
        raise SimError(
            model.where,
            field=f"expression {expression}",
            found=f"no {', '.join(missing)}",
            expected="the whole model's expression shapes",
            hint="Is the clone complete (Git LFS files fetched)?",
        )
    return out


def _draw(seed: int, count: int, traits: Traits | None) -> _Draws:
    identity_rng, pose_rng, traits_rng = (np.random.default_rng([seed, k]) for k in (0, 2, 3))
    turn = Rotation.from_rotvec(np.radians(np.clip(pose_rng.normal(0, 2.0, 3), -4, 4))).as_matrix()
    place = np.clip(pose_rng.normal(0, 3.0, 3), -6, 6) + np.array([0.0, 0.0, 6.0])
    return _Draws(
        np.clip(identity_rng.normal(size=count), -LARGEST_DRAW, LARGEST_DRAW),
        turn,
        place,
        random_traits(traits_rng) if traits is None else traits,
    )


def mean_mesh(model: IctModel) -> Mesh:
    """The mean face as a subject's mesh, head frame, mm."""
    parts = parts_of(model)
    motion = head_from_ict(model.mesh.vertices, model)
    return parts.mesh((model.mesh.vertices @ motion[:, :3].T + motion[:, 3])[parts.vertices])
