"""Cameras of a measured rig.json whose lens and pose are not as sure as the others'."""

from __future__ import annotations

from lightstage.findings import Finding
from lightstage.rig import UNCHECKED, UNMEASURED, Rig

_HINT = "Take the boards again (`lightstage calibrate charuco`), held toward them more often."


def measured_rig_findings(rig: Rig) -> list[Finding]:
    """A warning for cameras that `calibrate-cameras` did not measure, and for those unchecked."""
    out = []
    for key, code, found in (
        (UNMEASURED, "camera-not-measured", "not measured: rig.json has an older lens and pose of"),
        (UNCHECKED, "camera-not-checked", "measured on too few boards to be checked:"),
    ):
        unmeasured = rig.more.get(key)
        names = [
            camera.id
            for camera in rig.cameras
            if isinstance(unmeasured, list) and camera.id in unmeasured
        ]
        if names:
            what = f"{found} {', '.join(names)}"
            out.append(Finding("warn", code, "rig.json", what, "every camera measured", _HINT))
    return out
