"""What `experiment` does: plan the runs, do those that are not finished, report what is there."""

from __future__ import annotations

import dataclasses
import json
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from learning.checkpoint import code_version
from learning.devices import choose_device
from learning.experiments.config import BOUNDS, ExperimentConfig, effective, sized
from learning.experiments.cost import full_size_line, measure_full_size
from learning.experiments.drive import run_all, stop_file
from learning.experiments.people import Halves, halves_of
from learning.experiments.report import REPORT, figures_of, write_report
from learning.experiments.variants import EXPERIMENTS, TIME, Experiment, budgets, training_of
from learning.experiments.work import (
    DIVERGED,
    FIGURES_FILE,
    SHADOWS,
    STOPPED,
    Order,
    bake_shadows,
    one_run,
)
from lightstage.commands import ProgressCallback
from lightstage.counting import counted
from lightstage.errors import ConfigError, LightstageError, one_error
from lightstage.formats.config import as_dict, make_config, read_toml
from lightstage.formats.consents import require_consents
from lightstage.formats.files import others_in, read_json, write_json
from lightstage.formats.values import parse_json
from processing.dataset import Store, open_store

ABOUT, SCHEMA = "experiment.json", "lightstage.experiment/1"
RUNS = "runs"
OWN = (ABOUT, RUNS, SHADOWS, "report.*", "*.svg", "albedo.png", "full-size.json", ".*")
"""What an experiment's folder holds."""
MAY_GROW = ("seeds",)
"""Configuration that a later call may change: it does not change runs that exist."""
MOST_JOBS = 256
REPORT_EVERY_S = 30.0
WRITING_S = 20.0
"""Guess of what a run of equal time takes beside its training, until one was measured."""


@dataclasses.dataclass(frozen=True)
class ExperimentRequest:
    """The options of `experiment`.

    Attributes:
        name: of `EXPERIMENTS`.
        out: folder.
        data: store; None where only a report is wanted.
        size: of `config.SIZES`.
        config: TOML that overrides the size.
        seeds: in place of the size's.
        only: names of settings, with commas; all where None.
        jobs: runs at once on this machine.
        device: where networks run.
        stop_after: seconds after which no step is begun.
        scheduler: address of Dask's.
        keep_weights: keep each run's network; those that are refined later are always kept.
        report: only write the report.
        prepare: only bake the shadows that the runs share.
        consents: registry.
    """

    name: str
    out: Path
    data: Path | None = None
    size: str = "small"
    config: Path | None = None
    seeds: int | None = None
    only: str | None = None
    jobs: int = 1
    device: str = "auto"
    stop_after: float | None = None
    scheduler: str | None = None
    keep_weights: bool = False
    report: bool = False
    prepare: bool = False
    consents: Path | None = None


def experiment_command(
    request: ExperimentRequest, progress: ProgressCallback, report: Callable[[str], None]
) -> dict[str, Any]:
    """Do an experiment, or resume it; returns the facts.

    Args:
        request: the options.
        progress: of the runs.
        report: takes sentences for whoever waits, such as how long is left.

    Raises:
        LightstageError: bad input; nothing is written then. Runs that failed, in one message, once
            all others are done.
    """
    began = time.monotonic()
    _require_request(request)
    if request.report:
        return _reported(request)
    assert request.data is not None
    store = open_store(request.data)
    config = _config(request)
    experiment = _chosen(request, EXPERIMENTS[request.name](config))
    halves = halves_of(store, config)
    experiment, notes = _possible(experiment, len(halves.trained))
    require_consents(request.consents, "training", store.consents)
    device = choose_device(request.device)
    for variant in experiment.variants:
        training_of(variant, config, budgets(config, experiment)[0], 0, len(halves.held_out))
    _begin(request, config, store, halves)
    orders = _orders(request, config, experiment, halves)
    left = [order for order in orders if not order.finished]
    ended: list[str] = []
    if request.prepare:
        return _prepared(left, progress, began)
    at_once = request.jobs if request.scheduler is None else None
    report(left_line(orders, left, at_once, config))
    reported = time.monotonic()

    def one_ended(order: Order, figures: dict[str, Any]) -> None:
        nonlocal reported
        if figures["state"] != STOPPED:
            ended.append(order.name)
            progress(len(ended), len(left))
        if time.monotonic() - reported > REPORT_EVERY_S:
            _write(request, orders[0].runs, experiment, config, notes)
            report(left_line(orders, [o for o in orders if not o.finished], at_once, config))
            reported = time.monotonic()

    if device.type == "cuda" and request.name == "ladder":
        report(measure_full_size(request.out, device, store))
    failed = run_all(left, request.jobs, request.scheduler, one_ended, one_run)
    _write(request, orders[0].runs, experiment, config, notes)
    if failed:
        raise _failure([error for _, error in failed])
    return _facts(orders, len(ended), began, request.out)


