"""The commands: a folder that session takes, one line of facts, exit 2 and nothing half-written."""

from __future__ import annotations

import json

import numpy as np
import pytest

from sim.__main__ import app, main
from sim.scans.folder import load_subject_folder


def run(monkeypatch, capsys, *arguments):
    """Exit code, stdout and stderr of `lightstage-sim`."""
    monkeypatch.setattr("sys.argv", ["lightstage-sim", *map(str, arguments)])
    code = 0
    try:
        main()
    except SystemExit as stop:
        code = int(stop.code or 0)
    printed = capsys.readouterr()
    return code, printed.out, printed.err


def test_both_commands_are_there():
    names = [command.name for command in app.registered_commands]
    assert {"import-ict", "import-scan"} <= set(names)


def test_a_scan_becomes_a_folder_that_a_session_takes(egg, files, tmp_path, monkeypatch, capsys):
    file = files["write_glb"](tmp_path / "egg.glb", egg, files["picture_bytes"](96, 64))
    out = tmp_path / "egg"
    code, printed, _ = run(
        monkeypatch, capsys, "import-scan", file, "--out", out, "--source", "a hen", "--json"
    )
    assert code == 0
    facts = json.loads(printed.splitlines()[-1])
    assert facts["mm_per_unit"] == 1000
    assert facts["holes_mm"] == []
    assert facts["made_up"] == ["specular albedo", "translucency", "roughness", "relief"]
    subject = load_subject_folder(out)
    assert (subject.name, subject.source) == ("egg", "a hen")
    session = tmp_path / "session"
    code, _, error = run(
        monkeypatch, capsys, "session", "--subject", out, "--out", session, "--direct",
        "--scale", "0.012", "--sequence", "full,x+",
    )  # fmt: skip
    assert code == 0, error
    written = json.loads((session / "session.json").read_text())
    assert (written["subject"], written["expression"]) == ("egg", "neutral")
    marks = json.loads((session / "landmarks.json").read_text())["points_px"]
    assert all(point is None for points in marks.values() for point in points)
    code, _, error = run(
        monkeypatch, capsys, "session", "--subject", out, "--out", tmp_path / "s2",
        "--expression", "smile", "--direct",
    )  # fmt: skip
    assert code == 2
    assert "found smile, expected neutral" in error


def test_the_line_of_facts_names_holes_unit_and_what_was_made_up(
    egg, files, tmp_path, monkeypatch, capsys
):
    file = files["write_textured_obj"](tmp_path / "egg.obj", egg, files["picture_bytes"](96, 64))
    code, printed, _ = run(
        monkeypatch, capsys, "import-scan", file, "--out", tmp_path / "e", "--rows", 48
    )
    assert code == 0
    for part in ("triangles", "0 without area dropped", "0 holes", "one unit = 1 mm", "made up"):
        assert part in printed
    assert load_subject_folder(tmp_path / "e").roughness.shape == (48, 32)


@pytest.mark.parametrize(
    ("change", "options", "message"),
    [
        (lambda m: m.with_vertices(m.vertices / 10), (), "--units cm"),
        (lambda m: m.with_vertices(m.vertices * [1, 1, np.nan]), (), "NaN"),
        (lambda m: m, ("--units", "furlong"), "--units: found 'furlong'"),
        (lambda m: m, ("--flip-normals",), "Leave --flip-normals away"),
        (lambda m: m, ("--name", "a/b"), "pseudonym"),
        (lambda m: m, ("--landmarks", "absent.json"), "absent.json: found no such file"),
        (lambda m: m, ("--colour", "absent.png"), "absent.png: found no such file"),
    ],
)
def test_bad_input_exits_2_with_one_message_and_writes_nothing(
    egg, files, tmp_path, monkeypatch, capsys, change, options, message
):
    made = tmp_path / "made"
    made.mkdir()
    file = files["write_textured_obj"](
        tmp_path / "egg.obj", change(egg), files["picture_bytes"](16, 16)
    )
    code, _, error = run(
        monkeypatch, capsys, "import-scan", file, "--out", made / "subject", *options
    )
    assert code == 2
    assert message in error
    assert "Traceback" not in error
    assert len(error.strip().splitlines()) == 1
    assert list(made.iterdir()) == []


def test_something_else_in_the_way_is_reported_before_the_work(tmp_path, monkeypatch, capsys):
    (tmp_path / "me.jpg").write_bytes(b"x")
    for command in (("import-scan", "absent.glb"), ("import-ict", "absent")):
        code, _, error = run(monkeypatch, capsys, *command, "--out", tmp_path)
        assert code == 2
        assert "found something else" in error
    code, _, error = run(monkeypatch, capsys, "import-ict", tmp_path, "--out", tmp_path / "new")
    assert code == 2
    assert "no FaceXModel" in error
    assert not (tmp_path / "new").exists()


def test_ict_becomes_a_folder(head_data, tmp_path, monkeypatch, capsys):
    out = tmp_path / "person"
    code, printed, error = run(
        monkeypatch, capsys, "import-ict", head_data / "ict_facekit", "--out", out,
        "--seed", 4, "--expression", "smile", "--rows", 96,
    )  # fmt: skip
    assert code == 0, error
    assert "ict-4, smile, 22991 vertices, 96 rows" in printed
    subject = load_subject_folder(out)
    assert (subject.name, subject.expression) == ("ict-4", "smile")
    assert "USC Institute for Creative Technologies" in subject.source
    code, _, error = run(
        monkeypatch, capsys, "import-ict", head_data / "ict_facekit", "--out", out,
        "--expression", "wink", "--rows", 96,
    )  # fmt: skip
    assert code == 2
    assert "found 'wink', expected neutral, smile" in error
    assert load_subject_folder(out).name == "ict-4"
