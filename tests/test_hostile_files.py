"""Whatever stands in a JSON, JSON Lines or TOML file, its reader takes it or says what is wrong.

Two tables. Texts that no reader takes (nested deeply, numbers of thousands of digits, pipes, links
that lead in circles, ..) are written over every file in turn. And each value of a valid file is
replaced in turn by values of other kinds: the file is read, or refused by its name.
"""

import copy
import functools
import json
import operator
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from lightstage.cameras.cameras_file import read_cameras_file
from lightstage.capture.command import read_config
from lightstage.capture.session_run import config_of, unfinished
from lightstage.errors import LightstageError
from lightstage.formats import template
from lightstage.formats.calibration_shots import read_shots
from lightstage.formats.cameras import read_session_cameras
from lightstage.formats.config import as_dict, read_toml
from lightstage.formats.environment import read_lights
from lightstage.formats.files import write_json
from lightstage.formats.landmarks import read_points_mm, read_points_px
from lightstage.formats.lights import read_measured_lights
from lightstage.formats.session import load_session
from lightstage.formats.template import default_template_path, load_template
from lightstage.patterns import read_patterns
from lightstage.poses_from_photos.points import read_clicks
from lightstage.rig import Camera, Light, Rig, load_rig, look_at, rig_to_json
from lightstage.session import SessionState, read_calibration, read_colour, read_journal
from lightstage.session.manifest import check_manifest

RIG = Rig(
    tuple(
        Light(i, f"corner{i}", (700.0 * x, 700.0 * y, 700.0), "vertical")
        for i, (x, y) in enumerate([(1, 1), (1, -1), (-1, 1), (-1, -1)])
    ),
    tuple(
        Camera(
            *(f"cam{i}", f"60{i}", "D750", 32, 48, 140.0, 140.0, 16.0, 24.0, (0.0,) * 5),
            look_at(np.array([100.0 * i, 0, 1100]), np.zeros(3)),
        )
        for i in range(2)
    ),
)
EYE = np.eye(3).tolist()
HASH = "0" * 64
TIME = "2026-01-02T03:04:05+00:00"
POINT = [1.5, 2.5, 3.5]