def _failure(errors: list[Exception]) -> Exception:
    """What a command whose runs failed ends with: a mistake of this software goes first."""
    ours = [error for error in errors if not isinstance(error, LightstageError)]
    # The same fault in fifty runs is reported once.
    mendable = {str(error): error for error in errors if isinstance(error, LightstageError)}
    return ours[0] if ours else one_error(list(mendable.values()))


def left_line(
    orders: list[Order], left: list[Order], jobs: int | None, config: ExperimentConfig
) -> str:
    """How many runs are left, and how long they take by those that are finished.

    Args:
        orders: all runs.
        left: those that are not finished.
        jobs: runs at once; None where a scheduler has as many as it has workers.
        config: of the experiment.
    """
    if not left:
        return f"all {counted(len(orders), 'run')} are finished"
    known: dict[tuple[str, str], list[float]] = {}
    for order in orders:
        figures = figures_of(order.folder) if order.finished else None
        if figures is not None and "seconds" in figures:
            known.setdefault((order.variant.name, order.budget), []).append(figures["seconds"])
    each = [_expected(order, known, config) for order in left]
    sure = [value for value in each if value is not None]
    count = f"{counted(len(left), 'run')} of {len(orders)} left"
    if not sure:
        return f"{count}; how long they take is known once one is finished"
    # Those of which nothing is known yet take as long as the others.
    seconds = sum(sure) * len(each) / len(sure)
    if jobs is None:
        return f"{count}, about {time_words(seconds)} of one worker"
    return f"{count}, about {time_words(seconds / max(1, min(jobs, len(left))))}"


