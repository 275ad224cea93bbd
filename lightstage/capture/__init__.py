"""One capture: light -> acknowledged -> trigger -> download -> verify -> journal -> checks."""

from lightstage.capture.config import CaptureConfig
from lightstage.capture.run import CaptureReport
from lightstage.capture.session_run import Order, capture_session, unfinished
from lightstage.capture.stage import Stage, open_stage

__all__ = [
    "CaptureConfig",
    "CaptureReport",
    "Order",
    "Stage",
    "capture_session",
    "open_stage",
    "unfinished",
]
