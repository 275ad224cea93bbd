"""The command `experiment` on three balls: runs, their resumption, its report, what it refuses."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import shutil
import signal
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from learning.checkpoint import load_whole_face
from learning.errors import TrainingError
from learning.experiments import command, work
from learning.experiments.command import ExperimentRequest, experiment_command, left_line
from learning.experiments.config import sized
from learning.experiments.drive import THREADS, _executor, run_all
from learning.experiments.held_out import FIGURES, measure, read_subjects
from learning.experiments.lights import NAMES
from learning.experiments.people import halves_of, store_of
from learning.experiments.report import SHEET_TEXT_PX
from learning.experiments.variants import EXPERIMENTS, STEPS
from learning.experiments.work import DIVERGED, DONE, SHOWN, STOPPED, Order, one_run
from learning.patch_light import target_environment
from learning.render.environments import RandomLightConfig
from learning.whole.infer import infer_whole_face
from lightstage.commands import quiet
from lightstage.errors import ConfigError, LightstageError, MemoryLimitError
from processing.dataset import open_store

TINY = sized("tiny", {"patch_px": 32}, "test")


def asked(name: str, out: Path, data: Path | None, **more: object) -> ExperimentRequest:
    given = {"size": "tiny", "device": "cpu", **more}
    return ExperimentRequest(name, out, data, **given)  # type: ignore[arg-type]


def run(request: ExperimentRequest) -> dict:
    return experiment_command(request, quiet, lambda _: None)


@pytest.fixture(scope="module")
def finished(store_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ladder of which three settings are finished."""
    out = tmp_path_factory.mktemp("ladder") / "out"
    facts = run(asked("ladder", out, store_path, only="single,modern,modern-refined"))
    assert (facts["finished"], facts["now"], facts["left"]) == (3, 3, 0)
    return out


