"""Files that mean harm, through the commands that read them: one message, exit 2, nothing left.

Every option that names a TOML file gets each of TOMLS; the weights of a run get each of WEIGHTS;
the files of a store and of a processed folder get each of JSONS. Places that are no files, such as
pipes, stand in for all of them.
"""

from __future__ import annotations

import json
import os
import shutil
import struct
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from lightstage.formats.files import sha256_file
from tests.commands.conftest import COMMANDS
from tests.commands.test_wrong_inputs import words_of
from tests.processing.releases import ABOUT_FILE

PLACES = {
    "pipe": os.mkfifo,
    "circle": lambda path: path.symlink_to(path.name),
    "device": lambda path: path.symlink_to("/dev/zero"),
    "folder": Path.mkdir,
}
TOMLS = {
    "nested": b"a = " + b"[" * 100_000,
    "nested tables": b"[" + b".".join([b"a"] * 5000) + b"]\n",
    "nested to the limit": b"checks = " + b"[" * 60 + b"]" * 60,
    "digits": b"a = " + b"9" * 9000,
    "huge number": b"downloads = 99999999999999999999999999",
    "infinity": b"[safety]\nlight_interval_s = inf",
    "NUL": b"a\0 = 1",
    "escaped NUL": b'a = "\\u0000"',
    "no UTF-8": b"a = '\xff'",
    "date": b"a = 2026-01-02",
    "an unknown key": b"nobody_knows_this = 1",
    "a list for a name": b"based_on = []",
    "array of tables": b"[[safety]]\n[[checks]]\n[[solve]]\n[[people]]",
    **PLACES,
}
OPTIONS = ("--config", "--faults", "--flaws", "--people", "--cameras", "--patterns")
REFUSED_BEFORE = ("lightstage retake", "processing calibrate-cameras")
"""Commands that refuse the imported session or the lab without shots of `world` first."""
FILES = [
    (command, param.opts[0])
    for command in COMMANDS
    for param in command.parser.params
    if param.opts[0] in OPTIONS
]


def put(path, what):
    """Write bytes, or make another thing in the place of a file."""
    path.unlink(missing_ok=True)
    if isinstance(what, bytes):
        path.write_bytes(what)
    else:
        what(path)


def wrong_end(ended):
    """What is wrong with how a command refused; empty where nothing is."""
    printed = ended.err.strip()
    if ended.code == 2 and "Traceback" not in printed and 0 < len(printed) < 4000:
        return ""
    return f"exit {ended.code}, {printed[-400:]}"


def test_every_program_reads_toml_somewhere():
    programs = {command.program for command, _ in FILES}
    assert programs == {"lightstage", "processing", "learning", "sim"}


@pytest.mark.parametrize(("each", "option"), FILES, ids=str)
def test_a_hostile_toml_file_is_refused_by_every_command(
    each, option, world, tmp_path, run_command
):
    failures = {}
    for what, make in TOMLS.items():
        folder = tmp_path / what
        folder.mkdir()
        path = folder / "hostile.toml"
        words = words_of(each, option, str(path), world, folder)
        put(path, make)
        before = sorted(folder.rglob("*"))
        ended = run_command(each.program, *words)
        if wrong := wrong_end(ended):
            failures[what] = wrong
        elif "hostile.toml" not in ended.err and str(each) not in REFUSED_BEFORE:
            failures[what] = ended.err[-300:]
        elif sorted(folder.rglob("*")) != before:
            failures[what] = "something was left"
    assert failures == {}


def header(text, data=b"\0" * 8):
    return struct.pack("<Q", len(text)) + text + data


def entry(**changed):
    return json.dumps({"w": {"dtype": "F32", "shape": [2], "data_offsets": [0, 8], **changed}})


WEIGHTS = {
    "nothing": b"",
    "cut in its length": b"\x10\0\0",
    "cut in its header": struct.pack("<Q", 900) + b'{"w": {"dtype"',
    "a huge header": struct.pack("<Q", (1 << 64) - 1) + b"{}",
    "a header of gigabytes": struct.pack("<Q", 1 << 40) + b"{}",
    "no JSON": header(b"this is no JSON"),
    "no UTF-8": header(b'{"\xff": 1}'),
    "nested": header(b'{"w":' + b"[" * 100_000),
    "a list": header(b"[1, 2]"),
    "digits": header(b'{"w": ' + b"9" * 9000 + b"}"),
    "no such type": header(entry(dtype="F9").encode()),
    "a type of numbers": header(entry(dtype=3).encode()),
    "another type's size": header(entry(dtype="F64").encode()),
    "a shape below zero": header(entry(shape=[-2]).encode()),
    "a shape that overflows": header(entry(shape=[1 << 62, 1 << 62]).encode()),
    "offsets outside": header(entry(data_offsets=[0, 1 << 40]).encode()),
    "offsets that cross": header(entry(data_offsets=[8, 0]).encode()),
    "cut in its data": header(entry().encode(), b"\0"),
    "whole numbers": header(entry(dtype="I32").encode()),
    "another name": header(entry().encode()),
    **PLACES,
}


