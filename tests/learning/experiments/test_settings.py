"""What each setting of an experiment is: its people, its training, what it is compared with."""

from __future__ import annotations

import dataclasses
import itertools
import json
from pathlib import Path

import numpy as np
import pytest

from learning.errors import TrainingError
from learning.experiments.command import ABOUT, SCHEMA, _require_same
from learning.experiments.config import SIZES, SMALL_ONLY, sized
from learning.experiments.held_out import FIGURES
from learning.experiments.people import Halves, halves_of, of_variant, store_of, subject_of
from learning.experiments.report import Setting, _pairs, _sentences
from learning.experiments.variants import EXPERIMENTS, STEPS, TIME, Variant, training_of
from learning.experiments.work import DONE
from learning.patch_config import TrainConfig
from lightstage.errors import ConfigError
from lightstage.formats.files import write_json
from processing.dataset import open_store
from tests.programs import run_program

TINY = sized("tiny", {"patch_px": 32}, "test")


def test_people_in_both_halves_are_refused_by_name_and_by_their_files(store_path: Path) -> None:
    store = open_store(store_path)
    both = dataclasses.replace(
        TINY, train_names=("person-0", "person-1"), held_out_names=("person-1",)
    )
    with pytest.raises(TrainingError, match="person-1 in both"):
        halves_of(store, both)
    same = dataclasses.replace(store.scans[2], sha256=store.scans[0].sha256)
    twice = dataclasses.replace(store, scans=(*store.scans[:2], same))
    with pytest.raises(TrainingError, match="the same files of person-0 and person-2"):
        halves_of(twice, TINY)
    with pytest.raises(TrainingError, match="stranger"):
        halves_of(store, dataclasses.replace(TINY, held_out_names=("stranger",)))
    with pytest.raises(TrainingError, match="4 or more"):
        halves_of(store, dataclasses.replace(TINY, held_out=3))


def test_a_setting_trains_on_the_people_that_it_names_and_those_held_out_stay_last(
    store_path: Path,
) -> None:
    store = open_store(store_path)
    halves = Halves(("person-1", "person-2"), ("person-0",))
    chosen = of_variant(store, halves, Variant("few", "few", "demo", {}, people=1), TINY, 3)
    assert len(chosen) == 1
    assert chosen[0] in halves.trained
    own = store_of(store, chosen, halves.held_out)
    names = sorted(scan.subject for scan in own.scans)
    assert subject_of(names[-1]) == "person-0"
    assert [scan.index for scan in own.scans] == [0, 1]
    for scan in own.scans:
        (original,) = [s for s in store.scans if s.subject == subject_of(scan.subject)]
        maps = [
            s.read(i, "diffuse_albedo", slice(0, 9), slice(0, 9))
            for s, i in ((own, scan.index), (store, original.index))
        ]
        np.testing.assert_array_equal(*maps)
    assert own.fingerprint != store.fingerprint


def test_tones_that_are_left_out_are_those_at_the_end_that_is_named(store_path: Path) -> None:
    store = open_store(store_path)
    halves = Halves(("person-0", "person-1"), ("person-2",))
    kept = {
        without: of_variant(
            store, halves, Variant("some", "some", "demo", {}, without=without), TINY, 0
        )
        for without in ("lightest", "darkest")
    }
    (dark,), (light,) = kept["lightest"], kept["darkest"]
    mean = {
        scan.subject: store.read(scan.index, "diffuse_albedo", slice(None), slice(None)).mean()
        for scan in store.scans
    }
    assert mean[dark] < mean[light]


