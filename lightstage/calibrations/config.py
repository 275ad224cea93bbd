"""What a lab may set about its calibration shots: targets, counts, limits, days."""

from __future__ import annotations

import dataclasses
import math

from lightstage.errors import ConfigError
from lightstage.formats.board import BoardConfig
from lightstage.formats.config import require_bounds

KIND_NAMES = ("charuco", "mirror", "grey", "chart", "dark", "flat")


@dataclasses.dataclass(frozen=True)
class DaysConfig:
    """Days that calibration shots hold when nothing changes, by kind.

    Attributes:
        charuco: cameras stand still but are knocked.
        mirror: lights stand still.
        grey: LEDs age.
        chart: LEDs and filters age.
        dark: sensors' hot pixels come with temperature.
        flat: lenses gather dust.
    """

    charuco: float = 30.0
    mirror: float = 90.0
    grey: float = 30.0
    chart: float = 14.0
    dark: float = 7.0
    flat: float = 90.0


@dataclasses.dataclass(frozen=True)
class LookConfig:
    """What a photograph of a target must show at once. Levels are shares of the white level.

    Attributes:
        looked_at_px: longer side to which a photograph is reduced before targets are searched for.
        min_corners_share: of the board's inner corners, in the camera that it faces.
        min_board_cameras: cameras of a pose that must see at least four corners of the board (all
            of a smaller rig).
        max_clipped_share: of a target's pixels that may be at the white level.
        min_ball_px: diameter of a ball, pixels of the photograph.
        min_ball_filled: share of a grey ball's circle that must be lit under `full`.
        min_highlights: lights that must be seen apart in a mirror ball under `full`.
        max_mirror_filled: share of a mirror ball's circle that may be lit under `full`: lights are
            small in it.
        max_highlights_clipped: share of a mirror ball's highlights that may clip; where they are
            is still known then, how strong they are is not.
        max_dark_level: mean of a dark photograph above black.
        max_dark_bright_share: pixels of a dark photograph ten times above that.
        min_flat_level: mean of a flat photograph.
        min_flat_evenness: a flat's darkest twentieth over its brightest, after smoothing; lenses
            lose up to half their light in the corners.
    """

    looked_at_px: int = 1600
    min_corners_share: float = 0.4
    min_board_cameras: int = 2
    max_clipped_share: float = 0.001
    min_ball_px: float = 24.0
    min_ball_filled: float = 0.9
    min_highlights: int = 4
    max_mirror_filled: float = 0.15
    max_highlights_clipped: float = 0.25
    max_dark_level: float = 2e-3
    max_dark_bright_share: float = 1e-3
    min_flat_level: float = 0.05
    min_flat_evenness: float = 0.4

    def __post_init__(self) -> None:
        """ConfigError on a bound that limits nothing: before a light goes on."""
        require_bounds(
            self,
            "calibration, look",
            {"looked_at_px": (64, 16384), "min_board_cameras": (1, 1000), "min_ball_px": (2, 1e5)},
        )


@dataclasses.dataclass(frozen=True)
class CalibrationConfig:
    """Calibration shots of a lab.

    Attributes:
        wanted: kinds without which a session is refused where a lab's calibrations are named.
        board: the ChArUco board.
        days: how long each kind holds.
        look: limits of the quick checks.
        board_poses_per_camera: boards held toward each camera.
        mirror_poses: places of the mirror ball; two determine how far a lamp is.
        grey_poses: places of the grey ball.
        dark_poses: dark photographs of each camera; the median of several has hardly any noise.
        retakes_per_pose: of a pose that does not show what it must, where nobody is asked.
        takes_per_pose: after which a pose that never shows it stops the command, whoever is asked.
            An operator can change the target's place, its tilt, the light and the exposure; where
            six takes were in vain the target or a limit is wrong, and each take costs disk.
        clock_slack_s: shots may seem so much younger than now before the clock is doubted.
    """

    wanted: tuple[str, ...] = ("charuco", "mirror", "chart", "dark")
    board: BoardConfig = dataclasses.field(default_factory=BoardConfig)
    days: DaysConfig = dataclasses.field(default_factory=DaysConfig)
    look: LookConfig = dataclasses.field(default_factory=LookConfig)
    board_poses_per_camera: int = 2
    mirror_poses: int = 2
    grey_poses: int = 1
    dark_poses: int = 4
    retakes_per_pose: int = 2
    takes_per_pose: int = 6
    clock_slack_s: float = 60.0

    def __post_init__(self) -> None:
        """ConfigError for a kind, board or number that makes no sense."""
        for name in self.wanted:
            require_kind(name, "calibration, wanted")
        self.board.check("calibration, board")
        for field in dataclasses.fields(self.days):
            value = getattr(self.days, field.name)
            if not (math.isfinite(value) and value > 0):
                raise ConfigError(
                    "calibration, days", field=field.name, found=str(value), expected="above 0"
                )
        counts = (
            *("board_poses_per_camera", "mirror_poses", "grey_poses", "dark_poses"),
            "takes_per_pose",
        )
        bounds = {**dict.fromkeys(counts, (1, 1000)), "retakes_per_pose": (0, 1000)}
        require_bounds(self, "calibration", bounds)
        if self.retakes_per_pose >= self.takes_per_pose:
            raise ConfigError(
                "calibration",
                field="retakes_per_pose, takes_per_pose",
                found=f"{self.retakes_per_pose}, {self.takes_per_pose}",
                expected="more takes than retakes",
            )


def require_kind(name: str, where: str) -> str:
    """The name of a kind of calibration shots; ConfigError where there is none such."""
    if name not in KIND_NAMES:
        raise ConfigError(where, found=repr(name), expected=f"one of {', '.join(KIND_NAMES)}")
    return name
