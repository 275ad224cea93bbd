"""Commands of the stage: capture, retake, console, watch, sessions, check, and more."""

from __future__ import annotations

if __name__ == "__main__":
    from lightstage.interrupts import end_without_traceback

    end_without_traceback()  # until the imports below are done

from lightstage.commands import lazy_group, make_app, run_app

COMMANDS = {
    "capture": (
        "lightstage.capture.command",
        "Light, photograph and verify every pattern; lights end dark whatever happens.",
    ),
    "retake": (
        "lightstage.capture.retake_command",
        "Take photographs of a session again; the earlier takes stay on the disk.",
    ),
    "console": (
        "lightstage.console.command",
        "Serve the operator's page on 127.0.0.1 until Ctrl-C; captures continue without it.",
    ),
    "watch": (
        "lightstage.operator.command",
        "Follow a capture from another terminal, or ask it to pause, retake or stop.",
    ),
    "devices": (
        "lightstage.capture.devices_command",
        "Check lights and cameras as a capture does before its first light; nothing is lit.",
    ),
    "sessions": (
        "lightstage.day.command",
        "List the sessions of a folder: whose, of when, whole, checked and processed or not.",
    ),
    "check": (
        "lightstage.checks.command",
        "Verify every hash, size, exposure and pattern of a session, and that its files agree.",
    ),
    "calibrate": (
        "lightstage.calibrations.command",
        "Take calibration shots pose by pose; each is checked before the next.",
    ),
    "calibrations": (
        "lightstage.calibrations.command",
        "List a lab's calibration shots with their age, and how long they still hold.",
    ),
    "patterns": (
        "lightstage.patterns.command",
        "List what each pattern lights, and draw it; with nothing given, list the sequences.",
    ),
    "rig": (
        "lightstage.rig_command",
        "The description of the stage: the places of its lamps and cameras.",
    ),
    "lights": (
        "lightstage.wiring.command",
        "Light single lamps: which one is on which wire.",
    ),
    "import": (
        "lightstage.poses_from_photos.command",
        "Make a session of photographs taken elsewhere.",
    ),
    "landmarks": (
        "lightstage.faces.command",
        "Find a face's points in photographs and write them as landmarks.json.",
    ),
}
"""Each command's module, whose `register(app)` adds it, and the first sentence of its help."""

app = make_app(
    "Drive the light stage: capture a session, check it, import one taken elsewhere.",
    lazy_group(COMMANDS),
)


def main() -> None:
    """Entry point of `lightstage`."""
    run_app(app)


if __name__ == "__main__":
    main()