def test_leaving_tones_out_is_compared_with_as_many_people_of_all_tones() -> None:
    class Toned:
        path = Path("store")

    names = tuple(f"person-{index:02}" for index in range(16))
    halves = Halves(names, ("stranger",))
    tones = {name: float(index) for index, name in enumerate(names)}
    variants = {v.name: v for v in EXPERIMENTS["people"](TINY).variants}
    assert {v.name: v.against for v in variants.values() if v.against} == {
        "no-lightest": "three-quarters", "no-darkest": "three-quarters",
    }  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("learning.experiments.people.tones_of", lambda *_: tones)

        def chosen(name: str, seed: int) -> tuple[str, ...]:
            return of_variant(Toned(), halves, variants[name], TINY, seed)  # type: ignore[arg-type]

        assert chosen("no-lightest", 0) == names[:12]
        assert chosen("no-darkest", 0) == names[4:]
        controls = [chosen("three-quarters", seed) for seed in range(5)]
        assert {len(one) for one in controls} == {12}
        assert len(set(controls)) > 1
        assert all(set(one) < set(names) for one in controls)
        assert chosen("three-quarters", 3) == controls[3]


def setting_of(name: str, errors: dict[tuple[int, str], float], **more: object) -> Setting:
    """A setting whose figures are all one number for each seed and person."""
    runs = [
        {
            "seed": seed,
            "state": DONE,
            "people": [
                {"name": who, "lights": {"target": dict.fromkeys(FIGURES, value)}}
                for (other, who), value in errors.items()
                if other == seed
            ],
        }
        for seed in sorted({seed for seed, _ in errors})
    ]
    return Setting(Variant(name, name, "demo", {}, **more), runs)  # type: ignore[arg-type]


def test_a_setting_is_compared_with_the_one_that_it_names_or_with_its_neighbour() -> None:
    one = {(0, "a"): 1.0}
    named = {"against": "three-quarters"}
    settings = [
        setting_of("people-8", one), setting_of("three-quarters", one),
        setting_of("no-lightest", one, **named), setting_of("no-darkest", one, **named),
    ]  # fmt: skip
    found = [(a.variant.name, b.variant.name) for a, b in _pairs(settings)]
    assert found == [
        ("people-8", "three-quarters"), ("three-quarters", "no-lightest"),
        ("three-quarters", "no-darkest"),
    ]  # fmt: skip
    # Without the control there is nothing to compare with: a neighbour differs in two things.
    assert _pairs([settings[0], *settings[2:]]) == []


def test_the_gain_of_the_last_published_step_is_over_the_seeds_and_people_that_both_have() -> None:
    first = setting_of("four", {(0, "a"): 10.0, (0, "b"): 10.0})
    last = setting_of("occlusion", {(0, "a"): 5.0, (0, "b"): 5.0, (1, "a"): 20.0, (1, "b"): 20.0})
    (headline, *_) = _sentences(STEPS, [first, last])
    assert "is 50 % below the first" in headline
    apart = setting_of("occlusion", {(1, "a"): 20.0})
    assert not any("the first" in sentence for sentence in _sentences(STEPS, [first, apart]))


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", EXPERIMENTS)
def test_every_setting_of_every_size_is_a_training_that_its_bounds_allow(
    name: str, size: str
) -> None:
    config = sized(size, {}, "test")
    experiment = EXPERIMENTS[name](config)
    assert len({variant.name for variant in experiment.variants}) == len(experiment.variants)
    for variant in experiment.variants:
        for budget in (STEPS, TIME):
            timed = dataclasses.replace(config, seconds=5.0)
            training = training_of(variant, timed, budget, 7, 2)
            assert (training.seed, training.held_out_subjects) == (7, 2)
            assert training.seconds == (5.0 if budget == TIME else None)


def test_neighbours_of_the_ladder_differ_by_one_thing() -> None:
    config = sized("small", {}, "test")
    rungs = [v for v in EXPERIMENTS["ladder"](config).variants if v.preset == "demo"]
    trainings = [training_of(v, config, STEPS, 0, 5) for v in rungs]
    lines = []
    for one, other in itertools.pairwise(trainings):
        assert isinstance(one, TrainConfig)
        assert isinstance(other, TrainConfig)
        flat = [
            {**vars(t), **{f"data.{k}": v for k, v in vars(t.data).items()}} for t in (one, other)
        ]
        lines.append({k for k in flat[0] if k != "data" and flat[0][k] != flat[1][k]})
    assert lines == [
        {"render_weight", "render_norm"}, {"data.whole"}, {"environments"}, {"environments"},
        {"data.shadow_rows"},
    ]  # fmt: skip


