"""The configuration of all stages: one table of a TOML file for each."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lightstage.formats.config import make_config, read_toml, require_bounds
from lightstage.formats.mesh import read_ply
from processing.atlas.config import AtlasConfig
from processing.bounds import BOUNDS
from processing.decode.config import DecodeConfig
from processing.reconstruction.colmap_folder import require_maps
from processing.reconstruction.given import require_given
from processing.reconstruction.stage import ReconstructConfig
from processing.refinement.config import RefineConfig
from processing.registration.config import RegisterConfig
from processing.separation.config import SeparateConfig


@dataclasses.dataclass(frozen=True)
class PipelineConfig:
    """Configuration of all stages; a TOML file has one table for each."""

    decode: DecodeConfig = dataclasses.field(default_factory=DecodeConfig)
    """Photographs to linear colour."""
    separate: SeparateConfig = dataclasses.field(default_factory=SeparateConfig)
    """Coarse maps of each view."""
    reconstruct: ReconstructConfig = dataclasses.field(default_factory=ReconstructConfig)
    """The mesh."""
    refine: RefineConfig = dataclasses.field(default_factory=RefineConfig)
    """Exact maps of each view."""
    register: RegisterConfig = dataclasses.field(default_factory=RegisterConfig)
    """The template on the mesh."""
    atlas: AtlasConfig = dataclasses.field(default_factory=AtlasConfig)
    """The views' maps in one texture."""

    def as_forced(self) -> PipelineConfig:
        """The same, continuing where photographs contradict each other or their patterns."""
        prepare = dataclasses.replace(self.decode.prepare, forced=True)
        return dataclasses.replace(
            self,
            decode=dataclasses.replace(self.decode, prepare=prepare),
            separate=dataclasses.replace(self.separate, forced=True),
        )


def read_config(
    path: Path | None,
    atlas_rows: int | None = None,
    mesh: Path | None = None,
    occluders: Path | None = None,
    *,
    force: bool = False,
    take: Callable[[dict[str, Any], str | Path], object] | None = None,
) -> PipelineConfig:
    """Defaults, overridden by a TOML file, overridden by the command line.

    Args:
        path: the file.
        atlas_rows: height of the atlas in texels.
        mesh: of the head, in place of a reconstructed one.
        occluders: mesh of what else casts shadows.
        force: continue where photographs contradict each other or their patterns.
        take: takes tables that are no stage's out of the file's values, such as `take_batch`.

    Raises:
        ConfigError: an unknown table or key, a value of another type, or one that no stage can
            work with (`BOUNDS`).
    """
    values = {} if path is None else read_toml(path)
    where = path or "configuration"
    if take is not None:
        take(values, where)
    found = config_of(values, where, atlas_rows, mesh, occluders)
    return found.as_forced() if force else found


def config_of(
    values: dict[str, Any],
    where: str | Path,
    atlas_rows: int | None = None,
    mesh: Path | None = None,
    occluders: Path | None = None,
) -> PipelineConfig:
    """As `read_config`, of a file's values; `where` is what errors name."""
    config = make_config(PipelineConfig, values, where)
    if atlas_rows is not None:
        config = dataclasses.replace(
            config, atlas=dataclasses.replace(config.atlas, rows=atlas_rows)
        )
    require_bounds(config, where, BOUNDS)
    given = {"mesh": mesh, "occluders": occluders}
    meshes: dict[str, Any] = {name: str(file) for name, file in given.items() if file is not None}
    return dataclasses.replace(
        config, reconstruct=dataclasses.replace(config.reconstruct, **meshes)
    )


def require_named(config: PipelineConfig) -> None:
    """Read the meshes, and find the depth maps, that a configuration names.

    Raises:
        FormatError: no such file or folder, or no mesh and no depth map.
        ReconstructionError: a mesh in another unit than mm.
    """
    if config.decode.mesh:
        read_ply(Path(config.decode.mesh))
    require_given(config.reconstruct)
    if config.reconstruct.colmap_from:
        require_maps(Path(config.reconstruct.colmap_from))
