"""Cameras through libgphoto2. The only file that imports gphoto2; in a camera's own process.

What it guards against: memory that goes with its CameraFile; events that come late, in another
order, or of an earlier shot; a wait for events that outlasts its time; RAW and JPEG of one shot;
-53 (another program has the camera), -110 (busy), -7 (I/O). python-gphoto2 keeps Python's lock in
file_delete, exit and autodetect: harmless here, where nothing else runs in the process.

libgphoto2's virtual camera remembers nothing beyond its process: after a restart its card holds
the seed alone, and its names begin anew (GPH_0099.JPG), so that a photograph not yet downloaded
when its process dies is gone. Its 27th shot has no file (-3 where it captures in one call); what
follows in the same process is not to be relied on, and a new process has an empty card.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from lightstage.cameras import gphoto_settings as known
from lightstage.cameras import gphoto_widgets as widgets
from lightstage.cameras.camera import CardFile, Download, Exposure, Summary
from lightstage.cameras.card_file import pieces, write_card_file
from lightstage.cameras.file_names import is_photograph
from lightstage.cameras.gphoto_events import Events, joined
from lightstage.cameras.gphoto_link import Link, Patience
from lightstage.counting import counted
from lightstage.errors import DeviceError


def _library(virtual_folder: Path | None) -> Any:
    """Import gphoto2; its virtual camera is chosen by the environment before the import."""
    if virtual_folder is not None:
        os.environ["VCAMERADIR"] = str(virtual_folder)
    import gphoto2

    if "VCAMERADIR" in os.environ:
        head, tail = os.path.split(os.environ.get("IOLIBS", ""))
        if tail == "iolibs":
            os.environ["IOLIBS"] = os.path.join(head, "vusb")
    return gphoto2


class GphotoCamera:
    """One camera at a port, or libgphoto2's virtual camera on a folder (CameraDriver).

    Args:
        port: such as ``usb:001,004``.
        virtual_folder: holds ``DCIM/100TEST/<seed>.jpg``, whose bytes every shot gives.
        patience: with what passes by itself.
    """

    def __init__(
        self, port: str, virtual_folder: Path | None = None, patience: Patience | None = None
    ) -> None:
        self.port = port
        self.virtual_folder = virtual_folder
        self._events = Events()
        self._link = Link(
            _library(virtual_folder),
            port,
            patience or Patience(),
            lambda: self._events.drain(self._link),
            self._serial,
        )
        self._wanted = 1

    @staticmethod
    def ports(_given: str) -> list[tuple[str, str]]:
        """Model and port of every camera that is connected, whatever port was given."""
        found = _library(None).Camera.autodetect()
        return [(found.get_name(index), found.get_value(index)) for index in range(found.count())]

    def open(self) -> Summary:
        """Connect to the camera at the port; DeviceError when there is none."""
        if self.virtual_folder is not None and not self.virtual_folder.is_dir():
            raise DeviceError(
                self.port,
                field="virtual_folder",
                found=str(self.virtual_folder),
                expected="a folder",
            )
        self._link.connect()
        widgets.keep_on_card(self._link)
        found = self.summary()
        self._events.drain(self._link)
        return found

    def summary(self) -> Summary:
        """The camera's summary, read anew."""
        link = self._link
        found = link.call_with_retries(
            "summary", lambda: widgets.read_summary(link, self._serial())
        )
        self._wanted = known.files_of_a_shot(found.image_format)
        return found

    def change(self, name: str, value: str) -> None:
        """Set a field of Summary and read it back; the clock by the offset that it is to have."""
        link = self._link
        link.call_with_retries(f"change {name}", lambda: widgets.change(link, name, value))
        if name == "image_format":
            self._wanted = known.files_of_a_shot(value)

    def card(self) -> tuple[CardFile, ...]:
        """Every photograph in all folders of all its cards, oldest first."""
        found = self._link.call_with_retries("card", lambda: sorted(self._walk("/")))
        self._events.know(name for _, name, _ in found)
        return tuple(CardFile(name, size) for _, name, size in found)

    def trigger(self, at_s: float) -> Exposure:
        """Trigger at a time and wait for this shot's files.

        A trigger is repeated only where the camera reported that it was busy, so that none was
        taken. Files that could be of an earlier shot too are refused: they stay on the card.
        """
        library, link = self._link.library, self._link
        operations = link.camera.get_abilities().operations
        can_trigger = operations & library.GP_OPERATION_TRIGGER_CAPTURE
        triggered_s = at_s
        if self._events.owed:
            self._events.drain(link)
            self.card()  # what has come since is not this shot's

        def expose() -> str | None:
            nonlocal triggered_s
            triggered_s = time.monotonic()
            if can_trigger:
                link.camera.trigger_capture()
                return None
            return joined(link.camera.capture(library.GP_CAPTURE_IMAGE))

        time.sleep(max(0.0, at_s - time.monotonic()))
        first = link.call_with_retries("trigger", expose, repeatable=False)
        names, exposed_s = self._events.files_of_shot(link, first, self._wanted)
        files = tuple(CardFile(name, self._size(name)) for name in names)
        return Exposure(files, triggered_s, exposed_s)

    def download(self, name: str, path: Path) -> Download:
        """Write a card's file to a new file, hashed where it leaves libgphoto2."""
        link, kind = self._link, self._link.library.GP_FILE_TYPE_NORMAL
        size = self._size(name)
        # `file` must outlive its memory: it is held until the last byte is written.
        file = link.call_with_retries("download", lambda: link.camera.file_get(*_split(name), kind))
        data = memoryview(file.get_data_and_size()).cast("B")
        if len(data) != size or not size:
            raise DeviceError(
                self.port,
                field=name,
                found=counted(len(data), "byte"),
                expected=f"{size} bytes, as the camera reports",
                hint="The download was cut; check the cable.",
            )
        got = write_card_file(path, size, pieces(data))
        del data, file
        self._events.drain(link)  # events of this shot are not taken for the next one's
        return got

    def delete(self, name: str) -> None:
        """Remove a file from the card; python-gphoto2 keeps Python's lock meanwhile."""
        self._link.call_with_retries("delete", lambda: self._link.camera.file_delete(*_split(name)))

    def close(self) -> None:
        """Let go of the camera."""
        self._link.close()

    def _serial(self) -> str | None:
        # The virtual camera reports 0.1 whichever it is: it cannot know.
        if "VCAMERADIR" in os.environ:
            return None
        return widgets.read_text(self._link, "serial")

    def _size(self, name: str) -> int:
        link = self._link
        info = link.call_with_retries("file size", lambda: link.camera.file_get_info(*_split(name)))
        return int(info.file.size)

    def _walk(self, folder: str) -> Iterator[tuple[int, str, int]]:
        """Time, name and size of each photograph below a folder."""
        camera = self._link.camera
        files = camera.folder_list_files(folder)
        for index in range(files.count()):
            name = files.get_name(index)
            if is_photograph(name):
                info = camera.file_get_info(folder, name).file
                yield int(info.mtime), f"{folder.rstrip('/')}/{name}", int(info.size)
        folders = camera.folder_list_folders(folder)
        for index in range(folders.count()):
            yield from self._walk(f"{folder.rstrip('/')}/{folders.get_name(index)}")


def _split(name: str) -> tuple[str, str]:
    """Folder and file of a name on the card."""
    folder, _, file = name.rpartition("/")
    return folder or "/", file
