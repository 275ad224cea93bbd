"""A library with gphoto2's calls whose cameras misbehave as real ones were seen to do.

Bodies lie in folders below FAKE_GPHOTO2, so that processes see the same ones, also after one was
killed:

    bus.json            port to body
    BODY/body.json      settings, what its calls answer next, what its shots tell
    BODY/card/FOLDER    its files

FAKE_HANGS names a port at which connecting never ends.

Memory of a CameraFile is overwritten when the object is collected, as it is freed in the library.
"""

from __future__ import annotations

import json
import os
import shutil
import time
from pathlib import Path
from types import SimpleNamespace

GP_EVENT_UNKNOWN, GP_EVENT_TIMEOUT, GP_EVENT_FILE_ADDED = 0, 1, 2
GP_EVENT_FOLDER_ADDED, GP_EVENT_CAPTURE_COMPLETE = 3, 4
GP_OPERATION_CAPTURE_IMAGE, GP_OPERATION_TRIGGER_CAPTURE = 1, 32
GP_CAPTURE_IMAGE, GP_FILE_TYPE_NORMAL = 0, 1
GP_WIDGET_TEXT, GP_WIDGET_RADIO, GP_WIDGET_MENU, GP_WIDGET_DATE = 2, 5, 6, 8
GP_STORAGEINFO_FREESPACEKBYTES = 64
POISON = 0xDB
FOLDER = "/store_00010001/DCIM/100ND750"
NIKON = {
    "serialnumber": "6001",
    "deviceversion": "V1.12",
    "expprogram": "M",
    "iso": "100",
    "isoauto": "Off",
    "shutterspeed": "0.0166s",
    "shutterspeed2": "1/60",
    "f-number": "f/8",
    "whitebalance": "Daylight",
    "imagequality": "NEF (Raw)",
    "focusmode": "Manual",
    "batterylevel": "75%",
    "artist": "",
    "copyright": "",
    "capturetarget": "Internal RAM",
}
CHOICES = {
    "iso": ["100", "200", "400"],
    "imagequality": ["JPEG Fine", "NEF (Raw)", "NEF+Fine"],
    "capturetarget": ["Internal RAM", "Memory card"],
    "isoauto": ["On", "Off"],
}


class GPhoto2Error(Exception):
    def __init__(self, code):
        super().__init__(f"[{code}] as scripted")
        self.code, self.string = code, "as scripted"


def root() -> Path:
    return Path(os.environ["FAKE_GPHOTO2"])


def plug(ports: dict[str, str]) -> None:
    """Say which body is at which port now."""
    put(root() / "bus.json", ports)


def put(path, value):
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    beside.write_text(json.dumps(value))
    os.replace(beside, path)


def make_body(name, *, settings=None, answers=None, shots=(), can_trigger=True, **more):
    """A body with an empty card.

    `answers` maps a call to error codes, one for each time, 0 for none; `shots` holds for each
    trigger what is told: "raw", "jpeg", "done", "other", seconds of silence, or
    "late NAME", a file that is told only now.
    """
    shutil.rmtree(root() / name, ignore_errors=True)
    (root() / name / "card" / FOLDER[1:]).mkdir(parents=True)
    put(
        root() / name / "body.json",
        {
            "settings": NIKON | {"serialnumber": name} | (settings or {}),
            "answers": answers or {},
            "shots": list(shots),
            "can_trigger": can_trigger,
            "taken": 0,
            "calls": [],
            "overrun_s": 0.0,
            "longest_wait_ms": 0,
            "keeps": True,
            **more,
        },
    )


def body_of(name) -> dict:
    return json.loads((root() / name / "body.json").read_text())


def bus() -> dict[str, str]:
    return json.loads((root() / "bus.json").read_text())


class _List:
    def __init__(self, entries=()):
        self.entries = list(entries)

    def load(self):
        pass

    def count(self):
        return len(self.entries)

    def get_name(self, index):
        return self.entries[index][0]

    def get_value(self, index):
        return self.entries[index][1]

    def __getitem__(self, index):
        return index


class PortInfoList(_List):
    def lookup_path(self, path):
        return path


class CameraAbilitiesList(_List):
    def detect(self, _):
        return Camera.autodetect()

    def lookup_model(self, model):
        return model


class CameraFile:
    def __init__(self, data):
        self.memory = bytearray(data)

    def get_data_and_size(self):
        return memoryview(self.memory)

    def __del__(self):
        self.memory[:] = bytes([POISON]) * len(self.memory)


class Widget:
    def __init__(self, name, value):
        self.name, self.value = name, value

    def get_value(self):
        return self.value

    def set_value(self, value):
        self.value = value

    def get_type(self):
        return GP_WIDGET_RADIO if self.name in CHOICES else GP_WIDGET_TEXT

    def count_choices(self):
        return len(CHOICES[self.name])

    def get_choice(self, index):
        return CHOICES[self.name][index]


