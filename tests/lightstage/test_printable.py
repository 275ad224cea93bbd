"""Nothing that a device says moves a terminal's cursor, breaks a line or has no end."""

import struct

import pytest

from lightstage.cameras.process import CameraProcess
from lightstage.errors import DeviceError, LightstageError
from lightstage.leds import wire
from lightstage.operator.view import View
from lightstage.operator.words import notice_of
from lightstage.printable import LONGEST, printable, printable_lines
from lightstage.tiff import Directory
from tests.lightstage.cameras.camera_drivers import HOSTILE


def safe(text, longest):
    return text.isprintable() and 0 < len(text) <= longest


@pytest.fixture
def camera():
    process = CameraProcess("cam0", "p", None, 20.0, f"{DRIVERS}:Hostile")
    yield process
    process.close()


DRIVERS = "tests.lightstage.cameras.camera_drivers"


def test_a_text_is_one_printable_line_of_bounded_length_that_still_tells_what_was_there():
    text = printable(HOSTILE)
    assert safe(text, LONGEST)
    assert text.startswith("\\x1b[2J\\x1b]0;mine\\x07")
    assert "\\u202eeman\\udcff" in text
    assert printable("Nikon  D750\0\0\0 ") == "Nikon D750"
    assert printable("Müller 日本 …") == "Müller 日本 …"


def test_lines_of_a_message_stay_lines():
    assert printable_lines("2 problems:\n  a\x1b[31m\n  b") == "2 problems:\n  a\\x1b[31m\n  b"


@pytest.mark.parametrize("part", ["where", "field", "found", "expected", "hint"])
def test_no_part_of_an_error_carries_control_characters(part):
    error = LightstageError(**{"where": "camera", part: HOSTILE})
    assert str(error).replace("\n", "").isprintable()
    assert getattr(error, part).replace("\n", "").isprintable()
    assert part == "where" or len(str(error)) < 5000
    str(error).encode()


def test_what_a_camera_tells_of_itself_is_printable(camera):
    summary = camera.open()
    assert safe(summary.model, LONGEST)
    assert safe(summary.firmware, LONGEST)
    assert summary.owner == ""
    assert summary.iso is None


def test_a_drivers_error_and_its_last_words_are_printable(camera):
    camera.open()
    with pytest.raises(DeviceError) as caught:
        camera.change("iso", "100")
    assert safe(str(caught.value), 12_000)
    with pytest.raises(DeviceError) as caught:
        camera.delete("/1.RAW")
    assert safe(str(caught.value), 1000)


def test_a_file_on_a_card_whose_name_cannot_be_shown_is_refused_by_name(camera):
    camera.open()
    with pytest.raises(DeviceError, match="name on the card") as caught:
        camera.card()
    assert safe(str(caught.value), 1000)


def test_what_an_led_device_says_is_printable():
    text = HOSTILE.replace("\udcff", "").replace("\0", "")[:60_000].encode()
    hello = wire.parse_hello(struct.pack("<IH", 7, 8) + text)
    assert safe(hello.firmware, LONGEST)
    assert safe(wire.parse_refused(b"\x02" + text + b"\xff\xfe\0"), LONGEST + 40)


def test_text_of_a_photographs_headers_is_printable():
    data = HOSTILE.encode("utf-8", "surrogatepass")
    assert safe(Directory("picture", {271: data}, {271: 0}).text(271), LONGEST)


@pytest.mark.parametrize("event", ["finding", "failed", "note", "aborted", "waiting", "begin"])
def test_a_line_of_a_journal_from_elsewhere_is_shown_printable(event):
    names = ("said", "found", "expected", "where", "hint", "camera", "pattern", "subject", "code")
    line = {"event": event, **dict.fromkeys(names, HOSTILE), "cameras": [HOSTILE]}
    assert str(notice_of(line, HOSTILE)).isprintable()
    view = View("S")
    view.receive(line)
    view.receive({"event": "devices", "led_device": {"firmware": HOSTILE}, "told": {HOSTILE: {}}})
    assert (view.who + view.lights).isprintable()