def test_runs_at_once_share_the_cores_that_this_process_may_use(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in THREADS:
        monkeypatch.delenv(name, raising=False)
    # Of a machine of 64 six are ours, as in a container or by SLURM.
    monkeypatch.setattr("os.cpu_count", lambda: 64)
    monkeypatch.setattr("os.sched_getaffinity", lambda _: set(range(6)))
    with _executor(3, None):
        assert [os.environ[name] for name in THREADS] == ["2"] * len(THREADS)


def test_a_ladder_leaves_figures_of_each_person_and_light_and_no_weights(finished: Path) -> None:
    folders = sorted(path.parent for path in finished.glob("runs/*/*/figures.json"))
    assert [path.name for path in folders] == [
        "modern-refined-steps-seed0", "modern-steps-seed0", "single-steps-seed0",
    ]  # fmt: skip
    for folder in folders:
        figures = json.loads((folder / "figures.json").read_text())
        assert figures["state"] == DONE
        (person,) = figures["people"]
        assert person["name"] == "person-2"
        assert list(person["lights"]) == ["target", "side-right"]
        assert all(light.keys() == set(FIGURES) for light in person["lights"].values())
        pictures = {path.name for path in folder.glob("*.png")}
        assert pictures == {"target-1.png", "side-right-1.png"}
    # A refinement needs the network that it refines, but not its optimiser.
    kept = {path.parent.parent.name for path in finished.rglob("*.safetensors")}
    assert kept == {"modern-steps-seed0"}
    assert not list(finished.rglob("training-*.safetensors"))


def test_the_figures_of_a_run_are_those_of_the_network_that_it_left(
    finished: Path, store_path: Path
) -> None:
    (folder,) = finished.glob("runs/*/modern-steps-seed0")
    network, _ = load_whole_face(folder / "training")
    (subject,) = read_subjects(
        store_of(open_store(store_path), (), ("person-2",)), {"b-person-2"}, TINY.shadow_rows
    )
    target = target_environment(RandomLightConfig(), "physical", 0)
    found = measure(
        subject,
        target,
        ("target", "side-right"),
        lambda texture, mesh: infer_whole_face(network, texture, mesh, np.eye(3, 4)),
    )
    (person,) = json.loads((folder / "figures.json").read_text())["people"]
    for each in found:
        assert person["lights"][each.light] == pytest.approx(each.figures, rel=1e-4)


def test_a_second_call_finds_all_done_and_the_report_can_be_written_without_data(
    finished: Path, store_path: Path
) -> None:
    again = run(asked("ladder", finished, store_path, only="single,modern,modern-refined"))
    assert (again["finished"], again["now"]) == (3, 0)
    facts = run(asked("ladder", finished, None, report=True))
    assert facts["finished"] == 3
    text = (finished / "report.md").read_text()
    assert "| single network | 80 |" in text
    assert "another data set, another size" in text
    assert "1 seed: the intervals hardly include what another seed would give" in text
    assert "1 person held out: the intervals are too narrow" in text
    assert "| `modern`, network alone | single network |" in text
    settings = json.loads((finished / "report.json").read_text())["budgets"][STEPS]["settings"]
    assert [each["name"] for each in settings] == ["single", "modern", "modern-refined"]
    # One dot for each seed of each setting.
    assert (finished / "reflectance-steps.svg").read_text().count("<circle ") == 3


def test_the_sheet_has_a_row_for_each_person_held_out_and_light_and_warns_of_no_missing_one(
    finished: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = shutil.copytree(finished, tmp_path / "out")
    for folder in (path.parent for path in out.glob("runs/*/*/figures.json")):
        for light in SHOWN:
            shutil.copyfile(folder / f"{light}-1.png", folder / f"{light}-2.png")
    heights = []
    for folder in (finished, out):
        run(asked("ladder", folder, None, report=True))
        sheet = cv2.imread(str(folder / "albedo.png"))
        assert sheet is not None
        heights.append(len(sheet))
    # Two lights of one person, then of two.
    assert (heights[0] - SHEET_TEXT_PX) * 2 == heights[1] - SHEET_TEXT_PX > 0
    assert ".png" not in capfd.readouterr().err


def test_runs_of_other_code_are_kept_apart_and_named(
    finished: Path, store_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "code_version", lambda: "9.9+other")
    run(asked("ladder", finished, None, report=True))
    # With no run of this code the report is of the code that has most.
    (own,) = (path.name for path in (finished / "runs").iterdir())
    assert f"\nCode {own}.\n" in (finished / "report.md").read_text()
    folder = finished / "runs" / "9.9+other" / "single-steps-seed0"
    folder.mkdir(parents=True)
    some = (finished / "runs" / own / "single-steps-seed0" / "figures.json").read_text()
    (folder / "figures.json").write_text(some)
    run(asked("ladder", finished, None, report=True))
    text = (finished / "report.md").read_text()
    assert "\nCode 9.9+other.\n" in text
    assert f"Runs of other code in this folder are not in the tables: 3 of {own}.\n" in text


def order_of(store_path: Path, out: Path, variant: str = "single", **more: object) -> Order:
    config = dataclasses.replace(TINY, steps=4, save_seconds=0.0)
    (chosen,) = [v for v in EXPERIMENTS["ladder"](config).variants if v.name == variant]
    halves = halves_of(open_store(store_path), config)
    order = Order(store_path, out / "runs", out / "shadows", chosen, STEPS, 0, config, halves)
    return dataclasses.replace(order, **more)  # type: ignore[arg-type]


def test_a_run_that_is_stopped_goes_on_and_gives_the_same_figures(
    store_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = one_run(order_of(store_path, tmp_path / "whole"))
    order = order_of(store_path, tmp_path / "stopped")
    asks = iter([False, False, True])
    monkeypatch.setattr(Order, "over", lambda _: next(asks, True))
    assert one_run(order)["state"] == STOPPED
    assert (order.folder / "training" / "checkpoint.json").is_file()
    assert not order.finished
    monkeypatch.undo()
    again = one_run(order)
    assert again["state"] == DONE
    assert again["steps"] == whole["steps"] == 4
    assert again["people"] == whole["people"]


def test_a_run_that_is_stopped_while_it_is_measured_is_not_trained_again(
    store_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    order = order_of(store_path, tmp_path)

    def stopped(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(work, "_measured", stopped)
        with pytest.raises(KeyboardInterrupt):
            one_run(order)
    trained = json.loads((order.folder / "training" / "trained.json").read_text())
    monkeypatch.setattr(work, "train", stopped)
    again = one_run(order)
    assert again["state"] == DONE
    assert {name: again[name] for name in trained} == trained
    assert again["steps_a_second"] > 0


def test_figures_that_are_not_finite_are_those_of_a_run_that_diverged(
    store_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    measure = work.measure

    def wrong(*given: Any) -> Any:
        found = measure(*given)
        return [dataclasses.replace(f, figures=dict.fromkeys(f.figures, math.nan)) for f in found]

    monkeypatch.setattr(work, "measure", wrong)
    order = order_of(store_path, tmp_path)
    assert one_run(order)["state"] == DIVERGED
    assert order.finished
    kept = json.loads((order.folder / "figures.json").read_text())
    assert kept["state"] == DIVERGED
    assert not (order.folder / "training").exists()


def test_a_training_whose_files_are_gone_begins_again(
    store_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    order = order_of(store_path, tmp_path)
    asks = iter([False, False, True])
    monkeypatch.setattr(Order, "over", lambda _: next(asks, True))
    one_run(order)
    monkeypatch.undo()
    (lost,) = (order.folder / "training").glob("training-*.safetensors")
    lost.unlink()
    assert one_run(order)["steps"] == 4


def test_a_deadline_and_a_stop_file_keep_a_run_from_beginning(
    store_path: Path, tmp_path: Path
) -> None:
    assert one_run(order_of(store_path, tmp_path, deadline=0.0))["state"] == STOPPED
    stop = tmp_path / ".stop"
    stop.touch()
    assert one_run(order_of(store_path, tmp_path, stop=stop))["state"] == STOPPED
    assert not (tmp_path / "runs").exists()


def test_a_seed_that_diverged_is_counted_and_shown_and_other_errors_are_not_taken_for_one(
    store_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def diverging(_: object, out: Path, *__: object, **___: object) -> None:
        raise TrainingError(out, field="step 3", found="losses that are not finite")

    monkeypatch.setattr(work, "train", diverging)
    out = tmp_path / "out"
    facts = run(asked("ladder", out, store_path, only="single"))
    assert (facts["finished"], facts["diverged"]) == (1, 1)
    text = (out / "report.md").read_text()
    assert "1 of 1 seed of single network diverged" in text

    def failing(_: object, where: Path, *__: object, **___: object) -> None:
        raise TrainingError(where, field="patches", found="none")

    monkeypatch.setattr(work, "train", failing)
    with pytest.raises(TrainingError, match="found none"):
        run(asked("ladder", tmp_path / "other", store_path, only="single"))
    assert not list((tmp_path / "other").rglob("figures.json"))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"name": "scene"}, "name: found 'scene', expected 'ladder'"),
        ({"size": "demo"}, "steps"),
    ],
)
def test_two_experiments_in_one_folder_are_refused(
    finished: Path, store_path: Path, changed: dict, message: str
) -> None:
    request = dataclasses.replace(asked("ladder", finished, store_path), **changed)
    if changed.get("size") == "demo":
        config = finished.parent / "held.toml"
        config.write_text("held_out = 1\n")
        request = dataclasses.replace(request, config=config)
    with pytest.raises(ConfigError, match=message):
        run(request)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"name": "nonsense"}, "expected one of ladder"),
        ({"size": "huge"}, "--size"),
        ({"only": "single,double"}, "--only: found 'double'"),
        ({"jobs": 0}, "--jobs"),
        ({"prepare": True, "report": True}, "--report, --prepare: found both"),
        ({"prepare": True, "scheduler": "tcp://b:1"}, "--prepare, --scheduler: found both"),
        ({"prepare": True, "jobs": 2}, "--prepare, --jobs: found both"),
        ({"jobs": 2, "scheduler": "tcp://b:1"}, "--scheduler, --jobs: found both"),
        ({"seeds": 0}, "--seeds"),
        ({"stop_after": float("nan")}, "--stop-after"),
        ({"data": None}, "--data"),
        ({"device": "abacus"}, "--device"),
        ({"name": "people", "only": "people-8"}, "2 people to train on, expected 8 or more"),
    ],
)
def test_what_is_asked_wrongly_is_refused_before_anything_is_written(
    store_path: Path, tmp_path: Path, changed: dict, message: str
) -> None:
    request = dataclasses.replace(asked("ladder", tmp_path / "out", store_path), **changed)
    with pytest.raises(LightstageError, match=message):
        run(request)
    assert not (tmp_path / "out").exists()