class Camera:
    @staticmethod
    def autodetect():
        return _List(("Nikon DSC D750", port) for port in bus())

    def set_port_info(self, port):
        self.port = port

    def set_abilities(self, _):
        self.lost = True
        self.queue = []

    def init(self):
        self.name = bus()[self.port]
        while os.environ.get("FAKE_HANGS") == self.port:
            time.sleep(1)
        self._answer("init")
        self.lost = False

    def exit(self):
        self._answer("exit", linked=False)
        self.lost = True

    def get_abilities(self):
        more = GP_OPERATION_TRIGGER_CAPTURE if self._body()["can_trigger"] else 0
        return SimpleNamespace(operations=GP_OPERATION_CAPTURE_IMAGE | more)

    def get_single_config(self, name):
        self._answer("get_single_config")
        settings = self._body()["settings"]
        if name not in settings:
            raise GPhoto2Error(-2)
        return Widget(name, settings[name])

    def set_single_config(self, name, widget):
        self._answer("set_single_config")
        body = self._body()
        if body["keeps"]:
            body["settings"][name] = widget.value
            self._save(body)

    def get_storageinfo(self):
        self._answer("get_storageinfo")
        return [SimpleNamespace(fields=64, freekbytes=2_000_000), SimpleNamespace(fields=0)]

    def trigger_capture(self):
        self._answer("trigger_capture")
        self._expose()

    def capture(self, _):
        self._answer("capture")
        self._expose()
        while True:
            kind, data = self.wait_for_event(10)
            if kind == GP_EVENT_FILE_ADDED:
                return data

    def wait_for_event(self, timeout_ms):
        self._answer("wait_for_event")
        body = self._body()
        self._save(body | {"longest_wait_ms": max(timeout_ms, body["longest_wait_ms"])})
        silent_s = timeout_ms / 1e3
        while self.queue:
            entry = self.queue[0]
            if isinstance(entry, float):
                if entry > silent_s:
                    self.queue[0] = entry - silent_s
                    break
                time.sleep(entry)
                silent_s -= entry
                self.queue.pop(0)
                continue
            self.queue.pop(0)
            if entry in ("done", "other"):
                kind = GP_EVENT_CAPTURE_COMPLETE if entry == "done" else GP_EVENT_UNKNOWN
                return kind, None
            return GP_EVENT_FILE_ADDED, SimpleNamespace(folder=FOLDER, name=entry)
        time.sleep(silent_s + self._body()["overrun_s"])
        return GP_EVENT_TIMEOUT, None

    def folder_list_files(self, folder):
        self._answer("folder_list_files")
        return _List((p.name, None) for p in sorted(self._card(folder).iterdir()) if p.is_file())

    def folder_list_folders(self, folder):
        return _List((p.name, None) for p in sorted(self._card(folder).iterdir()) if p.is_dir())

    def file_get_info(self, folder, name):
        self._answer("file_get_info")
        path = self._file(folder, name)
        stated = path.stat()
        return SimpleNamespace(
            file=SimpleNamespace(size=stated.st_size, mtime=int(stated.st_mtime))
        )

    def file_get(self, folder, name, _):
        self._answer("file_get")
        return CameraFile(self._file(folder, name).read_bytes()[: self._body().get("cut")])

    def file_delete(self, folder, name):
        self._answer("file_delete")
        self._file(folder, name).unlink()

    def _expose(self):
        body = self._body()
        body["taken"] += 1
        quality = body["settings"]["imagequality"]
        usual = ["raw", "jpeg", "done"] if "+" in quality else ["raw", "done"]
        script = body["shots"].pop(0) if body["shots"] else usual
        self._save(body)
        for entry in script:
            if entry in ("raw", "jpeg"):
                entry = f"DSC_{body['taken']:04d}.{'NEF' if entry == 'raw' else 'JPG'}"
            if isinstance(entry, str) and entry.startswith("late "):
                entry = entry.removeprefix("late ")
            if isinstance(entry, str) and "." in entry:
                self._card(FOLDER).joinpath(entry).write_bytes(picture(self.name, entry))
            self.queue.append(entry)

    def _answer(self, call, linked=True):
        body = self._body()
        body["calls"].append(call)
        codes = body["answers"].get(call, [])
        code = codes.pop(0) if codes else 0
        self._save(body)
        if linked and call != "init" and self.lost:
            code = -7
        if code == -7:
            self.lost = True
        if code:
            raise GPhoto2Error(code)

    def _body(self):
        return body_of(self.name)

    def _save(self, body):
        put(root() / self.name / "body.json", body)

    def _card(self, folder):
        return root() / self.name / "card" / folder.strip("/")

    def _file(self, folder, name):
        path = self._card(folder) / name
        if not path.is_file():
            raise GPhoto2Error(-108)
        return path


def picture(body: str, name: str) -> bytes:
    """What a body's file holds: nothing like any other's, and long enough to be cut in pieces."""
    import hashlib

    seed = hashlib.sha256(f"{body} {name}".encode()).digest()
    return seed * 2048