SESSION = {
    "schema": "lightstage.session/1",
    "id": "s1",
    "created_utc": TIME,
    "subject": "p-1",
    "expression": "neutral",
    "sequence": ["full"],
    "frames": [
        {
            "pattern": "full", "camera": "cam0", "path": "frames/full/cam0.dng", "sha256": HASH,
            "encoding": "raw",
        },
    ],
    "patterns": {"full": {"levels": [1.0, 1.0, 0.5, 0.5]}},
    "calibration": {"colour": "calibration/colour.json", "cameras": "calibration/cameras.json"},
}  # fmt: skip
PHOTOGRAPH = {"pattern": "full", "camera": "cam0", "take": 1}
JOURNAL = [
    {
        "event": "begin", "schema": "lightstage.journal/2", "session": "s1", "created_utc": TIME,
        "subject": "p-1", "expression": "neutral", "consent": None, "sequence": ["full"],
        "cameras": ["cam0", "cam1"], "cards": {"cam0": [["a.nef", 7]]}, "serials": {"cam0": "600"},
        "calibration": {"colour": "calibration/colour.json"}, "rig_sha256": HASH,
        "levels": {"full": [1.0, 1.0, 0.5, 0.5]}, "config": {"downloads": 3}, "facts": {},
        "told": {"cam0": {"serial": "600"}},
    },
    {"event": "lit", "pattern": "full", "acknowledged": True, "levels": [1.0] * 4},
    {"event": "trigger", "pattern": "full", "takes": {"cam0": 1}},
    {"event": "exposed", **PHOTOGRAPH, "file": ["b.nef", 9], "beside": [["b.jpg", 3]]},
    {
        "event": "frame", **PHOTOGRAPH, "path": "frames/full/cam0.nef", "sha256": HASH,
        "encoding": "raw", "size": 9, "file": "b.nef",
    },
    {"event": "rejected", **PHOTOGRAPH, "why": "blur"},
    {
        "event": "recovered", "camera": "cam0", "path": "recovered/cam0/c.nef", "sha256": HASH,
        "file": ["c.nef", 4], "pattern": "full", "why": "left",
    },
    {"event": "deleting", "pattern": "full", "camera": "cam0", "file": ["b.nef", 9]},
    {"event": "deleted", "pattern": "full", "camera": "cam0", "file": ["b.nef", 9]},
    {"event": "finding", "code": "blur", "severity": "warn"},
    {"event": "note", "about": "card", "cards": {"cam0": [["d.nef", 2]]}},
    {"event": "shot", "pattern": "full"},
    {"event": "calibration", "colour": "calibration/colour.json"},
    {"event": "resume", "cards": {"cam0": []}},
    {"event": "end"},
]  # fmt: skip
JOURNAL = [
    {"id": i, "time_utc": TIME, "elapsed_s": float(i), **line} for i, line in enumerate(JOURNAL, 1)
]
COLOUR = {
    "schema": "lightstage.colour/1",
    "cameras": {f"cam{i}": {"linear_from_raw": EYE, "exposure": 1.0} for i in range(2)},
    "full_levels": [1.0, 1.0, 0.5, 0.5],
}
CAMERAS = {
    "schema": "lightstage.cameras/1", "approximate": True, "residual_px": 0.3,
    "scale": {"lengths": {"eyes": 63.0}},
}  # fmt: skip
FLAT = {
    "width_px": 32, "height_px": 48, "centre_px": [16.0, 24.0], "radius_px": 28.0,
    "radial": [0.1, 0.0, 0.0], "per_pixel": None, "black_offset": None, "hot_pixels": [[1, 2]],
}  # fmt: skip
LIGHTS = {
    "schema": "lightstage.lights/1", "exponent": 1.0,
    "lights": [
        {
            "id": light.id, "position_mm": [x + 1.0 for x in light.position_mm],
            "rgb_gain": [1.0] * 3, "gain_sigma": 0.01, "position_sigma_mm": 1.0, "residual_px": 0.5,
        }
        for light in RIG.lights
    ],
    "stray": {"full": np.zeros((3, 3, 4)).tolist()}, "facts": {},
}  # fmt: skip
MANIFEST = {
    "schema": "lightstage.manifest/1", "light_map_sha256": HASH,
    "files": {"rig.json": HASH, "session.json": HASH},
    "journal": {"bytes": 12, "last_id": 1, "sha256": HASH, "path": "journal.jsonl"},
}  # fmt: skip
SHOTS = {
    "schema": "lightstage.calibration-shots/1", "id": "c1", "kind": "dark", "created_utc": TIME,
    "finished_utc": TIME, "expires_utc": TIME, "rig_sha256": HASH, "patterns": ["full"],
    "devices": {"cameras": {"cam0": {"serial": "600"}}, "leds": {"firmware": "1"}},
    "poses_wanted": 1, "takes": {"0": 1},
    "poses": [
        {
            "index": 0, "folder": "pose-0", "faces": None, "session_sha256": HASH,
            "manifest_sha256": None, "figures": {"cam0": {"level": 0.1}}, "accepted": [],
        }
    ],
}  # fmt: skip
ENVIRONMENT = {
    "schema": "lightstage.environment/1", "name": "key", "ambient_rgb": [0.1] * 3,
    "lights": [{"position_mm": [500.0, 0.0, 900.0], "rgb": [1.0] * 3}],
}  # fmt: skip
MARKS = {"schema": "lightstage.landmarks/1", "scheme": "ibug68"}
CLICKS = {"schema": "lightstage.points/1", "points_px": {"cam0": {"left": [1.0, 2.0]}}}
CHECKPOINT = {
    "schema": "lightstage.checkpoint/1", "step": 3, "config": {}, "data_fingerprint": HASH,
    "held_out": ["p-1"], "texture_rows": 64, "code_version": "1", "metrics": {"loss": 0.1},
    "files": {"generator": {"name": "generator-1.safetensors", "sha256": HASH}},
}  # fmt: skip
STORE = {
    "schema": "lightstage.realfacedb/1", "kind": "store", "fingerprint": HASH,
    "scans": [
        {"subject": "p-1", "expression": "neutral", "rows": 6, "columns": 4, "sha256": HASH}
    ],
}  # fmt: skip
SUMMED = {
    "schema": "lightstage.flats/1", "cameras": {"cam0": FLAT, "cam1": FLAT},
}  # fmt: skip


