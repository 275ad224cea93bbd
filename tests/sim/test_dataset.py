"""Data sets of parametric people, and the commands that make them."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from lightstage.formats.mesh import read_obj
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.template import default_template_path, load_template
from sim.dataset import write_people
from sim.errors import SimError

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


@pytest.fixture(scope="module")
def people(tmp_path_factory):
    out = tmp_path_factory.mktemp("people")
    return out, write_people(out, 2, 2, 7, 96)


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


def test_scans_have_the_templates_topology_and_uv(people):
    template = load_template(default_template_path()).mesh
    mesh = read_obj(ProcessedFolder(people[1][0]).registered_mesh)
    np.testing.assert_array_equal(mesh.triangles(), template.triangles())
    assert mesh.uvs is not None
    np.testing.assert_allclose(
        mesh.uvs[mesh.triangle_uvs()], template.uvs[template.triangle_uvs()], atol=1e-6
    )


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others(people, tmp_path):
    _, folders = people
    write_people(tmp_path / "again", 1, 1, 7, 96)
    write_people(tmp_path / "other", 1, 1, 8, 96)
    first = fingerprint(folders[0])
    assert fingerprint(tmp_path / "again/person-0000-neutral") == first
    other = fingerprint(tmp_path / "other/person-0000-neutral")
    assert other["atlas/diffuse_albedo.exr"] != first["atlas/diffuse_albedo.exr"]


def test_more_expressions_than_there_are_is_an_error(tmp_path):
    with pytest.raises(SimError, match="at most 7"):
        write_people(tmp_path, 1, 8, 1, 96)


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "sim", *arguments], capture_output=True, text=True, check=False
    )


def test_the_dataset_command_ends_with_its_facts(tmp_path):
    done = run("dataset", "--subjects", "1", "--out", str(tmp_path), "--maps-only", "--rows", "96",
               "--json")  # fmt: skip
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout.splitlines()[-1])
    assert (facts["scans"], facts["rows"]) == (1, 96)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--sequence", "sideways"), "sideways"),
        (("--rig", "absent.json"), "absent.json"),
        (("--subject", "lps", "--expression", "smile"), "lps"),
    ],
)
def test_bad_input_is_one_message_and_exit_2(tmp_path, arguments, said):
    given = arguments if "--subject" in arguments else ("--subject", "parametric", *arguments)
    done = run("session", *given, "--out", str(tmp_path / "s"), "--direct")
    assert done.returncode == 2
    assert said in done.stderr
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []
