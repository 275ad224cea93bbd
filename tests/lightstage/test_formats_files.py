"""Files and folders that are whole or absent."""

import hashlib
import json
import os
from pathlib import Path

import pytest

from lightstage.errors import FormatError
from lightstage.formats.files import (
    atomic_folder,
    atomic_path,
    check_schema,
    leftovers,
    others_below,
    read_json,
    sha256_file,
    write_bytes,
    write_json,
    write_text,
)


def test_a_written_file_is_there_and_alone(tmp_path):
    path = write_bytes(tmp_path / "new" / "a.bin", b"123")
    assert path.read_bytes() == b"123"
    assert os.listdir(path.parent) == ["a.bin"]


def test_what_killed_writers_left_is_found_and_nothing_else(tmp_path):
    kinds = {
        "weights-1.bin": lambda path: atomic_path(path),
        "person-1": lambda path: atomic_folder(path, "marker"),
    }
    for name, writer in kinds.items():
        with writer(tmp_path / name) as beside:
            if not beside.is_dir():
                beside.write_bytes(b"1")
            assert leftovers(tmp_path, name) == [beside]
            assert leftovers(tmp_path, name.replace("1", "*")) == [beside]
            assert leftovers(tmp_path, name.replace("1", "2")) == []
        assert leftovers(tmp_path, name) == []


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path):
    path = write_text(tmp_path / "a.exr", "old")

    def fail():
        with atomic_path(path) as beside:
            assert beside.suffix == ".exr"
            beside.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["a.exr"]


def test_a_folder_appears_whole_or_not_at_all(tmp_path):
    out = tmp_path / "store"

    def fill(text, fail):
        with atomic_folder(out, "mark.json") as beside:
            (beside / "mark.json").write_text(text)
            if fail:
                raise ValueError("stop")

    with pytest.raises(ValueError, match="stop"):
        fill("a", fail=True)
    assert os.listdir(tmp_path) == []
    fill("b", fail=False)
    assert (out / "mark.json").read_text() == "b"
    with pytest.raises(ValueError, match="stop"):
        fill("c", fail=True)
    assert (out / "mark.json").read_text() == "b"
    fill("d", fail=False)
    assert (out / "mark.json").read_text() == "d"
    assert os.listdir(tmp_path) == ["store"]


def test_of_a_link_to_a_folder_the_folder_is_replaced_and_the_link_stays(tmp_path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "disk")
    for text in ("old", "new"):
        with atomic_folder(tmp_path / "out", "mark.json") as beside:
            (beside / "mark.json").write_text(text)
    assert (tmp_path / "out").is_symlink()
    assert (tmp_path / "disk" / "mark.json").read_text() == "new"
    assert sorted(os.listdir(tmp_path)) == ["disk", "out"]


def test_somebody_elses_folder_is_refused(tmp_path):
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "a.jpg").write_text("mine")

    def fill():
        with atomic_folder(tmp_path / "photos", "mark.json"):
            raise AssertionError("never here")

    with pytest.raises(FormatError, match=r"holds no mark\.json"):
        fill()
    assert os.listdir(tmp_path / "photos") == ["a.jpg"]


@pytest.mark.parametrize("text", ['{"kind": "store"}', '{"kind": 3}', "{}", "[]", '{"kind": "pub'])
def test_a_folder_of_another_kind_is_refused(tmp_path, text):
    (tmp_path / "out").mkdir()
    marker = tmp_path / "out" / "mark.json"
    marker.write_text(text)

    def fill():
        with atomic_folder(tmp_path / "out", "mark.json", "published") as beside:
            (beside / "mark.json").write_text("new")

    with pytest.raises(FormatError, match=r"mark\.json is of kind .*, not 'published'"):
        fill()
    assert marker.read_text() == text
    marker.write_text('{"kind": "published"}')
    fill()
    assert marker.read_text() == "new"


def test_a_folder_with_files_of_others_is_not_replaced(tmp_path):
    out, own = tmp_path / "out", ["mark.json", "maps/*.exr"]
    (out / "maps" / "deep").mkdir(parents=True)
    for name in ("mark.json", "maps/a.exr", "maps/Thumbs.db", ".DS_Store"):
        (out / name).touch()
    assert others_below(tmp_path / "none", own) == others_below(out, own) == []
    (out / "maps" / "deep" / "b.exr").touch()
    (out / "mine").symlink_to(tmp_path / "gone")
    assert others_below(out, own) == ["maps/deep/b.exr", "mine"]
    message = r"out: found maps/deep/b\.exr and 1 more file, which the command did not make"
    with pytest.raises(FormatError, match=message), atomic_folder(out, "mark.json", own=own):
        raise AssertionError("never here")
    assert (out / "mine").is_symlink()
    (out / "mine").unlink()

    def put_meanwhile():
        with atomic_folder(out, "mark.json", own=[*own, "maps/deep/*"]) as beside:
            (beside / "mark.json").touch()
            (out / "mine").touch()

    with pytest.raises(FormatError, match="found mine, which"):
        put_meanwhile()
    assert (out / "mine").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_json_with_nan_is_refused_and_leaves_nothing(tmp_path):
    with pytest.raises(ValueError, match="JSON"):
        write_json(tmp_path / "a.json", {"x": float("nan")})
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "a readable JSON file"),
        ("[]", "schema: found None"),
        ('{"schema": "lightstage.rig/2"}', "newer version"),
        ('{"schema": "lightstage.rig/x"}', "expected 'lightstage.rig/1'"),
        ('{"schema": "other/1"}', "expected 'lightstage.rig/1'"),
    ],
)
def test_json_of_another_kind_is_refused(tmp_path, text, message):
    path = tmp_path / "a.json"
    path.write_text(text)
    with pytest.raises(FormatError, match=message) as caught:
        read_json(path, "lightstage.rig/1")
    assert str(path) in str(caught.value)


def test_a_missing_json_file_is_an_error_with_its_name(tmp_path):
    with pytest.raises(FormatError, match=r"none\.json: found no such file"):
        read_json(tmp_path / "none.json")


def test_a_minor_version_is_taken(tmp_path):
    check_schema(tmp_path, {"schema": "lightstage.rig/1.3"}, "lightstage.rig/1")
    assert read_json(write_json(tmp_path / "a.json", {"schema": "a/1", "b": 2}), "a/1")["b"] == 2
    assert json.loads((tmp_path / "a.json").read_text())["b"] == 2


def test_a_hash_is_of_the_bytes_on_disk(tmp_path):
    data = os.urandom(300_000)
    assert sha256_file(write_bytes(tmp_path / "a", data)) == hashlib.sha256(data).hexdigest()


@pytest.mark.parametrize("name", [".", "..", "inner/..", "../../{}/here"])
def test_the_working_folder_and_those_above_are_refused_as_they_would_vanish(
    tmp_path, monkeypatch, name
):
    (tmp_path / "here" / "inner").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "here")
    with (
        pytest.raises(FormatError, match="found the working folder, or one above it"),
        atomic_folder(Path(name.format(tmp_path.name)), "marker.json"),
    ):
        raise AssertionError("never here")
    assert [path.name for path in tmp_path.rglob("*")] == ["here", "inner"]
