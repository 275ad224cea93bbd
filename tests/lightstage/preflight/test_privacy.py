"""Names and places in cameras."""

import dataclasses

import pytest

from lightstage.cameras.camera import Summary
from lightstage.errors import DeviceError
from lightstage.preflight import clear_privacy
from lightstage.preflight.privacy import privacy_findings


class Body:
    """A camera that remembers what was changed; `stubborn` fields do not change."""

    def __init__(self, camera_id, stubborn=(), **fields):
        self.id = camera_id
        self.present = Summary(**fields)
        self.changes = []
        self.stubborn = stubborn

    def summary(self):
        return self.present

    def change(self, name, value):
        self.changes.append((name, value))
        if name not in self.stubborn:
            self.present = dataclasses.replace(self.present, **{name: value})


def test_names_and_places_are_refused_and_not_repeated():
    values = {
        "cam0": Summary(owner="", artist="  ", copyright="\0", place="Off"),
        "cam1": Summary(owner="Ann Person", copyright="(c) Ann", place="51.5 N"),
        "cam2": Summary(),
    }
    (finding,) = privacy_findings(values)
    assert (finding.severity, finding.camera) == ("refuse", "cam1")
    assert "owner, copyright, place" in finding.where
    assert "Ann" not in str(finding)
    assert "51.5" not in str(finding)


def test_only_what_holds_something_is_cleared():
    bodies = [
        Body("cam0", owner="Ann", artist="", place="on", iso="100"),
        Body("cam1", owner="", artist=None, copyright="", place="off"),
    ]
    found = clear_privacy(bodies)
    assert bodies[0].changes == [("owner", ""), ("place", "off")]
    assert bodies[1].changes == []
    assert found["cam0"] == Summary(owner="", artist="", place="off", iso="100")
    assert privacy_findings(found) == []


def test_every_camera_that_cannot_be_cleared_is_reported_in_one_message():
    bodies = [
        Body("cam0", stubborn=("owner",), owner="Ann"),
        Body("cam1", owner="Ann"),
        Body("cam2", stubborn=("artist",), artist="Ann"),
    ]
    with pytest.raises(DeviceError) as caught:
        clear_privacy(bodies)
    message = str(caught.value)
    assert "camera cam0, owner" in message
    assert "camera cam2, artist" in message
    assert "cam1" not in message
    assert "Ann" not in message
    assert bodies[1].present.owner == ""


def test_no_cameras_is_nothing_to_clear():
    assert clear_privacy([]) == {}
