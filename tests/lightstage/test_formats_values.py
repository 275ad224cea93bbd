"""The reader of JSON, JSON Lines and TOML: what it refuses, in a message that names the file."""

import json
import os
import socket
from pathlib import Path

import pytest

from lightstage.errors import ConfigError, FormatError
from lightstage.formats.config import read_toml
from lightstage.formats.files import check_schema, read_json
from lightstage.formats.values import (
    LINE,
    Limits,
    parse_json,
    read_lines,
    read_regular,
    read_toml_value,
    read_value,
)


def said_of(path, read=read_value, error=FormatError):
    """The reader's message, which begins with the file's name."""
    with pytest.raises(error) as caught:
        read(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert len(message) < 600
    return message


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"[" * 200_000, "nested too deeply"),
        (b'{"a":' * 45 + b"1" + b"}" * 45, "nested too deeply"),
        (b'{"lights": [1, ' + b"9" * 9000 + b"]}", "a number of thousands of digits"),
        (b'{"lights": [{"id": ' + b"9" * 40 + b"}]}", "lights[0].id: found a number too large"),
        (b'{"a": [1, NaN]}', "a[1]: found nan"),
        (b'{"a": -Infinity}', "a: found "),
        (b'{"a": 1e999}', "a: found "),
        (b"NaN", "found nan, expected a finite number"),
        (b'{"a": {"path": "x\\u0000y"}}', "a.path: found text with a NUL character"),
        (b'{"a\\u0000": 1}', "'a\\x00': found text with a NUL character"),
        (b'{"a": "\\ud800"}', "a: found text with half a character"),
        (b'{"a": 1, "b": 2, "a": 3}', "a: found the same key twice"),
        (b'\xef\xbb\xbf{"a": 1}', "found a byte-order mark"),
        ('{"a": 1}'.encode("utf-16"), "found a byte-order mark"),
        (b'{"a": "\xff\xfe"}', "byte 7 is not UTF-8"),
        (b'{"a": \x00}', "expected a readable JSON file"),
        (b"", "expected a readable JSON file"),
        (b'{"a": 1} {"a": 2}', "expected a readable JSON file"),
    ],
)
def test_what_json_allows_and_a_program_stumbles_over_is_refused(tmp_path, text, message):
    path = tmp_path / "a.json"
    path.write_bytes(text)
    assert message in said_of(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"a = " + b"[" * 5000 + b"]" * 5000, "nested too deeply"),
        (b"a = " + b"9" * 9000, "expected valid TOML"),
        (b"a = " + b"9" * 30, "a: found a number too large"),
        (b"[table]\nlimit = nan", "table.limit: found nan"),
        (b"limit = -inf", "limit: found -inf"),
        (b'a = "x\\u0000"', "a: found text with a NUL character"),
        (b"a = 2024-02-30", "expected valid TOML"),
        (b"a = [2024-02-03]", "a[0]: found a date"),
        (b"a = 1\na = 2", "expected valid TOML"),
        (b"\xef\xbb\xbfa = 1", "found a byte-order mark"),
        (b'a = "\xff"', "is not UTF-8"),
        (b"a = ", "expected valid TOML"),
    ],
)
def test_toml_is_read_within_the_same_limits(tmp_path, text, message):
    path = tmp_path / "a.toml"
    path.write_bytes(text)
    for read in (read_toml_value, read_toml):
        assert message in said_of(path, read, ConfigError)


@pytest.mark.parametrize(
    ("read", "error"), [(read_value, FormatError), (read_toml_value, ConfigError)]
)
def test_only_a_regular_file_is_read_and_none_is_waited_for(tmp_path, monkeypatch, read, error):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "to-a-device").symlink_to("/dev/zero")
    assert "found a pipe" in said_of(tmp_path / "pipe", read, error)
    assert "found a folder" in said_of(tmp_path / "folder", read, error)
    assert "found a device" in said_of(Path("/dev/zero"), read, error)
    assert "found a device" in said_of(tmp_path / "to-a-device", read, error)
    assert "symbolic links" in said_of(tmp_path / "loop", read, error)
    assert "found no such file" in said_of(tmp_path / "none", read, error)
    assert "Not a directory" in said_of(Path(__file__) / "x", read, error)
    with pytest.raises(error, match="no system takes"):
        read(Path("a\0b"))
    monkeypatch.chdir(tmp_path)  # a socket's whole path must be short
    with socket.socket(socket.AF_UNIX) as bound:
        bound.bind("socket")
        assert "found a socket" in said_of(tmp_path / "socket", read, error)


def test_a_file_over_the_limit_is_refused_before_all_of_it_is_read(tmp_path):
    path = tmp_path / "large.json"
    with path.open("wb") as file:
        file.truncate(1 << 40)  # holds no bytes on the disk
    assert "found more than 64 MiB" in said_of(path)
    with pytest.raises(FormatError, match="at most 1 MiB"):
        read_regular(path, 1 << 20)
    with pytest.raises(FormatError, match="at most 0 MiB"):
        parse_json(b"[1, 2, 3]", "message", Limits(size_bytes=4))


def test_values_within_the_limits_are_what_the_file_says(tmp_path):
    value = {"a": [0, -(2**63), 2**64 - 1, 1.5, -0.0, True, None], "ä": {"": "x\ty 😀"}, "b": []}
    path = tmp_path / "a.json"
    path.write_text(json.dumps(value))
    assert read_value(path) == value
    path.write_text(json.dumps(value, ensure_ascii=False), encoding="utf-8")
    assert read_json(path) == value
    nested = [[]]
    for _ in range(38):
        nested = [nested]
    path.write_text(json.dumps(nested))
    assert read_value(path) == nested


def test_a_line_of_a_capture_may_hold_names_of_a_card_that_are_no_text(tmp_path):
    name = os.fsdecode(b"DSC\xff.NEF")
    path = tmp_path / "a.jsonl"
    path.write_text(json.dumps({"file": name}) + "\n\n" + json.dumps({"id": 2}) + "\n")
    assert read_lines(path) == [{"file": name}, {"id": 2}]
    assert parse_json(json.dumps({"file": name}).encode(), "message", LINE) == {"file": name}
    path.write_text('{"a": 1}\n{"a": nan}\n')
    with pytest.raises(FormatError, match=r"a\.jsonl, line 2: found"):
        read_lines(path)


@pytest.mark.parametrize(
    "schema", ["x.y/²", "x.y/" + "9" * 5000, "x.y/", "x.y", 3, None, ["x.y/1"]]
)
def test_a_schema_of_no_number_is_refused(schema):
    with pytest.raises(FormatError, match="schema"):
        check_schema(Path("a.json"), {"schema": schema}, "x.y/1")
