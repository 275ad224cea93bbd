"""Data sets of parametric people, and the commands that make them."""

from __future__ import annotations

import fcntl
import functools
import hashlib
import json
import multiprocessing
import os
import shutil
import signal
from pathlib import Path

import numpy as np
import pytest

from lightstage.formats.mesh import read_obj
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.template import default_template_path, load_template
from sim.errors import SimError
from sim.people.dataset import MADE_FROM, Plan, make_plan, write_people, write_sessions
from sim.people.table import load_table
from sim.session import truth_path
from sim.truth import vertex_occlusion

NAMES = (
    "diffuse_albedo",
    "specular_albedo",
    "diffuse_normal",
    "specular_normal",
    "position",
    "confidence",
    "ambient_occlusion",
)


def fingerprint(root: Path) -> dict[str, str]:
    files = [path for path in sorted(root.rglob("*")) if path.is_file()]
    return {
        str(path.relative_to(root)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files
    }


def plan(out: Path, subjects: int, expressions: int, seed: int) -> Plan:
    return make_plan(out, load_table("balanced"), subjects, expressions, seed, 96)


@pytest.fixture(scope="module")
def people(tmp_path_factory):
    out = tmp_path_factory.mktemp("people")
    assert write_people(plan(out, 2, 2, 7), jobs=1) == 4
    return out, sorted(path for path in out.iterdir() if path.is_dir())


def test_each_scan_is_a_processed_folder_with_all_maps(people):
    _, folders = people
    assert [f.name[:12] for f in folders] == ["person-0000-"] * 2 + ["person-0001-"] * 2
    assert folders[0].name == "person-0000-neutral"
    for root in folders:
        folder = ProcessedFolder(root)
        for name in NAMES:
            assert folder.read_atlas(name).shape[:2] == (96, 64)
        normal = folder.read_atlas("specular_normal")
        scored = folder.read_atlas("confidence") > 0
        assert scored.any()
        np.testing.assert_allclose(np.linalg.norm(normal[scored], axis=-1), 1, atol=2e-3)
        assert folder.head_pose.is_file()
        report = json.loads((root / "report.json").read_text())
        assert (report["schema"], report["synthetic"]) == ("lightstage.truth/1", True)
        assert not ((folder.read_atlas("confidence") > 0) & (folder.read_atlas("skin") == 0)).any()


def test_scans_have_the_templates_topology_and_uv(people):
    template = load_template(default_template_path()).mesh
    mesh = read_obj(ProcessedFolder(people[1][0]).registered_mesh)
    np.testing.assert_array_equal(mesh.triangles(), template.triangles())
    assert mesh.uvs is not None
    np.testing.assert_allclose(
        mesh.uvs[mesh.triangle_uvs()], template.uvs[template.triangle_uvs()], atol=1e-6
    )


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others(people, tmp_path):
    """With another number of people and expressions, too."""
    _, folders = people
    write_people(plan(tmp_path / "again", 1, 1, 7), jobs=1)
    write_people(plan(tmp_path / "other", 1, 1, 8), jobs=1)
    neutral = next(f for f in folders if f.name == "person-0000-neutral")
    first = fingerprint(neutral)
    assert fingerprint(tmp_path / "again/person-0000-neutral") == first
    other = fingerprint(tmp_path / "other/person-0000-neutral")
    assert other["atlas/diffuse_albedo.exr"] != first["atlas/diffuse_albedo.exr"]


def test_a_run_that_was_cut_short_goes_on_where_it_stopped(people, tmp_path):
    out, folders = people
    half = tmp_path / "half"
    shutil.copytree(out, half)
    shutil.rmtree(half / folders[1].name)
    (half / ".person-0001-neutral.12345678").mkdir()
    before = (half / folders[0].name / MADE_FROM).stat().st_mtime_ns
    assert write_people(plan(half, 2, 2, 7), jobs=1) == 1
    assert (half / folders[0].name / MADE_FROM).stat().st_mtime_ns == before
    everything, again = fingerprint(out), fingerprint(half)
    assert everything == again


def test_a_process_that_is_killed_is_reported_and_what_is_whole_is_kept(
    people, tmp_path, monkeypatch
):
    """What another process has made by then has the bytes that this one makes."""

    def kill_the_worker(*_):
        for child in multiprocessing.active_children():
            os.kill(child.pid, signal.SIGKILL)

    with pytest.raises(SimError, match=r"--jobs: found one of 2 processes was ended .* --rows"):
        write_people(plan(tmp_path / "out", 5, 1, 7), jobs=2, progress=kill_the_worker)
    assert (tmp_path / "out" / "person-0000-neutral" / MADE_FROM).is_file()
    # Half of a person's time goes to rays at the sky; those who are made now are not compared.
    fewer_rays = functools.partial(vertex_occlusion, directions=8)
    monkeypatch.setattr("sim.people.dataset.vertex_occlusion", fewer_rays)
    # Of five some are left even where this process is told late that the first one is made.
    assert 1 <= write_people(plan(tmp_path / "out", 5, 1, 7), jobs=1) <= 4
    kept = "person-0000-neutral"
    assert fingerprint(tmp_path / "out" / kept) == fingerprint(people[0] / kept)


def test_a_folder_made_from_another_seed_is_refused(people):
    out, folders = people
    before, listed = fingerprint(folders[0]), (out / "people.json").read_bytes()
    with pytest.raises(SimError, match="seed"):
        write_people(plan(out, 2, 2, 8), jobs=1)
    assert fingerprint(folders[0]) == before
    assert (out / "people.json").read_bytes() == listed


def test_two_runs_do_not_share_a_folder(people):
    out, _ = people
    with (out / "people.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with pytest.raises(SimError, match="one run at a time"):
            write_people(plan(out, 2, 2, 7), jobs=1)


def test_the_list_of_people_counts_every_group(people):
    facts = json.loads((people[0] / "people.json").read_text())
    assert len(facts["people"]) == 2
    assert sum(facts["counts"]["sex"].values()) == 2
    assert set(facts["people"][0]) == {"name", "seed", "sex", "age_years", "tone", "look"}


def test_a_session_without_its_record_is_somebody_elses(tmp_path):
    theirs = tmp_path / "person-0000-neutral"
    theirs.mkdir()
    (theirs / "session.json").write_text("{}")
    with pytest.raises(SimError, match="another session"):
        write_sessions(plan(tmp_path, 1, 1, 7))
    assert (theirs / "session.json").read_text() == "{}"
    assert not truth_path(theirs).exists()


def test_more_expressions_than_there_are_is_an_error(tmp_path):
    with pytest.raises(SimError, match="at most 7"):
        plan(tmp_path, 1, 8, 1)


def test_the_dataset_command_ends_with_its_facts(tmp_path, run_command):
    size = ("--subjects", "1", "--expressions", "1", "--rows", "96")
    ended = run_command("sim", "dataset", *size, "--out", tmp_path, "--maps-only", "--json")
    assert ended.code == 0, ended.err
    facts = json.loads(ended.out.splitlines()[-1])
    assert (facts["scans"], facts["made"], facts["rows"]) == (1, 1, 96)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--sequence", "sideways"), "sideways"),
        (("--rig", "absent.json"), "absent.json"),
        (("--subject", "lps", "--expression", "smile"), "lps"),
    ],
)
def test_bad_input_is_one_message_and_exit_2(tmp_path, arguments, message, run_command):
    given = arguments if "--subject" in arguments else ("--subject", "parametric", *arguments)
    ended = run_command("sim", "session", *given, "--out", tmp_path / "s", "--direct")
    assert ended.code == 2
    assert message in ended.err
    assert "Traceback" not in ended.err
    assert list(tmp_path.iterdir()) == []
