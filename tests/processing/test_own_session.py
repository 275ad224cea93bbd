"""A processed folder is of one session: no other's stages run in it, no other's consent counts."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from lightstage.errors import LightstageError
from lightstage.formats.files import read_json, write_json
from lightstage.formats.template import default_template_path
from processing.dataset import build_store, open_store
from processing.pipeline import STAGES, run
from processing.pipeline_config import PipelineConfig
from processing.records import MadeFrom, Record, read_made_from, read_records, write_records
from tests.processing import lit_ball
from tests.processing.lit_ball import Ball

Make = Callable[..., Path]
OWNER = MadeFrom("s-1", "anna")
TEMPLATE = default_template_path()


@pytest.fixture
def session(tmp_path: Path) -> Path:
    """Of session "ball" of subject "ball"."""
    return lit_ball.write_session(Ball(), lit_ball.small_rig(1, 0.015), tmp_path / "session")


@pytest.fixture
def processed(tmp_path: Path, make_processed: Make) -> Path:
    """What all stages leave of a session of `OWNER`."""
    out = make_processed(tmp_path / "out", subject="anna", consent="C-17")
    report = read_json(out / "report.json")
    write_json(out / "report.json", {"schema": "processing.report/1", "session": "s-1"} | report)
    write_records(out, OWNER, {stage: Record("k", [], {}) for stage in STAGES})
    return out


def everything(out: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}


def renamed(session: Path, **values: str) -> None:
    file = session / "session.json"
    file.write_text(json.dumps(read_json(file) | values))


@pytest.mark.parametrize("asked", [{"until": "decode"}, *({"only": stage} for stage in STAGES)])
def test_no_stage_runs_in_a_folder_of_another_session(
    session: Path, processed: Path, asked: dict[str, str]
) -> None:
    # Stages that need landmarks ask for them first.
    write_json(
        session / "landmarks.json",
        {"schema": "lightstage.landmarks/1", "scheme": "ibug68", "points_px": {}},
    )
    before = everything(processed)
    text = r"made from session s-1 of subject anna, .* session ball of subject ball\. Choose anot"
    with pytest.raises(LightstageError, match=text):
        run(session, processed, TEMPLATE, PipelineConfig(), **asked)  # type: ignore[arg-type]
    assert everything(processed) == before


@pytest.mark.parametrize("values", [{"id": "s-1"}, {"subject": "anna"}])
def test_id_and_subject_must_both_be_the_same(
    session: Path, processed: Path, values: dict[str, str]
) -> None:
    renamed(session, **values)
    with pytest.raises(LightstageError, match="made from session s-1 of subject anna"):
        run(session, processed, TEMPLATE, PipelineConfig(), until="decode")


def test_the_report_tells_where_the_record_was_removed(session: Path, processed: Path) -> None:
    (processed / "stages.json").unlink()
    (processed / "work").mkdir()
    with pytest.raises(LightstageError, match="made from session s-1 of subject anna"):
        run(session, processed, TEMPLATE, PipelineConfig(), until="decode")


def test_a_folder_states_whose_it_is_before_its_first_stage_ends(
    session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def cut_short(*_: object) -> dict[str, object]:
        raise KeyboardInterrupt

    monkeypatch.setattr("processing.pipeline.decode", cut_short)
    with pytest.raises(KeyboardInterrupt):
        run(session, tmp_path / "new", TEMPLATE, PipelineConfig(), until="decode")
    assert read_made_from(tmp_path / "new") == MadeFrom("ball", "ball")


def test_stages_of_an_unknown_session_count_for_nothing(processed: Path) -> None:
    value = read_json(processed / "stages.json")
    del value["made_from"]
    write_json(processed / "stages.json", value)
    assert read_records(processed) == {}


def test_a_store_takes_a_folder_whose_atlas_is_current(processed: Path, tmp_path: Path) -> None:
    (scan,) = open_store(build_store([processed], tmp_path / "store")).scans
    assert (scan.subject, scan.consent) == ("anna", "C-17")


def older_atlas(out: Path) -> None:
    kept = {stage: record for stage, record in read_records(out).items() if stage != "atlas"}
    write_records(out, OWNER, kept)


def another_subject(out: Path) -> None:
    write_json(out / "report.json", read_json(out / "report.json") | {"subject": "berta"})


def another_session(out: Path) -> None:
    write_json(out / "report.json", read_json(out / "report.json") | {"session": "s-2"})


def no_record(out: Path) -> None:
    (out / "stages.json").unlink()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (older_atlas, "an atlas that is older than the stages before it"),
        (another_subject, "found session s-1 of subject berta, expected session s-1 of .* anna"),
        (another_session, "found session s-2 of subject anna, expected session s-1"),
        (no_record, "no record of the session"),
    ],
)
def test_a_store_refuses_an_atlas_that_may_be_of_somebody_else(
    processed: Path, tmp_path: Path, change: Callable[[Path], None], message: str
) -> None:
    change(processed)
    with pytest.raises(LightstageError, match=message):
        build_store([processed], tmp_path / "store")


def test_a_second_run_on_a_folder_is_refused_until_the_first_process_ends(
    session: Path, processed: Path
) -> None:
    holder = (
        "import sys\nfrom pathlib import Path\n"
        "from lightstage.errors import LightstageError\n"
        "from lightstage.formats.lock import locked\n"
        "with locked(Path(sys.argv[1]), LightstageError('busy')):\n"
        "    print('held', flush=True)\n    sys.stdin.read()\n"
    )
    renamed(session, id="s-1", subject="anna")
    words = [sys.executable, "-c", holder, str(processed / "run.lock")]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as first:
        assert first.stdout is not None
        assert first.stdout.readline() == b"held\n"
        before = everything(processed)
        with pytest.raises(LightstageError, match=f"{processed}.* another run is writing to"):
            run(session, processed, TEMPLATE, PipelineConfig(), until="decode")
        assert everything(processed) == before
        first.kill()
    assert run(session, processed, TEMPLATE, PipelineConfig(), until="decode")["ran"] == ["decode"]


def test_the_lock_of_an_ended_run_is_no_foreign_file(session: Path, tmp_path: Path) -> None:
    out = tmp_path / "new"
    out.mkdir()
    (out / "run.lock").touch()
    (out / ".stages.0123abcd.json").touch()  # of a run that was killed while it wrote
    assert run(session, out, TEMPLATE, PipelineConfig(), until="decode")["ran"] == ["decode"]
    assert "run.lock" not in read_records(out)["decode"].outputs


def test_a_refused_stage_makes_no_folder(session: Path, tmp_path: Path) -> None:
    with pytest.raises(LightstageError, match="the stages before it"):
        run(session, tmp_path / "new", TEMPLATE, PipelineConfig(), only="refine")
    assert not (tmp_path / "new").exists()
