"""The cameras file: where cameras are, what they shall tell, what may stay unverified."""

from __future__ import annotations

import dataclasses

import pytest

from lightstage.cameras.binding import find_cameras, read_cameras_file
from lightstage.cameras.process import detect_ports
from lightstage.errors import ConfigError


def written(tmp_path, text):
    path = tmp_path / "cameras.toml"
    path.write_text(text)
    return path


def test_what_cameras_shall_tell_is_read_for_all_and_for_one(tmp_path):
    text = '[expect]\niso = "100"\nshutter = "1/60"\n[cameras.cam1.expect]\niso = "200"\n'
    file = read_cameras_file(written(tmp_path, text))
    assert file.expect == {"iso": "100", "shutter": "1/60"}
    assert file.cameras["cam1"].expect == {"iso": "200"}
    assert file.cameras["cam1"].port is None


def test_a_cameras_file_names_the_driver_that_takes_the_photographs(small_rig, tmp_path):
    text = '[cameras.cam0]\ndriver = "my.stage:Camera"\nport = "tcp:3"\n'
    file = read_cameras_file(written(tmp_path, text))
    rig = dataclasses.replace(small_rig, cameras=small_rig.cameras[:1])
    (camera,) = find_cameras(rig, file, 20.0, detect_ports)
    assert (camera.driver, camera.port) == ("my.stage:Camera", "tcp:3")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[cameras.cam0]\ndriver = "my.stage"', "driver: found 'my.stage', expected package.mod"),
        ('[cameras.cam0]\ndriver = "my stage:x"', "expected package.module:name"),
        ('alow_unverifiable = ["iso"]', "alow_unverifiable: found an unknown key"),
        ('allow_unverifiable = ["colour"]', "found 'colour', expected of serial"),
        ('allow_unverifiable = "iso"', "allow_unverifiable: found 'iso', expected a list"),
        ('[cameras.cam0]\nprot = "usb"', "prot: found an unknown key"),
        (
            "[cameras.cam0]\nport = 3",
            r'cameras\.cam0\.port: found 3, expected a text\. Write it in quotes: "3"',
        ),
        ('[cameras]\ncam0 = "usb"', r"cameras\.cam0: found 'usb', expected a table"),
        ("[cameras", "valid TOML"),
        ('[expect]\nISO = "100"', r"expect\.ISO: found an unknown name, expected of serial"),
        (
            "[expect]\niso = 100",
            r'expect\.iso: found 100, expected a text\. Write it in quotes: "100"',
        ),
        ('[cameras.cam0.expect]\nzoom = "1"', r"cameras\.cam0\.expect\.zoom: found an unknown"),
        ('expect = "100"', "expect: found '100', expected a table"),
    ],
)
def test_a_malformed_cameras_file_is_refused(tmp_path, text, message):
    with pytest.raises(ConfigError, match=message):
        read_cameras_file(written(tmp_path, text))


def test_folders_in_the_cameras_file_are_relative_to_it(tmp_path):
    text = '[cameras.cam0]\nport = "usb:001,001"\nvirtual_folder = "v/cam0"'
    file = read_cameras_file(written(tmp_path, text))
    assert file.cameras["cam0"].virtual_folder == tmp_path / "v" / "cam0"
