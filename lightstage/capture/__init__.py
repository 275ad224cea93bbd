"""One capture: light -> acknowledged -> trigger -> download -> verify -> journal -> checks."""

from lightstage.capture.old import CaptureConfig, CaptureReport, capture, connect, worst_shot_s

__all__ = ["CaptureConfig", "CaptureReport", "capture", "connect", "worst_shot_s"]
