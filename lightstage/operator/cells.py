"""Small texts of the picture's table."""

from __future__ import annotations

from rich.text import Text

from lightstage.operator.view import CameraView

LOW_BATTERY_PERCENT = 20.0


def sayable(text: str, encoding: str) -> str:
    """A text with question marks for what an encoding lacks, so that any terminal can show it."""
    if encoding.lower().startswith("utf"):
        return text
    return text.replace("…", ".").encode(encoding, "replace").decode(encoding)


def short(text: str, longest: int) -> str:
    """A text that fits, with two dots where something is missing."""
    return text if len(text) <= longest else f"{text[: longest - 2]}.."


def battery(camera: CameraView) -> Text:
    """Its charge; a low one has an exclamation mark.

    Of a camera that failed, a good one is no longer known: it was reported before.
    """
    if camera.battery_percent is None:
        return Text("-", "dim")
    low = camera.battery_percent < LOW_BATTERY_PERCENT
    if camera.state == "failed" and not low:
        return Text("-", "dim")
    return Text(f"{camera.battery_percent:.0f}%{'!' if low else ''}", "bold yellow" if low else "")


def card(camera: CameraView) -> Text:
    """What fits on its card; of a camera that failed, room is no longer known."""
    free = camera.card_free_bytes
    if free is None or (camera.state == "failed" and free >= 1e6):
        return Text("-", "dim")
    for unit, size in (("TB", 1e12), ("GB", 1e9), ("MB", 1e6)):
        if free >= size:
            return Text(f"{free / size:.0f} {unit}")
    return Text("full!", "bold red")