def test_a_folder_of_other_files_is_refused(store_path: Path, tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(ConfigError, match=r"holds thesis\.tex"):
        run(asked("ladder", tmp_path, store_path))


def test_a_full_memory_has_a_hint_that_its_size_allows(
    store_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise torch.OutOfMemoryError("out of memory")

    monkeypatch.setattr(work, "train", full)
    with pytest.raises(LightstageError, match="smaller batch or patch_px"):
        one_run(order_of(store_path, tmp_path))
    config = dataclasses.replace(TINY, published=True)
    monkeypatch.setattr(
        work,
        "_config",
        lambda *_: work.training_of(EXPERIMENTS["ladder"](TINY).variants[1], TINY, STEPS, 0, 1),
    )
    with pytest.raises(LightstageError, match="GPU of more memory") as found:
        one_run(order_of(store_path, tmp_path, config=config))
    assert "batch" not in found.value.hint


@pytest.mark.parametrize("count", [1, 2, 4, 6, 7, 10])
def test_of_two_lights_to_six_the_last_is_the_lamp_from_the_right(
    store_path: Path, tmp_path: Path, count: int
) -> None:
    config = dataclasses.replace(TINY, environments=count)
    names = work._lights(order_of(store_path, tmp_path, config=config))
    if 2 <= count <= 6:
        assert names == (*NAMES[: count - 1], "side-right")
    else:
        assert names == NAMES[:count]


def test_how_long_is_left_is_estimated_by_the_runs_that_are_finished(
    store_path: Path, tmp_path: Path
) -> None:
    orders = [
        order_of(store_path, tmp_path, variant) for variant in ("single", "rendering", "whole")
    ]
    assert "known once one is finished" in left_line(orders, orders, 1, TINY)
    orders[0].folder.mkdir(parents=True)
    figures = {
        "schema": work.FIGURES_SCHEMA, "state": DONE, "seed": 0, "seconds": 300.0,
    }  # fmt: skip
    (orders[0].folder / "figures.json").write_text(json.dumps(figures))
    assert left_line(orders, orders[1:], 1, TINY) == "2 runs of 3 left, about 10 min"
    assert left_line(orders, orders[1:], 2, TINY) == "2 runs of 3 left, about 5 min"
    # A scheduler's workers may be any number.
    assert left_line(orders, orders[1:], None, TINY) == (
        "2 runs of 3 left, about 10 min of one worker"
    )
    assert left_line(orders, [], 2, TINY) == "all 3 runs are finished"


def answered(order: Order) -> dict:
    return {"state": DONE, "name": order.name}


def failed(order: Order) -> dict:
    raise TrainingError(order.folder, found="nothing")


def test_a_refinement_waits_for_the_run_that_it_refines(store_path: Path, tmp_path: Path) -> None:
    orders = [order_of(store_path, tmp_path, name) for name in ("modern-refined", "modern")]
    names: list[str] = []
    run_all(orders, 1, None, lambda _, figures: names.append(figures["name"]), answered)
    assert names == ["modern-steps-seed0", "modern-refined-steps-seed0"]


@pytest.mark.parametrize("when", ["in training", "in its answers"])
def test_a_refinement_of_a_training_that_diverged_has_diverged_too(
    store_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, when: str
) -> None:
    if when == "in training":
        train = work.train

        def diverging(store: object, out: Path, *more: object, **named: object) -> None:
            train(store, out, *more, **named)  # type: ignore[arg-type]
            raise TrainingError(out, field="step 3", found="losses that are not finite")

        monkeypatch.setattr(work, "train", diverging)
        source = one_run(order_of(store_path, tmp_path, "modern"))
        monkeypatch.undo()
    else:
        source = one_run(order_of(store_path, tmp_path, "modern"))
        path = order_of(store_path, tmp_path, "modern").folder / work.FIGURES_FILE
        source |= {"state": DIVERGED, "said": "figures that are not finite"}
        path.write_text(json.dumps(source))
    assert source["state"] == DIVERGED
    refined = one_run(order_of(store_path, tmp_path, "modern-refined"))
    assert refined["state"] == DIVERGED
    assert refined["said"].startswith("modern: ")
    assert "people" not in refined


def test_a_refinement_without_the_run_that_it_refines_names_it(
    store_path: Path, tmp_path: Path
) -> None:
    with pytest.raises(TrainingError, match="Name modern in --only too"):
        one_run(order_of(store_path, tmp_path, "modern-refined"))


def test_runs_that_fail_are_named_once_the_others_are_done(
    store_path: Path, tmp_path: Path
) -> None:
    orders = [order_of(store_path, tmp_path, name) for name in ("single", "whole")]
    ends = run_all(orders, 1, None, lambda *_: None, failed)
    assert [order.variant.name for order, _ in ends] == ["single", "whole"]


def killed(order: Order) -> dict:
    os.kill(os.getpid(), signal.SIGKILL)
    return {}


def broken(order: Order) -> dict:
    raise ZeroDivisionError(order.name)


def test_a_mistake_in_one_run_leaves_the_others_and_is_raised_as_it_is(
    store_path: Path, tmp_path: Path
) -> None:
    orders = [order_of(store_path, tmp_path, name) for name in ("single", "whole")]
    ends = run_all(orders, 1, None, lambda *_: None, broken)
    assert len(ends) == 2
    assert isinstance(command._failure([error for _, error in ends]), ZeroDivisionError)
    same = [TrainingError("a store", found="nothing")] * 2
    assert str(command._failure(list(same))) == str(same[0])


def test_a_run_whose_process_is_killed_is_reported_in_words(
    store_path: Path, tmp_path: Path
) -> None:
    order = order_of(store_path, tmp_path, deadline=0.0)
    with pytest.raises(MemoryLimitError, match="process that was killed"):
        run_all([order], 2, None, lambda *_: None, killed)


def test_processes_do_the_runs(store_path: Path, tmp_path: Path) -> None:
    order = order_of(store_path, tmp_path, deadline=0.0)
    ends: list[str] = []
    run_all([order], 2, None, lambda _, figures: ends.append(figures["state"]), one_run)
    assert ends == [STOPPED]


def test_workers_of_a_scheduler_do_the_runs(store_path: Path, tmp_path: Path) -> None:
    import distributed

    order = order_of(store_path, tmp_path, deadline=0.0)
    ends: list[str] = []
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None, protocol="tcp"
    ) as cluster:
        address = str(cluster.scheduler_address)
        run_all([order], 1, address, lambda _, figures: ends.append(figures["state"]), one_run)
    assert ends == [STOPPED]


def test_a_scheduler_that_does_not_answer_is_named(
    store_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("learning.experiments.drive.ANSWER_S", 0.2)
    order = order_of(store_path, tmp_path, deadline=0.0)
    with pytest.raises(ConfigError, match="--scheduler: found nothing that answers"):
        run_all([order], 1, "tcp://127.0.0.1:9", lambda *_: None, one_run)


def test_nothing_is_trained_where_shadows_alone_are_asked_for(
    store_path: Path, tmp_path: Path
) -> None:
    facts = run(
        asked("ladder", tmp_path / "out", store_path, only="occlusion,modern", prepare=True)
    )
    assert (facts["prepared"], facts["to_prepare"]) == (2, 2)
    assert list((tmp_path / "out" / "shadows").glob("*.npz"))
    assert not (tmp_path / "out" / "runs").exists()
