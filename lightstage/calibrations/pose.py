"""One pose's photographs, checked: what every camera shows, and whether the pose is usable."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from lightstage.calibrations.config import CalibrationConfig
from lightstage.calibrations.kinds import Kind
from lightstage.calibrations.looks import LOOKS, Amiss
from lightstage.calibrations.picture import read_picture
from lightstage.errors import FormatError
from lightstage.findings import Finding
from lightstage.formats.session import load_session

FEW_CORNERS = 4
"""Corners of a board from which a camera can find how it is held."""


@dataclasses.dataclass(frozen=True)
class PoseLook:
    """What a pose shows.

    Attributes:
        figures: camera id to its figures, JSON-ready.
        findings: what is amiss; one of severity `retake` makes the pose unusable.
    """

    figures: dict[str, dict[str, Any]]
    findings: list[Finding]

    @property
    def is_usable(self) -> bool:
        """Whether no finding asks for a retake."""
        return not any(finding.severity == "retake" for finding in self.findings)


def look_at_pose(root: Path, kind: Kind, index: int, config: CalibrationConfig) -> PoseLook:
    """Check the first pattern's photographs of a pose (all that are `full` or `dark`).

    Args:
        root: the pose's session folder, finished.
        kind: what was photographed.
        index: of the pose, from 0.
        config: limits.

    Raises:
        FormatError: the session is damaged.
    """
    session = load_session(root)
    pattern = session.file.sequence[0]
    faced = kind.faced(session.rig, index)
    figures: dict[str, dict[str, Any]] = {}
    findings: list[Finding] = []
    for camera in session.camera_ids():
        frame = session.frame(pattern, camera)
        try:
            figures[camera], amiss = LOOKS[kind.name](
                read_picture(session.frame_path(frame)), config
            )
        except FormatError as error:
            figures[camera] = {}
            amiss = [Amiss("unreadable", error.found, error.expected, "Take this pose again.")]
        for each in amiss:
            # A board is for many, and what clips in any of them is lost; a chart is for one.
            matters = each.code == "unreadable" or (
                kind.name == "charuco" and each.code == "clipped"
            )
            if matters or faced in (None, camera):
                findings.append(_finding(kind, index, pattern, camera, each))
    if kind.name == "charuco":
        findings += _seen_by_few(kind, index, figures, config)
    return PoseLook(figures, findings)


def _seen_by_few(
    kind: Kind, index: int, figures: dict[str, dict[str, Any]], config: CalibrationConfig
) -> list[Finding]:
    """A board that too few cameras see at once cannot give their poses to each other."""
    seen = [camera for camera, each in figures.items() if each.get("corners", 0) >= FEW_CORNERS]
    wanted = min(config.look.min_board_cameras, len(figures))
    if len(seen) >= wanted:
        return []
    return [
        Finding(
            "retake",
            "board-cameras",
            f"{kind.name}, pose {index + 1}",
            f"the board in the pictures of {', '.join(seen) or 'no camera'}",
            f"at least {wanted} cameras that see it at once",
            "Hold it nearer to the middle of the stage, turned between two cameras.",
        )
    ]


def _finding(kind: Kind, index: int, pattern: str, camera: str, amiss: Amiss) -> Finding:
    return Finding(
        "retake",
        amiss.code,
        f"{kind.name}, pose {index + 1}, {camera}",
        amiss.found,
        amiss.expected,
        amiss.hint,
        pattern=pattern,
        camera=camera,
    )