def a_session(path):
    """Reads session.json where a whole session lies around it."""
    session = load_session(path.parent)
    read_session_cameras(session)
    return session


def a_journal(path):
    """Reads a journal, and what it adds up to."""
    lines = read_journal(path)
    SessionState(lines)
    unfinished(path.parent)
    return config_of(path.parent)


def a_manifest(path):
    """Checks a manifest; what it says is a fault of the file, or of what lies beside it."""
    problems = check_manifest(path.parent)
    assert all(isinstance(problem, LightstageError) for problem in problems)
    if problems:
        raise problems[0]


def a_template(path):
    return load_template(path.parent)


def a_checkpoint(path):
    from learning.checkpoint import load_tensors, read_checkpoint

    load_tensors(read_checkpoint(path), "generator")


def a_store(path):
    from processing.dataset import open_store

    return open_store(path.parent)


def flats_of_processing(path):
    from lightstage.formats.flats import read_flats

    return read_flats(path, ["cam0", "cam1"])


def colour_of_processing(path):
    from processing.colour import read_colour as read

    return read(path, ["cam0", "cam1"])


def head_pose(path):
    from processing.dataset import read_head_pose

    return read_head_pose(path)


def records(path):
    from processing.records import read_records

    return read_records(path.parent)


READERS = {
    "rig.json": (rig_to_json(RIG), load_rig),
    "session.json": (SESSION, a_session),
    "journal.jsonl": (JOURNAL, a_journal),
    "manifest.json": (MANIFEST, a_manifest),
    "calibration/colour.json": (COLOUR, lambda path: read_colour(path, RIG)),
    "colour.json": (COLOUR, colour_of_processing),
    "calibration/cameras.json": (CAMERAS, lambda path: a_session(path.parents[1] / "session.json")),
    "flats/flats.json": (SUMMED, lambda path: read_calibration(path.parent, RIG)),
    "flats.json": (SUMMED, flats_of_processing),
    "lights.json": (LIGHTS, lambda path: read_measured_lights(path, RIG)),
    "calibration.json": (SHOTS, lambda path: read_shots(path.parent)),
    "environment.json": (ENVIRONMENT, read_lights),
    "landmarks.json": (MARKS | {"points_px": {"cam0": [[1.0, 2.0]] * 68}}, read_points_px),
    "marks_mm.json": (MARKS | {"points_mm": [POINT] * 68}, read_points_mm),
    "points.json": (CLICKS, read_clicks),
    "template/template.json": (None, a_template),
    "checkpoint.json": (CHECKPOINT, a_checkpoint),
    "dataset.json": (STORE, a_store),
    "head_from_world.json": ({"head_from_world": np.eye(4)[:3].tolist()}, head_pose),
    "stages.json": (
        {
            "schema": "processing.stages/1",
            "made_from": {"session": "s", "subject": "p"},
            "stages": {"decode": {"key": "k", "outputs": [], "facts": {}}},
        },
        records,
    ),
}
TOMLS = {
    "cameras.toml": (
        '[cameras.cam0]\nport = "usb:1"\nvirtual_folder = "v"\n[expect]\niso = "100"',
        read_cameras_file,
    ),
    "capture.toml": ("downloads = 3\n[checks]\nthumbnail_px = 64", read_config),
    "patterns.toml": ("[patterns.rim]\nlights = [1]", lambda path: read_patterns(path, RIG)),
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A folder with every file as it should be."""
    root = tmp_path_factory.mktemp("whole")
    shutil.copytree(default_template_path(), root / "template", ignore=lambda *_: ["maps"])
    for name, (value, _) in READERS.items():
        if name.endswith(".jsonl"):
            (root / name).write_text("".join(json.dumps(line) + "\n" for line in value))
        elif value is not None:
            write_json(root / name, value)
    for name, (text, _) in TOMLS.items():
        (root / name).write_text(text)
    return root


def listing(root):
    return sorted(str(path.relative_to(root)) for path in root.rglob("*"))


def read(reader, path):
    """What a reader says against a file; None where it takes it."""
    try:
        reader(path)
    except LightstageError as error:
        return str(error)
    return None


ALL = {name: reader for name, (_, reader) in (READERS | TOMLS).items()}
TAKEN_BY_ITSELF = ("checkpoint.json", "manifest.json")
"""What they name does not lie beside them in this test."""


@pytest.mark.parametrize("name", ALL)
def test_every_reader_takes_the_file_as_it_should_be(whole, name):
    facts = read(ALL[name], whole / name)
    assert (
        facts is None or (name in TAKEN_BY_ITSELF and "no such file" in facts) or "sha256" in facts
    )


TEXTS = {
    "nested": b"[" * 100_000,
    "nested tables": b'{"a":' * 5000 + b"1" + b"}" * 5000,
    "digits": b'{"schema": ' + b"9" * 9000 + b"}",
    "toml digits": b"a = " + b"9" * 9000,
    "infinity": b'{"schema": 1e999}',
    "mark": b"\xef\xbb\xbf{}",
    "no utf-8": b'{"schema": "\xff\xfe"}',
    "nul": b'{"schema": "\\u0000"}',
    "zeros": b"\0" * 100,
    "twice": b'{"a": 1, "a": 2}',
    "nothing": b"",
    "list": b"[]",
    "null": b"null",
    "text": b'"text"',
    "number": b"3",
}
PLACES = {
    "pipe": os.mkfifo,
    "folder": Path.mkdir,
    "circle": lambda path: path.symlink_to(path.name),
    "device": lambda path: path.symlink_to("/dev/zero"),
    "nowhere": lambda path: path.symlink_to("/nowhere/at/all"),
}


@pytest.mark.parametrize("name", ALL)
def test_a_text_that_no_reader_takes_is_one_message_that_names_the_file(whole, tmp_path, name):
    root = tmp_path / "copy"
    shutil.copytree(whole, root)
    path = root / name
    for kind, make in {**TEXTS, **PLACES}.items():
        path.unlink()
        if isinstance(make, bytes):
            path.write_bytes(make)
        else:
            make(path)
        before = listing(tmp_path)
        facts = read(ALL[name], path)
        empty = kind == "nothing" and name.endswith(".toml")  # every value may be left out
        gone = kind in ("circle", "nowhere", "folder") and name == "stages.json"
        assert facts is not None or empty or gone, kind
        if facts is not None:
            assert path.name in facts or str(path.parent) in facts, (kind, facts)
            assert len(facts) < 2000
        assert listing(tmp_path) == before, kind
        if path.is_dir() and not path.is_symlink():
            path.rmdir()
            path.write_bytes(b"")


OTHERS = [
    *(None, True, -1, 3, 2**63, 1e300, -0.5, "", "x", "../../../x", "/etc/passwd", "\ud800"),
    *([], {}, [[]], ["x"], {"x": {}}, [None], {"cam0": None}, {"full": 3}),
]


def places(value, at=()):
    """Every place in a value; of a list its first item alone."""
    yield at
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from places(inner, (*at, key))
    elif isinstance(value, list) and value:
        yield from places(value[0], (*at, 0))


def put(value, at, other):
    """A copy of a value with another one at a place."""
    if not at:
        return other
    out = copy.deepcopy(value)
    holder = out
    for key in at[:-1]:
        holder = holder[key]
    holder[at[-1]] = other
    return out


@pytest.mark.parametrize("name", [name for name in READERS if not name.endswith(".jsonl")])
def test_a_value_of_another_kind_is_taken_or_refused_by_the_files_name(
    whole, tmp_path, monkeypatch, name
):
    root = tmp_path / "copy"
    shutil.copytree(whole, root)
    path, reader = root / name, ALL[name]
    value = json.loads(path.read_text())
    if name == "template/template.json":
        value["regions"] = {"skin": [0, 1]}
        for beside in ("read_obj", "_load_modes", "read_surface_points"):
            once = functools.cache(getattr(template, beside))
            monkeypatch.setattr(template, beside, once)
    for at in places(value):
        for other in OTHERS:
            path.write_text(json.dumps(put(value, at, other)))
            facts = read(reader, path)
            assert facts is None or path.name in facts or str(root) in facts, (at, other, facts)


UNREAD = {
    "colour.json": ("full_levels",),  # a session's alone
    "lights.json": ("position_sigma_mm", "residual_px", "gain_sigma"),  # unknown where absent
}
"""Fields of numbers that a reader leaves out."""
OWN = ("journal.jsonl", "manifest.json", "calibration/cameras.json", "calibration.json")
OWN += ("checkpoint.json", "dataset.json", "stages.json")
"""Files that nobody but our programs writes."""


@pytest.mark.parametrize("name", sorted({*READERS} - {*OWN}))
def test_true_and_texts_are_no_numbers(whole, tmp_path, name):
    path = shutil.copytree(whole, tmp_path / "copy") / name
    value, taken = json.loads(path.read_text()), set()
    for at in places(value):
        holder = functools.reduce(operator.getitem, at, value)
        if type(holder) not in (int, float) or set(at) & set(UNREAD.get(name, ())):
            continue
        for other in (True, str(holder)):
            path.write_text(json.dumps(put(value, at, other)))
            if read(ALL[name], path) is None:
                taken.add((*at, other))
    assert taken == set()


def as_toml(value):
    """A value as TOML writes it, in one line."""
    if isinstance(value, dict):
        pairs = (f"{json.dumps(key)} = {as_toml(inner)}" for key, inner in value.items())
        return f"{{{', '.join(pairs)}}}"
    if isinstance(value, list):
        return f"[{', '.join(map(as_toml, value))}]"
    return json.dumps(value)


def simulators_files():
    from sim.camera.flaws import CaptureFlaws, load_flaws
    from sim.devices.faults import Story
    from sim.people.table import TABLES, load_table

    fault = {"name": "wrong-iso", "camera": "cam1", "at": 5, "until": 9, "value": "400"}
    return {
        "flaws": (
            {"based_on": "ideal", **json.loads(json.dumps(as_dict(CaptureFlaws())))},
            lambda path: load_flaws(str(path)),
        ),
        "story": ({"seed": 7, "fault": [fault]}, Story.read),
        "people": (read_toml(TABLES / "balanced.toml"), lambda path: load_table(str(path))),
    }


@pytest.mark.parametrize("name", ["flaws", "story", "people"])
def test_a_value_of_another_kind_in_a_simulators_toml_is_refused_by_the_files_name(tmp_path, name):
    value, reader = simulators_files()[name]
    path = tmp_path / f"{name}.toml"
    for at in places(value):
        for other in OTHERS:
            if not at or other == "\ud800" or "null" in as_toml(other):
                continue  # TOML has no such values
            lines = put(value, at, other).items()
            path.write_text("".join(f"{key} = {as_toml(inner)}\n" for key, inner in lines))
            facts = read(reader, path)
            assert facts is None or path.name in facts, (at, other, facts)


def test_each_field_of_a_journals_lines_is_taken_or_refused_by_its_line(whole, tmp_path):
    root = tmp_path / "copy"
    shutil.copytree(whole, root)
    path = root / "journal.jsonl"
    lines = path.read_text().splitlines()
    for index, line in enumerate(JOURNAL):
        for at in places(line):
            for other in OTHERS:
                changed = json.dumps(put(line, at, other))
                path.write_text("\n".join([*lines[:index], changed, *lines[index + 1 :]]) + "\n")
                facts = read(a_journal, path)
                assert facts is None or "journal.jsonl" in facts, (at, other, facts)


@pytest.mark.parametrize("there", ["../outside", "/etc", "a/../../b", "a\0b", "frames\\x"])
def test_no_path_of_a_journal_leads_out_of_its_session(whole, tmp_path, there):
    root = tmp_path / "copy"
    shutil.copytree(whole, root)
    for index, field in ((4, "path"), (6, "path"), (0, "calibration"), (12, "colour")):
        lines = copy.deepcopy(JOURNAL)
        lines[index][field] = {"colour": there} if field == "calibration" else there
        (root / "journal.jsonl").write_text("".join(json.dumps(x) + "\n" for x in lines))
        with pytest.raises(LightstageError, match=r"journal\.jsonl, line"):
            read_journal(root / "journal.jsonl")
