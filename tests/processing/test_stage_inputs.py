"""A stage runs again for its own code, configuration and files alone; `run --why` says which."""

from __future__ import annotations

import dataclasses
import functools
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from lightstage.formats.session import Session, SessionFile, load_session, save_session
from lightstage.formats.template import default_template_path
from processing.pipeline import is_reported, read_job, run, run_next, why
from processing.pipeline_config import PipelineConfig
from processing.reachable import ROOT, reachable_files
from processing.reconstruction.config import ReconstructConfig
from processing.records import CODE
from processing.stage_inputs import STAGE_MODULES, stage_inputs
from tests.processing import lit_ball
from tests.processing.lit_ball import Ball


@pytest.fixture
def session(tmp_path: Path) -> Path:
    return lit_ball.write_session(
        Ball(coated=True), lit_ball.small_rig(2, 0.015), tmp_path / "session"
    )


def reached(module: str) -> set[str]:
    return {str(path.relative_to(ROOT)) for path in reachable_files(module, CODE)}


def test_a_stage_reaches_its_own_code_and_not_that_of_later_stages() -> None:
    folders = {
        stage: {Path(name).parts[1] for name in reached(module) if name.startswith("processing/")}
        for stage, module in STAGE_MODULES.items()
    }
    for stage, module in STAGE_MODULES.items():
        assert module.split(".")[1] in folders[stage]
    later = {"separation", "reconstruction", "refinement", "registration", "atlas", "pages.py"}
    assert not folders["decode"] & later
    assert not folders["separate"] & (later - {"separation"})
    assert not folders["atlas"] & {"refinement", "dataset", "batch"}


SHAPES_NO_RESULT = (
    *("lightstage/__init__.py", "lightstage/commands/", "lightstage/errors.py"),
    *("lightstage/failures.py", "lightstage/interrupts.py", "lightstage/raw_errors.py"),
    *("lightstage/counting.py", "lightstage/printable.py", "lightstage/compiled.py"),
)
"""What stages import to begin, to end and to report: words, progress, signals."""


@pytest.mark.parametrize("stage", STAGE_MODULES)
def test_all_code_that_a_stages_results_depend_on_is_in_its_key(stage: str) -> None:
    module = STAGE_MODULES[stage]
    all_of_it = reachable_files(module, ("processing", "lightstage"))
    beside = {str(path.relative_to(ROOT)) for path in all_of_it} - reached(module)
    assert {name for name in beside if not name.startswith(SHAPES_NO_RESULT)} == set()


def test_the_detector_the_cleaning_and_the_patterns_levels_are_in_the_keys() -> None:
    assert "lightstage/faces/detect.py" in reached(STAGE_MODULES["register"])
    assert "lightstage/meshlab.py" in reached(STAGE_MODULES["reconstruct"])
    assert "lightstage/patterns/weights.py" in reached(STAGE_MODULES["decode"])


