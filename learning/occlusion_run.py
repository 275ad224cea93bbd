"""Table and network of a head's cast shadows, made and scored together; and the network's file.

Both come of the same baked pictures. What the network may be used for stands in its checkpoint: the
UV that it was trained in and, where heads were named, those heads alone.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from learning.checkpoint import INDEX, Checkpoint, load_network, save_checkpoint
from learning.errors import CheckpointError, MapsError
from learning.infer_checks import require_head
from learning.render.light_dome import even_directions
from learning.render.occlusion_model import (
    OcclusionConfig,
    OcclusionTable,
    bake_dome,
    default_occlusion,
    default_occlusion_path,
    load_occlusion,
)
from learning.render.occlusion_network import (
    LEAST_ALIKE,
    OcclusionNetwork,
    OcclusionNetworkConfig,
    likeness,
)
from learning.render.occlusion_score import OcclusionScore, score_occlusion, unseen_lights
from learning.render.occlusion_training import BakedHeads, OcclusionTrainConfig, OcclusionTrainer
from learning.render.uv import rasterise
from lightstage.commands import ProgressCallback, quiet
from lightstage.counting import counted
from lightstage.errors import FormatError
from lightstage.formats.config import as_dict
from lightstage.formats.mesh import Mesh, read_mesh
from lightstage.formats.processed import ProcessedFolder
from processing.dataset import read_head_pose

SCORED_SETS = 120
SCORED = 3
"""Random numbers of the scored sets, beside those of the training's stages."""


@dataclasses.dataclass(frozen=True)
class Head:
    """A head whose shadows are baked.

    Attributes:
        mesh: with UV, mm, in the head frame.
        fingerprint: of its surface as its file has it.
    """

    mesh: Mesh
    fingerprint: str


def fingerprint(mesh: Mesh) -> str:
    """SHA-256 of a surface: places of the vertices, and triangles."""
    digest = hashlib.sha256(mesh.vertices.astype("<f8").tobytes())
    digest.update(mesh.triangles().astype("<i4").tobytes())
    return digest.hexdigest()


def read_head(path: Path) -> Head:
    """A head's mesh; brought to the head frame by the head pose that lies beside it, if any.

    Raises:
        FormatError, MapsError: no mesh, one without UV, or none of a head in mm.
    """
    mesh = read_mesh(path)
    if mesh.uvs is None:
        raise MapsError(path, field="uv", found="none", expected="the head's texture coordinates")
    require_head(mesh, path)
    beside = ProcessedFolder(path.parent).head_pose
    pose = read_head_pose(beside) if beside.exists() else np.eye(3, 4)
    return Head(mesh.with_vertices(mesh.vertices @ pose[:, :3].T + pose[:, 3]), fingerprint(mesh))


