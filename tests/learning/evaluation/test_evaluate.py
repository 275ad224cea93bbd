"""`evaluate`: figures against a plain twin, intervals, tones, one person's agreement, refusals."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import colour
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from learning.bootstrap import interval
from learning.evaluation import command
from learning.evaluation.command import Pair, agreement, others
from learning.evaluation.measures import (
    albedo_measures,
    normal_measures,
    ssim,
)
from learning.evaluation.people import by_tone, spread
from lightstage.formats.exr import read_exr, write_exr
from lightstage.formats.files import write_json
from lightstage.formats.mesh import read_obj, write_obj
from lightstage.formats.processed import ProcessedFolder
from processing.tones import ita_deg, tone_of
from tests.learning.evaluation.called import Ended, brightened

WHITE = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]


def test_a_person_against_themselves_has_no_error_and_a_factor_is_distinguished(
    people: list[ProcessedFolder], tmp_path: Path, evaluate: Callable[..., Ended]
) -> None:
    person = people[0]
    tinted = brightened(person, tmp_path / "tinted", np.array([0.8, 0.9, 0.7]))
    same = evaluate(person.root, "--truth", person.root).facts["figures"]
    assert same["albedo_psnr_db"]["mean"] > 100
    assert same["diffuse_normal_mean_deg"]["mean"] < 0.1
    assert same["relit_rim_db"]["mean"] > 60
    out = tmp_path / "figures.json"
    facts = evaluate(tinted, "--truth", person.root, "--out", out, "--data", "simulated").facts
    found = facts["figures"]
    raw, scaled, relative = (
        found[f"albedo{part}_psnr_db"]["mean"] for part in ("", "_scaled", "_relative")
    )
    assert raw < scaled < relative
    assert relative > 60
    written = json.loads(out.read_text())
    assert written["data"] == "simulated"
    assert written["figures"]["albedo_psnr_db"]["low"] is None  # one person has no interval
    assert "simulated truth, 1 person" in out.with_suffix(".md").read_text()


def test_a_table_that_no_evaluation_wrote_is_not_replaced_and_refused_before_any_work(
    people: list[ProcessedFolder],
    tmp_path: Path,
    evaluate: Callable[..., Ended],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    person, out = people[0].root, tmp_path / "notes.json"
    out.with_suffix(".md").write_text("mine")
    monkeypatch.setattr(command, "_measured", None)  # nothing is measured
    done = evaluate(person, "--truth", person, "--out", out)
    assert (done.code, "notes.md, --out: found a file that no evaluation" in done.err) == (2, True)
    out.write_text("{}")
    assert evaluate(person, "--truth", person, "--out", out).code == 2
    assert (out.with_suffix(".md").read_text(), out.read_text()) == ("mine", "{}")
    (tmp_path / "folder.md").mkdir()
    done = evaluate(person, "--truth", person, "--out", tmp_path / "folder.json")
    assert (done.code, "folder.md" in done.err) == (2, True)
    assert not (tmp_path / "folder.json").exists()


def turned(person: ProcessedFolder, root: Path) -> ProcessedFolder:
    """The same head in other axes: the chin to the left, turned about two axes, and elsewhere."""
    shutil.copytree(person.root, root)
    folder = ProcessedFolder(root)
    a, b = 0.9, 0.4
    about_z = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    about_x = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    turn, shift = about_z @ about_x, np.array([30.0, -400.0, 7.0])
    mesh = read_obj(folder.registered_mesh)
    write_obj(mesh.with_vertices(mesh.vertices @ turn.T + shift), folder.registered_mesh)
    for name in ("diffuse_normal", "specular_normal"):
        folder.write_atlas(name, folder.read_atlas(name) @ turn.T)
    pose = np.column_stack([turn.T, -turn.T @ shift])
    write_json(folder.head_pose, {"head_from_world": pose.tolist()})
    return folder


def test_a_head_in_any_axes_is_held_against_the_truth_in_the_heads_own_and_lit_there(
    people: list[ProcessedFolder], tmp_path: Path, evaluate: Callable[..., Ended]
) -> None:
    person = people[0]
    rolled = turned(person, tmp_path / "rolled")
    mine = brightened(person, tmp_path / "mine", np.linspace(0.5, 1, 96)[:, None, None])
    straight = evaluate(mine, "--truth", person.root).facts["figures"]
    # Maps of a fit are in the head frame; maps without a folder's pose in the axes of its mesh.
    fit = tmp_path / "avatar" / "fit"
    shutil.copytree(mine, fit / "atlas")
    (fit / "fit.json").write_text("{}")
    same_axes = brightened(rolled, tmp_path / "same axes", np.linspace(0.5, 1, 96)[:, None, None])
    for folder in (tmp_path / "avatar", fit, same_axes):
        other = evaluate(folder, "--truth", rolled.root).facts["figures"]
        for light in ("key", "split", "rim"):
            name = f"relit_{light}_db"
            assert other[name]["mean"] == pytest.approx(straight[name]["mean"], abs=0.05)
        assert other["specular_normal_mean_deg"]["mean"] < 0.1
    lit = [straight[f"relit_{light}_db"]["mean"] for light in ("key", "split", "rim")]
    assert max(lit) - min(lit) > 1  # another light would be noticed


def test_photographs_of_one_person_are_held_against_each_other(
    people: list[ProcessedFolder], tmp_path: Path, evaluate: Callable[..., Ended]
) -> None:
    person = people[0]
    one = brightened(person, tmp_path / "one", 0.9)
    two = brightened(person, tmp_path / "two", 0.95)
    facts = evaluate(one, two, "--truth", person.root).facts
    assert facts["people"] == 1
    assert 20 < facts["figures"]["agreement_db"]["mean"] < 45


def test_photographs_of_the_same_person_count_as_one_person_however_their_truth_is_named(
    people: list[ProcessedFolder], tmp_path: Path, evaluate: Callable[..., Ended]
) -> None:
    a, b = people[:2]
    one, two, three = (brightened(a, tmp_path / f"{f}", f) for f in (0.9, 0.7, 0.5))
    other = brightened(b, tmp_path / "other", 0.95)
    (tmp_path / "linked").symlink_to(a.root)
    truths = [a.root, a.root / "atlas", tmp_path / "linked", b.root]
    out = tmp_path / "figures.json"
    words = [word for truth in truths for word in ("--truth", truth)]
    facts = evaluate(one, two, three, other, *words, "--out", out).facts
    assert (facts["people"], facts["photographs"]) == (2, 4)
    each = [row["albedo_psnr_db"] for row in facts["each"]]
    found = facts["figures"]["albedo_psnr_db"]
    assert found["mean"] == pytest.approx((np.mean(each[:3]) + each[3]) / 2)
    # Two people are drawn: the bounds are the people themselves.
    assert found["low"] == pytest.approx(np.mean(each[:3]))
    assert found["high"] == pytest.approx(each[3])
    off = [row["ita_error_deg"] for row in facts["each"]]
    tones = list(facts["ita_error_deg"].values())
    by_person = [np.mean(off[:3]), off[3]]
    expected = [np.mean(by_person)] if len(tones) == 1 else by_person
    assert sorted(tones) == pytest.approx(sorted(expected))
    assert "2 people, 4 photographs; intervals of 95 % by bootstrap over people" in (
        out.with_suffix(".md").read_text()
    )
    words = [word for truth in truths[:2] for word in ("--truth", truth)]
    facts = evaluate(one, two, *words, "--out", out).facts
    assert (facts["people"], facts["photographs"]) == (1, 2)
    assert "agreement_db" in facts["figures"]
    assert "over photographs of one person" in out.with_suffix(".md").read_text()


def test_likeness_to_others_leaves_a_persons_own_photographs_out() -> None:
    faces = np.eye(2)
    pairs = [
        Pair(name, Path(whose), {}, (0.0, 0.0), np.stack([face, face]))
        for name, whose, face in (("1", "a", faces[0]), ("2", "a", faces[0]), ("3", "b", faces[1]))
    ]
    assert others(pairs, "cosine") == [0, 0, 0]
    assert others(pairs, "distance") == pytest.approx([np.sqrt(2)] * 3)


def test_albedos_of_different_sizes_are_held_against_each_other_at_the_smaller_one() -> None:
    rng = np.random.default_rng(4)
    small = rng.uniform(0.2, 0.8, (24, 16, 3)).astype(np.float32)
    large = np.kron(small, np.ones((2, 2, 1), np.float32))
    large[:7] = 0  # of no skin: the smaller one's row 3 has some of it
    (same,) = agreement([small, large])
    assert same > 100
    (off,) = agreement([0.5 * large, small])
    (wanted,) = agreement([0.5 * small[4:], small[4:]])
    assert off == pytest.approx(wanted, abs=1e-3)


@pytest.mark.parametrize("name", ["skin", "confidence"])
def test_a_texel_counts_where_more_than_half_of_it_is_skin_of_the_truth(
    people: list[ProcessedFolder],
    tmp_path: Path,
    evaluate: Callable[..., Ended],
    monkeypatch: pytest.MonkeyPatch,
    name: str,
) -> None:
    truth = ProcessedFolder(shutil.copytree(people[0].root, tmp_path / "truth"))
    share = np.array([1, 2, 3, 4])[np.arange(48) % 4][:, None] + np.zeros((48, 32), int)
    # Of two by two texels so many are skin.
    skin = np.kron(share, np.ones((2, 2))) > np.tile([[0, 1], [2, 3]], (48, 32))
    truth.write_atlas(name, skin.astype(np.float32))
    monkeypatch.setattr(command, "RELIT_ROWS", 48)
    small = tmp_path / "small"
    small.mkdir()
    for path in (truth.root / "atlas").glob("*.exr"):
        write_exr(small / path.name, command._resized(read_exr(path), (48, 32)))
    for most, is_scored in ((2, False), (3, True)):
        mine = shutil.copytree(small, tmp_path / f"wrong up to {most}")
        albedo = read_exr(small / "diffuse_albedo.exr")
        write_exr(mine / "diffuse_albedo.exr", np.where(share[..., None] <= most, 0, albedo))
        figures = evaluate(mine, "--truth", truth.root).facts["figures"]
        assert (figures["albedo_psnr_db"]["mean"] < 40) is is_scored
        large = brightened(truth, tmp_path / f"large {most}", 1.0)
        wrong = np.kron(share <= most, np.ones((2, 2)))[..., None] > 0
        write_exr(
            large / "diffuse_albedo.exr", np.where(wrong, 0, truth.read_atlas("diffuse_albedo"))
        )
        figures = evaluate(large, "--truth", truth.root).facts["figures"]
        assert (figures["relit_key_db"]["mean"] < 40) is is_scored


def test_a_truth_that_is_zero_where_nothing_was_captured_darkens_no_texel_beside_it(
    people: list[ProcessedFolder], tmp_path: Path, evaluate: Callable[..., Ended]
) -> None:
    mine = tmp_path / "mine"
    mine.mkdir()
    for path in (people[0].root / "atlas").glob("*.exr"):
        write_exr(mine / path.name, command._resized(read_exr(path), (48, 32)))
    truth = ProcessedFolder(shutil.copytree(people[0].root, tmp_path / "truth"))
    row, column = np.mgrid[:96, :64]
    # Of the texels of two by two at the left edge three quarters were captured.
    seen = (column > 16) | ((column == 16) & (row % 2 == 0))
    for name in command.NEEDED:
        image = truth.read_atlas(name)
        truth.write_atlas(name, image * (seen[..., None] if image.ndim == 3 else seen))
    (truth.root / "atlas" / "confidence.exr").unlink()
    figures = evaluate(mine, "--truth", truth.root).facts["figures"]
    assert figures["albedo_psnr_db"]["mean"] > 100
    assert figures["specular_rmse"]["mean"] < 1e-5
    assert figures["relit_key_db"]["mean"] > 60


def test_what_is_no_pair_is_refused(
    people: list[ProcessedFolder], tmp_path: Path, evaluate: Callable[..., Ended]
) -> None:
    a, b, c = (person.root for person in people[:3])
    done = evaluate(a, b, c, "--truth", a, "--truth", b)
    assert done.code == 2
    assert "one for each of 3 inferred folders" in done.err
    lacking = tmp_path / "lacking"
    shutil.copytree(a / "atlas", lacking)
    (lacking / "specular_normal.exr").unlink()
    done = evaluate(lacking, "--truth", a)
    assert (done.code, "specular_normal.exr" in done.err) == (2, True)
    other = brightened(people[0], tmp_path / "other", 1.0)
    for path in other.glob("*.exr"):
        write_exr(path, read_exr(path)[:, :-3])
    done = evaluate(other, "--truth", a)
    assert (done.code, "template's layout" in done.err) == (2, True)
    assert evaluate(a, "--truth", a, "--data", "real").code == 2
    spoiled = brightened(people[0], tmp_path / "spoiled", np.nan)
    for words in ((spoiled, "--truth", a), (a, "--truth", spoiled)):
        done = evaluate(*words, "--out", tmp_path / "figures.json")
        assert (done.code, "diffuse_albedo.exr" in done.err) == (2, True)
    assert evaluate(a, "--truth", tmp_path / "absent").code == 2
    assert not list(tmp_path.glob("figures*"))


def test_normals_that_were_not_found_are_ninety_degrees_off() -> None:
    true = np.zeros((2, 2, 3))
    true[0] = 0, 0, 1  # the second row is not known
    found = np.zeros((2, 2, 3))
    found[0, 0] = found[1] = 0, 0, 1
    figures = normal_measures("n", found, true, np.ones((2, 2), bool))
    assert figures["n_mean_deg"] == pytest.approx(45)
    # Of two normals, six numbers, one is .5 off.
    assert figures["n_psnr_db"] == pytest.approx(-10 * np.log10(0.25 / 6))


def test_structural_similarity_is_that_of_a_plain_loop() -> None:
    rng = np.random.default_rng(0)
    one, other = rng.random((2, 24, 20, 3))
    where = np.ones((24, 20), bool)
    where[:4] = False
    at = np.arange(-5, 6)
    window = np.exp(-(at[:, None] ** 2 + at**2) / (2 * 1.5**2))
    window /= window.sum()
    values = []
    for row in range(9, 19):
        for column in range(5, 15):
            if not where[row - 5 : row + 6, column - 5 : column + 6].all():
                continue
            for channel in range(3):
                a = one[row - 5 : row + 6, column - 5 : column + 6, channel]
                b = other[row - 5 : row + 6, column - 5 : column + 6, channel]
                ma, mb = (window * a).sum(), (window * b).sum()
                va, vb = (window * a * a).sum() - ma**2, (window * b * b).sum() - mb**2
                cov = (window * a * b).sum() - ma * mb
                top = (2 * ma * mb + 1e-4) * (2 * cov + 9e-4)
                values.append(top / ((ma**2 + mb**2 + 1e-4) * (va + vb + 9e-4)))
    found = ssim(one, other, where)
    assert found == pytest.approx(np.mean(values), rel=1e-6)
    assert ssim(one, one, where) == pytest.approx(1)
    assert np.isnan(ssim(one, other, np.zeros_like(where)))


def test_the_typology_angle_is_that_of_the_colour_library() -> None:
    for rgb in ([0.5, 0.32, 0.24], [0.12, 0.06, 0.04], [0.7, 0.55, 0.45]):
        xyz = colour.RGB_to_XYZ(rgb, "sRGB", apply_cctf_decoding=False)
        lab = colour.XYZ_to_Lab(
            xyz, colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
        )
        wanted = np.degrees(np.arctan((lab[0] - 50) / lab[2]))
        assert ita_deg(np.array([rgb])) == pytest.approx(wanted, abs=0.3)
    assert (tone_of(60), tone_of(20), tone_of(-40)) == ("very light", "tan", "dark")


def test_intervals_hold_the_mean_and_shrink_with_people() -> None:
    rng = np.random.default_rng(1)
    few, many = (interval(list(rng.normal(30, 2, n))) for n in (5, 200))
    assert few.low < few.mean < few.high
    assert many.high - many.low < 0.4 * (few.high - few.low)
    assert np.isnan(interval([3.0]).low)
    assert np.isnan(interval([float("nan")]).mean)


def test_errors_by_tone_tell_the_worst_over_the_best() -> None:
    groups = by_tone([60.0, 58.0, -40.0], [1.0, 1.0, 4.0])
    assert groups == {"very light": (2, 1.0), "dark": (1, 4.0)}
    assert spread(groups) == pytest.approx(4)
    assert np.isnan(spread({"tan": (1, 2.0)}))


@given(
    scale=st.sampled_from([1e-6, 1.0, 1e6]),
    zero=st.booleans(),
    seed=st.integers(0, 100),
)
@settings(max_examples=20, deadline=None)
def test_any_maps_give_finite_figures(scale: float, zero: bool, seed: int) -> None:
    rng = np.random.default_rng(seed)
    found = (rng.random((16, 16, 3)) - 0.1).astype(np.float32) * np.float32(scale)
    if zero:
        found[:] = 0
    true = rng.random((16, 16, 3)).astype(np.float32)
    skin = np.ones((16, 16), bool)
    figures = albedo_measures(found, true, skin)
    figures |= normal_measures("n", found, true, skin)
    assert all(np.isfinite(value) for value in figures.values())
    assert np.isfinite(ita_deg(found.reshape(-1, 3)))