def test_hostile_weights_are_refused_by_infer(world, tmp_path, run_command):
    failures = {}
    for what, make in WEIGHTS.items():
        run, out = tmp_path / what, tmp_path / f"{what} out"
        shutil.copytree(world["run"], run)
        index = run / "checkpoint.json"
        value = json.loads(index.read_text())
        path = run / value["files"]["generator"]["name"]
        put(path, make)
        if isinstance(make, bytes):
            # Whoever changes the weights changes their hash along.
            value["files"]["generator"]["sha256"] = sha256_file(path)
            index.write_text(json.dumps(value))
        ended = run_command(
            "learning", "infer", "--texture", world["texture"], "--mesh", world["mesh"],
            "--checkpoint", run, "--out", out,
        )  # fmt: skip
        if wrong := wrong_end(ended):
            failures[what] = wrong
        elif out.exists() or str(run) not in ended.err:
            failures[what] = ended.err[-300:]
    assert failures == {}


def test_weights_of_another_type_are_refused_and_not_converted(world, tmp_path, run_command):
    run = shutil.copytree(world["run"], tmp_path / "run")
    index = run / "checkpoint.json"
    value = json.loads(index.read_text())
    path = run / value["files"]["generator"]["name"]
    weights = load_file(path)
    for kind in (np.float64, np.int64, bool):
        save_file({name: each.astype(kind) for name, each in weights.items()}, path)
        value["files"]["generator"]["sha256"] = sha256_file(path)
        index.write_text(json.dumps(value))
        ended = run_command(
            "learning", "infer", "--texture", world["texture"], "--mesh", world["mesh"],
            "--checkpoint", run, "--out", tmp_path / "out",
        )  # fmt: skip
        assert wrong_end(ended) == "", kind
        assert "expected torch.float32" in ended.err
        assert not (tmp_path / "out").exists()


JSONS = {
    "nested": b"[" * 100_000,
    "nested objects": b'{"a":' * 5000 + b"1" + b"}" * 5000,
    "digits": b'{"schema": ' + b"9" * 9000 + b"}",
    "infinity": b'{"schema": 1e999}',
    "NUL": b'{"schema": "\\u0000"}',
    "zeros": b"\0" * 100,
    "no UTF-8": b'{"schema": "\xff"}',
    "twice": b'{"a": 1, "a": 2}',
    "list": b"[]",
    "null": b"null",
    "number": b"3",
    **PLACES,
}
READ_BY = {
    "store": [
        ("learning", "train", "--preset", "demo", "--data"),
        ("processing", "dataset", "publish", "--about", str(ABOUT_FILE)),
    ],
    "published": [
        ("learning", "train", "--preset", "demo", "--data"),
        ("processing", "dataset", "publish", "--about", str(ABOUT_FILE)),
    ],
    "processed": [("processing", "dataset", "build")],
}


@pytest.mark.parametrize("name", READ_BY)
def test_hostile_json_in_a_folder_is_refused_by_who_reads_it(name, world, tmp_path, run_command):
    source = world["store" if name == "published" else name]
    files = sorted(path.relative_to(source) for path in source.rglob("*.json"))
    # `dataset verify` alone reads shards.json, and says what is wrong with it.
    files = [file for file in files if file.name not in ("zarr.json", "shards.json")]
    assert files
    failures, tried = {}, 0
    for file in files:
        for what, make in JSONS.items():
            folder = tmp_path / f"{tried}"
            shutil.copytree(source, folder)
            if name == "published":
                value = json.loads((folder / "dataset.json").read_text())
                (folder / "dataset.json").write_text(json.dumps({**value, "kind": "published"}))
            put(folder / file, make)
            for words in READ_BY[name]:
                tried += 1
                out = tmp_path / f"{tried} out"
                ended = run_command(words[0], *words[1:], folder, "--out", out)
                if wrong := wrong_end(ended):
                    failures[str(file), what, words[1]] = wrong
                elif out.exists():
                    failures[str(file), what, words[1]] = "something was left"
    assert failures == {}