def test_other_depth_maps_of_colmap_make_reconstruct_run_again(
    session: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "workspace" / "stereo" / "depth_maps"
    folder.mkdir(parents=True)
    config = dataclasses.replace(
        PipelineConfig(), reconstruct=ReconstructConfig(colmap_from=str(tmp_path / "workspace"))
    )

    def keys() -> dict[str, str]:
        found = stage_inputs(load_session(session), config, "", {})
        return {stage: found[stage].parts["files"] for stage in ("separate", "reconstruct")}

    seen = [keys()]
    for name, content in (("cam0", b"a"), ("cam0", b"b"), ("cam1", b"b")):
        for path in folder.iterdir():
            path.unlink()
        (folder / f"{name}.pgm.geometric.bin").write_bytes(content)
        seen.append(keys())
    assert len({each["reconstruct"] for each in seen}) == 4
    assert len({each["separate"] for each in seen}) == 1


LOADED = """
import importlib, json, os, sys
import cv2, numba, pycolmap, scipy.optimize, scipy.sparse  # not ours: once for all stages
for module in sys.argv[1:]:
    if not os.fork():
        importlib.import_module(module)
        files = [m.__file__ for m in sys.modules.values() if getattr(m, "__file__", None)]
        print(json.dumps([module, files]), flush=True)
        os._exit(0)
    os.wait()
"""


@pytest.fixture(scope="module")
def loaded() -> dict[str, set[Path]]:
    """Files of what is loaded in a process of its own for each stage's module."""
    printed = subprocess.run(
        [sys.executable, "-c", LOADED, *STAGE_MODULES.values()],
        capture_output=True, text=True, check=True, cwd=ROOT,
    )  # fmt: skip
    listed = dict(json.loads(line) for line in printed.stdout.splitlines())
    return {module: {Path(name) for name in files} for module, files in listed.items()}


@pytest.mark.parametrize("stage", STAGE_MODULES)
def test_what_a_stage_imports_when_it_is_loaded_is_among_what_it_reaches(
    stage: str, loaded: dict[str, set[Path]]
) -> None:
    """The plain twin: Python's own record of what was imported."""
    own = {path for name in CODE for path in [ROOT / name, *(ROOT / name).rglob("*.py")]}
    found = loaded[STAGE_MODULES[stage]] & own
    assert ROOT / (STAGE_MODULES[stage].replace(".", "/") + ".py") in found
    assert found <= set(reachable_files(STAGE_MODULES[stage], CODE))


def test_imports_of_every_form_are_followed_and_what_is_outside_is_not_listed(
    tmp_path: Path,
) -> None:
    files = {
        "a/__init__.py": "",
        "a/one.py": "import a.two\nfrom a import three\nfrom outside import x\nimport os\n",
        "a/two.py": "def f():\n    from a.deep.four import g\n    return g\n",
        "a/three.py": "from .five import h\nfrom . import six\n",
        "a/five.py": "import a.one\n",
        "a/six.py": "",
        "a/unused.py": "",
        "a/deep/__init__.py": "from a.seven import k\n",
        "a/deep/four.py": "from ..eight import m\n",
        "a/seven.py": "",
        "a/eight.py": "",
        "outside.py": "import a.nine\n",
        "a/nine.py": "",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    found = {str(p.relative_to(tmp_path)) for p in reachable_files("a.one", ("a",), tmp_path)}
    assert found == set(files) - {"a/unused.py", "outside.py"}
    with pytest.raises(ModuleNotFoundError, match=r"a\.none"):
        reachable_files("a.none", ("a",), tmp_path)


def test_another_stages_code_leaves_a_stage_as_it_is(
    session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, template = tmp_path / "out", default_template_path()
    run(session, out, template, PipelineConfig(), until="separate")

    def reasons() -> dict[str, str | None]:
        job = read_job(session, out, template, PipelineConfig(), "separate")
        return why(job, "separate")

    assert reasons() == {"decode": None, "separate": None}
    code = {stage: f"code of {stage}" for stage in STAGE_MODULES}
    monkeypatch.setattr("processing.stage_inputs.stage_code", code.__getitem__)
    run(session, out, template, PipelineConfig(), until="separate")
    code["reconstruct"] = code["atlas"] = "changed"
    assert reasons() == {"decode": None, "separate": None}
    code["separate"] = "changed"
    assert reasons() == {"decode": None, "separate": "its code has changed"}
    code["decode"] = "changed"
    assert reasons() == {"decode": "its code has changed", "separate": "its code has changed"}


def test_why_names_each_stages_reason_and_runs_nothing(
    session: Path, tmp_path: Path, run_command: Callable[..., Any]
) -> None:
    out = tmp_path / "out"
    ask = functools.partial(
        run_command, "processing", "run", session, "--out", out, "--until", "reconstruct", "--why"
    )
    before = ask()
    assert before.code == 0, before.err
    assert before.out.splitlines()[0] == "decode: it has not run, or did not end"
    assert not out.exists()
    run(session, out, default_template_path(), PipelineConfig(), until="separate")
    times = {path: path.stat().st_mtime_ns for path in out.rglob("*")}
    toml = tmp_path / "c.toml"
    toml.write_text("[separate]\nroughness = 0.3\n")
    facts = json.loads(ask("--config", toml, "--json").out)["stages"]
    assert facts == {
        "decode": None,
        "separate": "its configuration has changed",
        "reconstruct": "it has not run, or did not end",
    }
    text = (session / "rig.json").read_text()
    (session / "rig.json").write_text(text + "\n")
    lines = ask().out.splitlines()
    assert lines[0].startswith("decode: a file that it reads has changed: the session's")
    assert lines[1] == "separate: decode runs before it"
    (session / "rig.json").write_text(text)
    (out / "views" / "cam0" / "diffuse_normal.exr").unlink()
    assert ask().out.splitlines()[:2] == [
        "decode: up to date",
        "separate: views/cam0/diffuse_normal.exr, which it wrote, is missing",
    ]
    assert {
        path: path.stat().st_mtime_ns for path in times if path.exists() and path.is_file()
    } == {path: when for path, when in times.items() if path.exists() and path.is_file()}


def test_records_of_an_older_version_report_it(session: Path, tmp_path: Path) -> None:
    out, template = tmp_path / "out", default_template_path()
    run(session, out, template, PipelineConfig(), until="decode")
    path = out / "stages.json"
    value = json.loads(path.read_text())
    record = value["stages"]["decode"]
    del record["parts"]
    record["key"] = "0" * 64
    path.write_text(json.dumps(value))
    job = read_job(session, out, template, PipelineConfig(), "decode")
    assert "an older version ran it" in str(why(job, "decode")["decode"])


def with_field(session: Path, place: str, value: Any) -> Session:
    """The session with one field of session.json set, such as `frames.0.path`."""
    loaded = load_session(session)
    content = loaded.file.model_dump(by_alias=True)
    *way, last = place.split(".")
    at: Any = content
    for name in way:
        at = at[int(name)] if isinstance(at, list) else at[name]
    at[int(last) if isinstance(at, list) else last] = value
    file = SessionFile.model_validate(content)
    save_session(session, file)
    return Session(session, file, loaded.rig)


@pytest.mark.parametrize(
    ("place", "value", "counts"),
    [
        ("consent", "C-0002", False),
        ("expression", "smile", False),
        ("created_utc", "2031-01-01T00:00:00+00:00", False),
        ("accepted", {"x+": []}, False),
        ("frames.0.take", 2, False),
        ("frames.0.acknowledged", False, False),
        ("sequence.0", "x-", True),
        ("frames.0.path", "frames/other.exr", True),
        ("frames.0.sha256", "0" * 64, True),
        ("frames.0.pattern", "x-", True),
        ("frames.0.camera", "cam1", True),
        ("frames.0.encoding", "raw", True),
        ("patterns.full", {"levels": [0.5]}, True),
        ("calibration.colour", "rig.json", True),
        ("calibration.lights", "rig.json", True),
        ("calibration.flats", "rig.json", True),
    ],
)
def test_of_session_json_the_fields_count_that_a_stage_reads(
    session: Path, place: str, value: Any, counts: bool
) -> None:
    before = stage_inputs(load_session(session), PipelineConfig(), "", {})
    after = stage_inputs(with_field(session, place, value), PipelineConfig(), "", {})
    assert (before["decode"].parts != after["decode"].parts) == counts
    assert (before["atlas"].key != after["atlas"].key) == counts


def test_another_consent_is_reported_and_runs_no_stage(session: Path, tmp_path: Path) -> None:
    out, template, path = tmp_path / "out", default_template_path(), session / "session.json"
    run(session, out, template, PipelineConfig(), until="decode")
    path.write_text(json.dumps({**json.loads(path.read_text()), "consent": "C-0002"}, indent=3))
    job = read_job(session, out, template, PipelineConfig(), "decode")
    assert why(job, "decode") == {"decode": None}
    assert not is_reported(job, "decode")
    assert run_next(job, "decode") == (None, [])
    assert json.loads((out / "report.json").read_text())["consent"] == "C-0002"
    assert is_reported(job, "decode")
    path.write_text(json.dumps({**json.loads(path.read_text()), "expression": "smile"}))
    (out / "report.html").write_text("old")
    assert run(session, out, template, PipelineConfig(), until="decode")["ran"] == []
    assert "smile" in (out / "report.html").read_text()
