"""Fields of a camera that would write who or where into every photograph."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

from lightstage.cameras.camera import CameraDevice, Summary
from lightstage.errors import DeviceError, LightstageError, one_error
from lightstage.findings import Finding

FIELDS = ("owner", "artist", "copyright", "place")
EMPTY = {"place": "off"}
"""What is set to clear a field; the others are set to no text."""
OFF = ("", "off", "disable", "disabled", "none", "no")


def is_empty(name: str, text: str) -> bool:
    """Whether a field of FIELDS is empty."""
    plain = text.replace("\0", " ").strip().casefold()
    return plain in OFF if name == "place" else not plain


def private_fields(summary: Summary) -> list[str]:
    """Names of the fields in which a camera has something."""
    texts = {name: getattr(summary, name) for name in FIELDS}
    return [name for name, text in texts.items() if text is not None and not is_empty(name, text)]


def privacy_findings(summaries: Mapping[str, Summary]) -> list[Finding]:
    """Cameras that would write who or where into photographs; never what they would write."""
    return [
        Finding(
            "refuse",
            "privacy",
            f"camera {camera_id}, {', '.join(names)}",
            "not empty",
            "nothing that names a person or a place",
            "Clear them in the camera's menu, or start the capture with --clear.",
            camera=camera_id,
        )
        for camera_id, summary in summaries.items()
        if (names := private_fields(summary))
    ]


def clear_privacy(cameras: Sequence[CameraDevice]) -> dict[str, Summary]:
    """Clear owner, artist, copyright and place on cameras, all cameras at once.

    Only fields that hold something are changed; photographs on the card stay as they are.

    Returns:
        Camera id to the camera's summary afterwards.

    Raises:
        DeviceError: every camera that failed or still has something, in one message.
    """

    def clear(camera: CameraDevice) -> Summary | LightstageError:
        try:
            for name in private_fields(camera.summary()):
                camera.change(name, EMPTY.get(name, ""))
            summary = camera.summary()
        except LightstageError as error:
            return error
        left = private_fields(summary)
        if left:
            return DeviceError(
                f"camera {camera.id}",
                field=", ".join(left),
                found="not empty after it was cleared",
                expected="nothing that names a person or a place",
                hint="Clear it in the camera's menu.",
            )
        return summary

    if not cameras:
        return {}
    with ThreadPoolExecutor(len(cameras)) as pool:
        results = dict(zip([c.id for c in cameras], pool.map(clear, cameras), strict=True))
    problems = [result for result in results.values() if isinstance(result, LightstageError)]
    if problems:
        raise one_error(problems)
    return {key: value for key, value in results.items() if isinstance(value, Summary)}
