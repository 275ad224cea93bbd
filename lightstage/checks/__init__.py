"""What a photograph must show before the operator moves on."""

from lightstage.checks.config import ChecksConfig
from lightstage.checks.photo_measures import Photo, measure_photo
from lightstage.checks.session import CheckReport, check_session
from lightstage.checks.shot import ShotChecks

__all__ = [
    "CheckReport",
    "ChecksConfig",
    "Photo",
    "ShotChecks",
    "check_session",
    "measure_photo",
]
