"""What each stage depends on: its key, and why a stage that ran before must run again."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path
from typing import Any

from lightstage.formats.config import as_dict
from lightstage.formats.files import sha256_file
from lightstage.formats.landmarks import LANDMARKS
from lightstage.formats.session import Frame, Session
from processing.reachable import ROOT, reachable_files
from processing.records import CODE, Record, hash_of

STAGE_MODULES = {
    "decode": "processing.decode.stage",
    "separate": "processing.separation.stage",
    "reconstruct": "processing.reconstruction.stage",
    "refine": "processing.refinement.stage",
    "register": "processing.registration.stage",
    "atlas": "processing.atlas.stage",
}
"""The stages in order, and the module that each one's code is reached from."""
REASONS = {
    "code": "its code has changed",
    "configuration": "its configuration has changed",
    "files": "a file that it reads has changed: the session's, a template's, landmarks, a mesh or "
    "depth maps",
}


@functools.cache
def stage_code(stage: str) -> str:
    """SHA-256 of the source files that a stage's results depend on."""
    files = reachable_files(STAGE_MODULES[stage], CODE)
    return hash_of([(str(path.relative_to(ROOT)), sha256_file(path)) for path in files])


@dataclasses.dataclass(frozen=True)
class StageInputs:
    """What a stage depends on besides the stages before it.

    Attributes:
        parts: name, one of `REASONS`, to a hash.
        key: hash of the parts and of the key of the stage before, which covers all that was
            written before.
    """

    parts: dict[str, str]
    key: str


def stage_inputs(
    session: Session, config: Any, template_hash: str, kept: dict[str, Record]
) -> dict[str, StageInputs]:
    """What each stage depends on.

    Args:
        session: whose photographs are processed.
        config: of all stages, an attribute for each.
        template_hash: of the template's folder, empty where none is read.
        kept: records of stages that count with the key they ran with, not with that of today.

    Returns:
        By stage.
    """
    inputs: dict[str, StageInputs] = {}
    before = ""
    for stage in STAGE_MODULES:
        own = getattr(config, stage)
        parts = {
            "code": stage_code(stage),
            "configuration": hash_of(as_dict(own)),
            "files": hash_of(_files(session, stage, own), template_hash if _fits(stage) else ""),
        }
        inputs[stage] = StageInputs(parts, hash_of(stage, before, parts))
        before = kept[stage].key if stage in kept else inputs[stage].key
    return inputs


def why_stale(
    record: Record | None, inputs: StageInputs, before: str | None, out: Path
) -> str | None:
    """In words why a stage must run; None where it is up to date.

    Args:
        record: of its last run, None where it never ended.
        inputs: what it depends on now.
        before: the first stage before it that must run, None where there is none.
        out: the processed folder.
    """
    if record is None:
        return "it has not run, or did not end"
    if record.key != inputs.key:
        changed = [words for part, words in REASONS.items() if _differs(record, inputs, part)]
        if changed:
            return "; ".join(changed)
        if not record.parts:
            return "an older version ran it, which did not record what it depended on"
    if before is not None:
        return f"{before} runs before it"
    if record.key != inputs.key:
        return "a stage before it ran with other inputs since"
    missing = next((name for name in record.outputs if not (out / name).exists()), None)
    return None if missing is None else f"{missing}, which it wrote, is missing"


def _differs(record: Record, inputs: StageInputs, part: str) -> bool:
    return part in record.parts and record.parts[part] != inputs.parts[part]


def _fits(stage: str) -> bool:
    """Whether a stage reads the template."""
    return stage in ("register", "atlas")


def _files(session: Session, stage: str, config: Any) -> list[str | None]:
    """Hashes of the files that a stage reads and no stage before it has written."""
    if stage == "decode":
        files = [session.root / "rig.json"]
        named = session.file.calibration.model_dump().values()
        for path in [session.root / name for name in named if isinstance(name, str)]:
            # Gains of single pixels are beside the flats that name them.
            files += [path, *sorted(path.parent.glob(f"{path.stem}-*.npz"))]
        read = [sha256_file(path) for path in [*files, *_meshes(config.mesh)]]
        # A photograph that was copied back takes the place of one that was rebuilt.
        return [_read_of(session), *read, *_missing(session)]
    if stage == "reconstruct":
        read = [sha256_file(path) for path in _meshes(config.mesh, config.occluders)]
        # The name of a depth map is its camera's.
        maps = _depth_maps(config.colmap_from)
        return [*read, *(f"{path.name} {sha256_file(path)}" for path in maps)]
    if _fits(stage):
        landmarks = session.root / LANDMARKS
        return [sha256_file(landmarks) if landmarks.is_file() else None]
    return []


def _read_of(session: Session) -> str:
    """Hash of what stages read of session.json: whose it is, and with which consent, they do not.

    Of a photograph that was taken again only its file counts, not the number of the take.
    """
    file, of_frame = session.file, tuple(Frame.model_fields)
    frames = [[getattr(frame, name) for name in of_frame] for frame in file.frames]
    levels = {name: driven.levels for name, driven in file.patterns.items()}
    return hash_of(file.sequence, frames, levels, file.calibration.model_dump())


def _missing(session: Session) -> list[str]:
    """Photographs that session.json lists and that are not there."""
    frames = session.file.frames
    return [f"no {f.path}" for f in frames if not session.frame_path(f).is_file()]


def _depth_maps(folder: str) -> list[Path]:
    """Depth maps of COLMAP's in a folder that a configuration names, empty for none."""
    return sorted(Path(folder).glob("stereo/depth_maps/*.bin")) if folder else []


def _meshes(*names: str) -> list[Path]:
    """Meshes that a configuration names, and that are there."""
    return [Path(name) for name in names if Path(name).is_file()]