def test_no_training_at_all_and_unknown_keys_are_refused() -> None:
    with pytest.raises(ConfigError, match="steps, seconds: found 0 each"):
        sized("small", {"steps": 0, "seconds": 0.0}, "x.toml")
    with pytest.raises(ConfigError, match="unknown key"):
        sized("small", {"rungs": 3}, "x.toml")
    with pytest.raises(ConfigError, match="environments: found 11"):
        sized("small", {"environments": 11}, "x.toml")


def test_epochs_are_refused_where_no_training_has_them(store_path: Path, tmp_path: Path) -> None:
    own = tmp_path / "x.toml"
    own.write_text("epochs = 3\n")
    words = ["experiment", "ladder", "--data", store_path, "--out", tmp_path / "L"]
    ended = run_program("learning", *words, "--size", "tiny", "--config", own)
    assert ended.code == 2
    assert "x.toml, epochs: found 3, expected no value without published networks" in ended.err
    assert "Set steps, or choose --size full." in ended.err
    assert not (tmp_path / "L").exists()


def test_an_experiment_goes_on_where_only_a_value_differs_that_changes_no_training(
    tmp_path: Path,
) -> None:
    path = tmp_path / ABOUT
    for size, ineffective, effective in (
        ("small", {"epochs": 3}, {"steps": 3}),
        ("full", {"steps": 300, "width": 3}, {"epochs": 3}),
        ("full", {"steps": 300, "width": 3}, {"steps": 0}),
    ):
        now = {
            "name": "ladder",
            "data_fingerprint": "f",
            "config": json.loads(json.dumps(dataclasses.asdict(sized(size, {}, "test")))),
        }
        write_json(path, {"schema": SCHEMA, **now, "config": {**now["config"], **ineffective}})
        _require_same(path, now)
        write_json(path, {"schema": SCHEMA, **now, "config": {**now["config"], **effective}})
        with pytest.raises(ConfigError, match=f"{next(iter(effective))}: found"):
            _require_same(path, now)


def test_sizes_that_published_networks_do_not_have_are_refused_with_them() -> None:
    with pytest.raises(ConfigError, match=r"x\.toml, width, batch: found a value") as refused:
        sized("full", {"batch": 1, "width": 8, "seeds": 2}, "x.toml")
    assert "choose another --size" in str(refused.value)
    assert sized("full", {"published": False, "batch": 1}, "x.toml").batch == 1
    assert sized("full", {"seeds": 2, "epochs": 3}, "x.toml").epochs == 3
    with pytest.raises(ConfigError, match=r"x\.toml, steps: found 300, .* Set epochs"):
        sized("full", {"steps": 300}, "x.toml")
    with pytest.raises(ConfigError, match=r"x\.toml, epochs: found 3, and 0 steps"):
        sized("full", {"steps": 0, "seconds": 60.0, "epochs": 3}, "x.toml")
    assert sized("full", {"steps": 0, "seconds": 60.0}, "x.toml").steps == 0
    # Each of them changes a training of another size and none of this one.
    for name in SMALL_ONLY:
        trainings = []
        for published in (False, True):
            config = dataclasses.replace(sized("small", {}, "test"), published=published)
            other = dataclasses.replace(config, **{name: 2 * getattr(config, name)})
            trainings.append(
                [
                    [training_of(v, c, STEPS, 0, 5) for v in EXPERIMENTS["ladder"](c).variants]
                    for c in (config, other)
                ]
            )
        assert trainings[0][0] != trainings[0][1]
        assert trainings[1][0] == trainings[1][1]