def bake_heads(
    heads: Sequence[Head],
    config: OcclusionConfig,
    named: Sequence[Path] = (),
    progress: ProgressCallback = quiet,
) -> BakedHeads:
    """Cast shadows of heads that share one UV.

    Raises:
        MapsError: heads of several UVs; `named` are their files.
    """
    rasters = [rasterise(h.mesh, config.rows, config.rows * 2 // 3) for h in heads]
    for index, raster in enumerate(rasters):
        if not np.array_equal(rasters[0].face, raster.face):
            alike = likeness(rasters[0].face, raster.face)
            raise MapsError(
                named[index],
                field="uv",
                found=f"another layout: {alike:.1%} of the texels show the same triangle",
                expected=f"that of {named[0]}",
                hint="Heads of one table or network are registered to one template.",
            )
    directions = even_directions(config.directions)
    seen = [bake_dome(h.mesh, config.rows, directions, progress)[0] > 0.5 for h in heads]
    return BakedHeads(rasters[0], directions, np.array(seen))


def table_of(baked: BakedHeads) -> OcclusionTable:
    """The table of what each texel sees on more than half of the heads."""
    seen = baked.visibility.sum(axis=0, dtype=np.uint16)
    most = 2 * seen > len(baked.visibility)
    return OcclusionTable(np.packbits(most, axis=1), baked.raster.covered, baked.raster.face)


def train_occlusion(
    heads: Sequence[Head],
    baked: BakedHeads,
    table: OcclusionTable,
    config: OcclusionTrainConfig,
    progress: ProgressCallback = quiet,
) -> tuple[OcclusionNetwork, OcclusionScore]:
    """Train a network, and score it beside the table on lights that neither has seen."""
    rng = np.random.default_rng([config.seed, SCORED])
    sizes = config.occlusion
    meshes = [head.mesh for head in heads]
    unseen = unseen_lights(meshes, sizes.rows, sizes.lights, SCORED_SETS, rng, progress)
    trainer = OcclusionTrainer(baked, config, progress)
    trainer.train_autoencoder()
    trainer.fit_regressor()
    fitted = float(unseen.errors(unseen.by_network(trainer.network)).mean())
    trainer.train_jointly()
    return trainer.network, score_occlusion(unseen, table, trainer.network, fitted)


def save_occlusion(
    folder: Path,
    network: OcclusionNetwork,
    config: OcclusionTrainConfig,
    heads: Sequence[Head],
    any_head: bool,
    score: OcclusionScore,
) -> Path:
    """Write a network's checkpoint; returns its index.

    Args:
        folder: the run.
        network: as trained.
        config: of the training.
        heads: trained on.
        any_head: it serves every head of the UV, as a template's; those trained on alone else.
        score: of the network.
    """
    prints = [head.fingerprint for head in heads]
    about = {
        "family": config.family,
        "config": {**as_dict(config), "heads": [] if any_head else prints},
        "data_fingerprint": hashlib.sha256("".join(prints).encode()).hexdigest(),
        "held_out": [],
        "texture_rows": config.occlusion.rows,
        "metrics": score.figures(),
    }
    steps = config.steps + config.joint_steps
    return save_checkpoint(folder, steps, {"network": network.state_dict()}, about)


def load_occlusion_network(path: Path) -> tuple[OcclusionNetwork, Checkpoint]:
    """The network of occlusion of a checkpoint; otherwise as `checkpoint.load_network`."""
    family = OcclusionTrainConfig.family
    made = OcclusionNetwork, "network"
    return load_network(path, family, family, OcclusionNetworkConfig, *made)


def occlusion_table_for(path: Path | None, mesh: Mesh) -> OcclusionTable:
    """A table that may shade a head.

    Args:
        path: of the table; our own template's where None.
        mesh: of the head.

    Raises:
        CheckpointError: no table, or one of another UV.
    """
    where = path or default_occlusion_path()
    table = default_occlusion() if path is None else load_occlusion(path)
    _require_uv(
        table.face,
        mesh,
        where,
        "a head of the UV that the table was baked in",
        "Bake one of the head's template by `lightstage-learning occlusion --template`, "
        "or use --shadows baked.",
    )
    return table


def _require_uv(face: np.ndarray, mesh: Mesh, where: Path, expected: str, hint: str) -> None:
    """CheckpointError where (rows, columns) triangles by texel are not those of a head."""
    try:
        alike = likeness(face, rasterise(mesh, *face.shape).face)
    except FormatError:  # nothing of it is in the tile
        alike = 0.0
    if alike < LEAST_ALIKE:
        raise CheckpointError(
            where,
            field="uv",
            found=f"{alike:.0%} of the texels show the triangle of the head to render",
            expected=f"at least {LEAST_ALIKE:.0%}, {expected}",
            hint=hint,
        )


def occlusion_network_for(path: Path, mesh: Mesh, lights: int) -> OcclusionNetwork:
    """A network that may shade a head.

    Args:
        path: run folder, or its checkpoint.json.
        mesh: of the head, as its file has it.
        lights: in the set that it is lit by.

    Raises:
        CheckpointError, FormatError, ConfigError: no network of occlusion, or one of another UV,
            another head or another count of lights.
    """
    network, about = load_occlusion_network(path)
    where = about.folder / INDEX
    sizes = network.config
    _require_uv(
        network.face.numpy(),
        mesh,
        where,
        "a head of the UV that it was trained in",
        "Train one with `lightstage-learning occlusion --network` on this head or its "
        "template, or use --shadows baked.",
    )
    heads = about.config.get("heads")
    if not isinstance(heads, list):
        raise CheckpointError(where, field="config.heads", found=repr(heads), expected="a list")
    if heads and fingerprint(mesh) not in heads:
        raise CheckpointError(
            where,
            field="config.heads",
            found=f"{counted(len(heads), 'other head')} that it was trained on",
            expected="the head to render",
            hint="Train one on this head (--head) or, for all heads of a template, on that "
            "(--template); or use --shadows baked.",
        )
    if sizes.lights not in (1, lights):
        raise CheckpointError(
            where,
            field="occlusion.lights",
            found=f"a network of {counted(sizes.lights, 'light')}",
            expected=f"one of {counted(lights, 'light')}, as the light set has, or of 1",
            hint="A network of one light takes any number of them.",
        )
    return network
