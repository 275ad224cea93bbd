"""`evaluate --recogniser`: identity by a network that the user supplies, and what is refused."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from learning.errors import RecogniserError
from learning.evaluation.onnx_file import Value, inputs_and_outputs
from learning.evaluation.portrait import portrait_camera
from learning.evaluation.recogniser import Recogniser, RecogniserRequest
from lightstage.formats.processed import ProcessedFolder
from lightstage.formats.template import default_template_path, load_template
from tests.learning.evaluation.called import Ended, brightened
from tests.learning.evaluation.onnx_bytes import field, linear_network

SIDE = 24
WEIGHTS = np.random.default_rng(4).normal(size=(3 * SIDE * SIDE, 6))
PICTURES = [1, 3, SIDE, SIDE]


@pytest.fixture
def recogniser(tmp_path: Path) -> Path:
    path = tmp_path / "faces.onnx"
    path.write_bytes(linear_network(WEIGHTS, [PICTURES]))
    return path


def test_identity_is_one_for_the_same_head_and_less_for_another(
    people: list[ProcessedFolder],
    tmp_path: Path,
    recogniser: Path,
    evaluate: Callable[..., Ended],
) -> None:
    a, b = people[:2]
    pattern = np.kron(np.random.default_rng(0).uniform(0.2, 1, (12, 8)), np.ones((8, 8)))
    other = brightened(a, tmp_path / "other", pattern[..., None])
    out = tmp_path / "figures.json"
    words = ["--truth", a.root, "--truth", b.root, "--recogniser", recogniser, "--out", out]
    facts = evaluate(other, b.root, *words).facts
    changed, same = (each["identity_cosine"] for each in facts["each"])
    assert same == pytest.approx(1)
    assert changed < 0.999
    assert facts["figures"]["identity_others_cosine"]["mean"] < 1
    assert facts["identity"] == "by faces.onnx"
    table = out.with_suffix(".md").read_text()
    assert "| identity_cosine |" in table
    assert "not measured" not in table


def test_without_a_recogniser_identity_is_not_measured(
    people: list[ProcessedFolder],
    tmp_path: Path,
    evaluate: Callable[..., Ended],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("learning.evaluation.command.installed", lambda: None)
    out = tmp_path / "figures.json"
    facts = evaluate(people[0].root, "--truth", people[0].root, "--out", out).facts
    assert facts["identity"] == "not measured"
    assert "identity_cosine" not in facts["figures"]
    assert "| identity | not measured |" in out.with_suffix(".md").read_text()


@pytest.mark.parametrize(
    ("values", "black", "white"), [("signed", -1, 1), ("unit", 0, 1), ("bytes", 0, 255)]
)
def test_an_embedding_is_the_networks_of_the_picture_in_its_range(
    recogniser: Path, values: str, black: float, white: float
) -> None:
    picture = np.random.default_rng(1).random((SIDE, SIDE, 3))
    found = Recogniser(RecogniserRequest(recogniser, None, values)).embedding(picture)
    given_to_it = black + (white - black) * picture
    plain = np.array([given_to_it[..., channel].ravel() for channel in range(3)]).ravel() @ WEIGHTS
    np.testing.assert_allclose(found, plain / np.linalg.norm(plain), atol=1e-4)


def test_a_size_that_the_file_leaves_open_is_the_options(tmp_path: Path) -> None:
    path = tmp_path / "open.onnx"
    path.write_bytes(linear_network(WEIGHTS, [["n", 3, "h", "w"]]))
    assert Recogniser(RecogniserRequest(path, SIDE)).size == (SIDE, SIDE)
    with pytest.raises(RecogniserError, match="--recogniser-size"):
        Recogniser(RecogniserRequest(path))
    with pytest.raises(RecogniserError, match="cannot take 1 x 3 x 32 x 32"):
        Recogniser(RecogniserRequest(path, 32))


def test_eyes_and_mouth_lie_where_aligned_pictures_have_them() -> None:
    template = load_template(default_template_path())
    turn = np.array([[0.0, 0, 1, 10], [0, 1, 0, -5], [-1, 0, 0, 3]])  # a head that looks along +x
    points = (template.mesh.vertices[template.landmarks] - turn[:, 3]) @ turn[:, :3]
    px, _ = portrait_camera(turn, (112, 112)).project(points)
    # The aligned pictures of ArcFace have the eyes at (38.3, 51.7) and (73.5, 51.5), the corners
    # of the mouth at (41.5, 92.4) and (70.7, 92.2).
    places = [px[36:42].mean(axis=0), px[42:48].mean(axis=0), px[48], px[54]]
    np.testing.assert_allclose(
        places, [(38.3, 51.7), (73.5, 51.5), (41.5, 92.4), (70.7, 92.2)], atol=4
    )


SPOILED = {
    "two pictures": (linear_network(WEIGHTS, [PICTURES, PICTURES]), [], "one input of 1 x 3"),
    "a batch": (linear_network(WEIGHTS, [[4, 3, SIDE, SIDE]]), [], "one input of 1 x 3"),
    "grey": (linear_network(WEIGHTS, [[1, 1, SIDE, SIDE]]), [], "one input of 1 x 3"),
    "tiny": (linear_network(WEIGHTS, [[1, 3, 4, 4]]), [], "16 to 1024 px"),
    "of another size": (linear_network(WEIGHTS, [[1, 3, 32, 32]]), [], "32 x 32"),
    "two outputs": (linear_network(WEIGHTS, [PICTURES], 2), [], "one output"),
    "one number": (linear_network(WEIGHTS[:, :1], [PICTURES]), [], "at least 2"),
    "NaN": (linear_network(np.full_like(WEIGHTS, np.nan), [PICTURES]), [], "NaN"),
    "zero": (linear_network(0 * WEIGHTS, [PICTURES]), [], "zero numbers"),
    "cut": (linear_network(WEIGHTS, [PICTURES])[:900], [], "no ONNX"),
    "text": (b"no network at all", [], "no ONNX"),
    "empty": (b"", [], "no ONNX"),
    "without nodes": (field(7, field(11, b"")), [], "inputs"),
    "contradicted": (linear_network(WEIGHTS, [PICTURES]), ["--recogniser-size", "32"], "24 x 24"),
    "size": (linear_network(WEIGHTS, [PICTURES]), ["--recogniser-size", "9999"], "16 to 1024"),
    "range": (linear_network(WEIGHTS, [PICTURES]), ["--recogniser-range", "x"], "signed"),
}


@pytest.mark.parametrize("spoiled", SPOILED)
def test_what_is_no_recogniser_is_refused_in_one_message(
    people: list[ProcessedFolder], tmp_path: Path, evaluate: Callable[..., Ended], spoiled: str
) -> None:
    data, more, stated = SPOILED[spoiled]
    path, out, person = tmp_path / "faces.onnx", tmp_path / "figures.json", people[0].root
    path.write_bytes(data)
    ended = evaluate(person, "--truth", person, "--out", out, "--recogniser", path, *more)
    assert ended.code == 2
    assert stated in ended.err, ended.err
    assert not out.exists()


def test_a_truth_without_a_mesh_is_refused(
    people: list[ProcessedFolder],
    tmp_path: Path,
    recogniser: Path,
    evaluate: Callable[..., Ended],
) -> None:
    bare = shutil.copytree(people[0].root / "atlas", tmp_path / "bare" / "atlas").parent
    ended = evaluate(people[0].root, "--truth", bare, "--recogniser", recogniser)
    assert (ended.code, "registered_mesh.obj" in ended.err) == (2, True)


def test_options_of_a_recogniser_without_one_are_refused(
    people: list[ProcessedFolder], evaluate: Callable[..., Ended]
) -> None:
    ended = evaluate(people[0].root, "--truth", people[0].root, "--recogniser-size", "112")
    assert (ended.code, "--recogniser FILE.onnx" in ended.err) == (2, True)


def test_inputs_are_read_without_the_weights_that_older_files_list_among_them() -> None:
    inputs, outputs = inputs_and_outputs(linear_network(WEIGHTS, [["n", 3, SIDE, "w"]]))
    assert inputs == [Value("picture0", (None, 3, SIDE, None))]
    assert outputs == [Value("embedding", (None, None))]


@given(st.binary(max_size=60), st.integers(0, 400))
@example(b"\xff" * 12, 0)
@settings(max_examples=100)
def test_any_bytes_are_a_model_or_refused(noise: bytes, at: int) -> None:
    whole = linear_network(WEIGHTS[:4, :2], [PICTURES])
    for data in (noise, whole[:at] + noise + whole[at + len(noise) :]):
        with contextlib.suppress(ValueError):
            inputs_and_outputs(data)