def time_words(seconds: float) -> str:
    """Seconds in words, with a unit that suits them."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} hours"


def _expected(
    order: Order, known: dict[tuple[str, str], list[float]], config: ExperimentConfig
) -> float | None:
    own = known.get((order.variant.name, order.budget))
    if own is None:
        same = [known[key] for key in known if key[1] == order.budget]
        own = [value for values in same for value in values]
    if own:
        return sum(own) / len(own)
    if order.budget == TIME and not order.variant.refines:
        return config.seconds + WRITING_S
    return None


def _require_request(request: ExperimentRequest) -> None:
    if request.name not in EXPERIMENTS:
        raise ConfigError(
            "experiment", found=repr(request.name), expected=f"one of {', '.join(EXPERIMENTS)}"
        )
    if not 1 <= request.jobs <= MOST_JOBS:
        raise ConfigError("--jobs", found=str(request.jobs), expected=f"1 to {MOST_JOBS}")
    elsewhere, here = request.scheduler is not None, "works on this machine alone."
    for options, both, hint in (
        ("--report, --prepare", request.report and request.prepare, "--report does nothing else."),
        ("--prepare, --scheduler", request.prepare and elsewhere, f"--prepare {here}"),
        (
            "--prepare, --jobs",
            request.prepare and request.jobs > 1,
            "It bakes one by one.",
        ),
        ("--scheduler, --jobs", elsewhere and request.jobs > 1, f"--jobs {here}"),
    ):
        if both:
            raise ConfigError(options, found="both", expected="one of them", hint=hint)
    least, most = BOUNDS["seeds"]
    if request.seeds is not None and not least <= request.seeds <= most:
        raise ConfigError("--seeds", found=str(request.seeds), expected=f"{least} to {most}")
    stop = request.stop_after
    if stop is not None and not (math.isfinite(stop) and stop > 0):
        raise ConfigError("--stop-after", found=str(stop), expected="seconds above 0")
    if request.data is None and not request.report:
        raise ConfigError(
            "--data",
            found="nothing",
            expected="a store made by `lightstage-processing dataset build`",
            hint="Without one, --report writes the report of what is finished.",
        )


def _config(request: ExperimentRequest) -> ExperimentConfig:
    overrides = read_toml(request.config) if request.config else {}
    if request.seeds is not None:
        overrides["seeds"] = request.seeds
    where = str(request.config) if request.config else f"size {request.size}"
    return sized(request.size, overrides, where)


def _chosen(request: ExperimentRequest, experiment: Experiment) -> Experiment:
    """The experiment with the settings that `--only` names."""
    if request.only is None:
        return experiment
    names = [name.strip() for name in request.only.split(",")]
    there = [variant.name for variant in experiment.variants]
    unknown = [name for name in names if name not in there]
    if unknown:
        raise ConfigError("--only", found=", ".join(map(repr, unknown)), expected=", ".join(there))
    chosen = tuple(v for v in experiment.variants if v.name in names)
    return dataclasses.replace(experiment, variants=chosen)


def _possible(experiment: Experiment, count: int) -> tuple[Experiment, list[str]]:
    """The experiment without settings that need more than `count` people to train on, and notes."""
    whole = tuple(v for v in experiment.variants if v.people <= count)
    left_out = [v.title for v in experiment.variants if v.people > count]
    if not whole:
        raise ConfigError(
            "--data",
            found=f"{counted(count, 'person', 'people')} to train on",
            expected=f"{min(v.people for v in experiment.variants)} or more",
        )
    notes = []
    if left_out:
        notes.append(
            f"Left out, as the store has {counted(count, 'person', 'people')} to train on: "
            f"{', '.join(left_out)}."
        )
    return dataclasses.replace(experiment, variants=whole), notes


def _begin(
    request: ExperimentRequest, config: ExperimentConfig, store: Store, halves: Halves
) -> None:
    """Write what the folder is of, or refuse a folder of another experiment."""
    about = {
        "schema": SCHEMA,
        "name": request.name,
        "config": parse_json(json.dumps(as_dict(config)), "configuration"),
        "data_fingerprint": store.fingerprint,
        "trained_on": list(halves.trained),
        "held_out": list(halves.held_out),
    }
    path = request.out / ABOUT
    if path.exists():
        _require_same(path, about)
    else:
        others = others_in(request.out, OWN)
        if others:
            raise ConfigError(
                request.out,
                field="--out",
                found=f"a folder that holds {others[0]}",
                expected="a new folder, or one of the same experiment",
                hint="Choose another --out.",
            )
    write_json(path, about)


def _require_same(path: Path, about: dict[str, Any]) -> None:
    then = read_json(path, SCHEMA)
    hint = "An experiment has a folder of its own; choose another --out."
    if then.get("name") != about["name"]:
        raise ConfigError(
            path,
            field="name",
            found=repr(about["name"]),
            expected=repr(then.get("name")),
            hint=hint,
        )
    if then.get("data_fingerprint") != about["data_fingerprint"]:
        raise ConfigError(
            path,
            field="data_fingerprint",
            found=f"{about['data_fingerprint'][:12]} now",
            expected=f"{str(then.get('data_fingerprint'))[:12]}, as the experiment began",
            hint=f"Give the --data that it began with. {hint}",
        )
    new = about["config"]
    old = {**new, **dict(then.get("config", {}))}
    was, now = effective(old), effective(new)
    differing = [n for n in new if n not in MAY_GROW and was.get(n) != now.get(n)]
    if differing:
        raise ConfigError(
            path,
            field=", ".join(differing),
            found=", ".join(str(new[name]) for name in differing) + " now",
            expected=", ".join(str(old[name]) for name in differing) + ", as the experiment began",
            hint=f"Give the same --size and --config. {hint}",
        )


def _orders(
    request: ExperimentRequest, config: ExperimentConfig, experiment: Experiment, halves: Halves
) -> list[Order]:
    """All runs; whole seeds one after the other, so that each is soon complete."""
    assert request.data is not None
    deadline = math.inf if request.stop_after is None else time.time() + request.stop_after
    stop = stop_file(request.out.resolve())
    refined = {variant.refines for variant in EXPERIMENTS[request.name](config).variants}
    return [
        Order(
            request.data.resolve(),
            runs_folder(request.out.resolve()),
            request.out.resolve() / SHADOWS,
            variant,
            budget,
            seed,
            config,
            halves,
            request.device,
            request.keep_weights or variant.name in refined,
            deadline,
            stop,
        )
        for seed in range(config.seeds)
        for budget in budgets(config, experiment)
        for variant in experiment.variants
    ]


def _prepared(left: list[Order], progress: ProgressCallback, began: float) -> dict[str, Any]:
    """Bake the shadows of the runs that are left until it is time to stop; returns the facts."""
    # One order of each setting and seed: a run's shadows are the same at any budget.
    differing = list({(order.variant.name, order.seed): order for order in left}.values())
    done = 0
    while done < len(differing) and not differing[done].over():
        bake_shadows(differing[done])
        done += 1
        progress(done, len(differing))
    seconds = time.monotonic() - began
    return {"prepared": done, "to_prepare": len(differing), "seconds": seconds}


def runs_folder(out: Path) -> Path:
    """Where runs of this version of the code are."""
    return out / RUNS / code_version()


def _versions(out: Path) -> dict[Path, int]:
    """Folders of runs by version of the code, and how many runs of each are finished."""
    folders = sorted(path for path in (out / RUNS).glob("*") if path.is_dir())
    return {path: len(list(path.glob(f"*/{FIGURES_FILE}"))) for path in folders}


def _reported(request: ExperimentRequest) -> dict[str, Any]:
    """Write the report of a folder from what is finished in it."""
    about = read_json(request.out / ABOUT, SCHEMA)
    if about["name"] != request.name:
        raise ConfigError(
            request.out / ABOUT,
            field="name",
            found=repr(request.name),
            expected=repr(about["name"]),
            hint="Name the experiment that this folder is of.",
        )
    config = make_config(ExperimentConfig, about["config"], request.out / ABOUT)
    experiment = _chosen(request, EXPERIMENTS[request.name](config))
    versions = _versions(request.out)
    runs = runs_folder(request.out)
    if not versions.get(runs) and any(versions.values()):
        runs = max(versions, key=versions.__getitem__)
    experiment, notes = _possible(experiment, len(about["trained_on"]))
    facts = _write(request, runs, experiment, config, notes)
    return {
        "finished": versions.get(runs, 0),
        "budgets": list(facts["budgets"]),
        "report": str(request.out / REPORT),
    }


def _write(
    request: ExperimentRequest,
    runs: Path,
    experiment: Experiment,
    config: ExperimentConfig,
    notes: list[str],
) -> dict[str, Any]:
    notes = [*notes, f"Code {runs.name}."]
    others = {path.name: n for path, n in _versions(request.out).items() if path.name != runs.name}
    if any(others.values()):
        listed = ", ".join(f"{count} of {name}" for name, count in others.items() if count)
        notes.append(f"Runs of other code in this folder are not in the tables: {listed}.")
    line = full_size_line(request.out)
    return write_report(request.out, runs, experiment, config, [*notes, *([line] if line else [])])


def _facts(orders: list[Order], ended: int, began: float, out: Path) -> dict[str, Any]:
    figures = [figures_of(order.folder) for order in orders if order.finished]
    return {
        "runs": len(orders),
        "finished": len(figures),
        "now": ended,
        "diverged": sum(f is not None and f["state"] == DIVERGED for f in figures),
        "left": len(orders) - len(figures),
        "report": str(out / REPORT),
        "seconds": time.monotonic() - began,
    }
