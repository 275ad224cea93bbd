"""The report of an experiment, from whatever runs are finished: Markdown, JSON, plots, pictures.

It is report.md with tables, sentences and plots (`.svg`), report.json with the same figures, and
albedo.png, albedos found: a column a setting, a row a person and light.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from learning.bootstrap import Interval, interval
from learning.experiments.config import ExperimentConfig
from learning.experiments.held_out import FIGURES, IN_TARGET, REFLECTANCE, SOURCE
from learning.experiments.plot import Column, draw
from learning.experiments.statistics import over_seeds, paired, table
from learning.experiments.variants import (
    LAST_PUBLISHED,
    MODERN,
    STEPS,
    TIME,
    Experiment,
    Variant,
    budgets,
)
from learning.experiments.work import (
    DIVERGED,
    FIGURES_FILE,
    FIGURES_SCHEMA,
    SHOWN,
    SHOWN_PEOPLE,
    picture_name,
    run_name,
)
from lightstage.counting import counted
from lightstage.errors import LightstageError
from lightstage.formats.files import read_json, without_nan, write_json, write_text
from lightstage.formats.png import write_png

SCHEMA = "lightstage.experiment.report/1"
REPORT, FACTS, SHEET = "report.md", "report.json", "albedo.png"
PAPER = "paper (another data set, another size)"
NOT_DISTINGUISHED = "not distinguished"
LEAST_SEEDS, LEAST_PEOPLE = 3, 5
"""Below these a report warns that its intervals are too narrow."""
WANTED_GAIN = 0.3
"""By which the last published step is to be below the first."""
NAMES = {
    REFLECTANCE: "reflectance",
    "diffuse_albedo": "albedo",
    "specular_albedo": "specular",
    "diffuse_normal": "diffuse normals",
    "specular_normal": "specular normals",
    SOURCE: "picture, source light",
    IN_TARGET: "picture, target light",
}
AT = {STEPS: "equal steps", TIME: "equal time"}
SCALE = 1e4
"""Mean squared errors are given in ten thousandths."""
SHEET_ROWS = 256
SHEET_TEXT_PX = 22
Key = tuple[int, str]


@dataclasses.dataclass(frozen=True)
class Setting:
    """The finished runs of one setting at one budget.

    Attributes:
        variant: the setting.
        runs: figures of each seed, those that diverged too.
    """

    variant: Variant
    runs: list[dict[str, Any]]

    @property
    def whole(self) -> list[dict[str, Any]]:
        """Runs that did not diverge."""
        return [run for run in self.runs if run["state"] != DIVERGED]

    def figures(self, name: str) -> dict[Key, float]:
        """A figure's mean over the lights, by seed and person."""
        return {
            (run["seed"], person["name"]): float(
                np.mean([light[name] for light in person["lights"].values()])
            )
            for run in self.whole
            for person in run["people"]
        }

    def spread(self, name: str) -> Interval:
        """A figure over seeds and people."""
        return interval(table(self.figures(name))[0])

    def median(self, name: str) -> float:
        """A run's own number, such as its seconds."""
        values = [run[name] for run in self.whole if run.get(name) is not None]
        return float(np.median(values)) if values else float("nan")


def settings_at(runs: Path, experiment: Experiment, budget: str, seeds: int) -> list[Setting]:
    """What is finished, setting by setting; those without a run are left out."""
    found = []
    for variant in experiment.variants:
        names = [run_name(variant.name, budget, seed) for seed in range(seeds)]
        there = [figures_of(runs / name) for name in names]
        own = [one for one in there if one is not None]
        if own:
            found.append(Setting(variant, own))
    return found


def figures_of(run: Path) -> dict[str, Any] | None:
    """A run's figures; None where it is not finished, or its file is damaged."""
    try:
        found: dict[str, Any] = read_json(run / FIGURES_FILE, FIGURES_SCHEMA)
    except LightstageError:
        return None
    return found if {"state", "seed"} <= found.keys() else None


def write_report(
    out: Path, runs: Path, experiment: Experiment, config: ExperimentConfig, notes: list[str]
) -> dict[str, Any]:
    """Write the report of what is finished.

    Args:
        out: the experiment's folder.
        runs: folder of the runs of one version of the code.
        experiment: the settings.
        config: its size.
        notes: further sentences.

    Returns:
        The content of report.json.
    """
    lines = [f"# {experiment.title}", ""]
    facts: dict[str, Any] = {"schema": SCHEMA, "title": experiment.title, "budgets": {}}
    for note in notes:
        lines += [note, ""]
    for budget in budgets(config, experiment):
        settings = settings_at(runs, experiment, budget, config.seeds)
        if not settings:
            continue
        sentences, numbers = _at(out, experiment, budget, settings)
        lines += [f"## At {AT[budget]}", "", *sentences]
        facts["budgets"][budget] = numbers
    if not facts["budgets"]:
        lines += ["No run is finished yet.", ""]
    sheet = _sheet(out, runs, experiment, config)
    if sheet:
        lines += ["## Albedos found", "", sheet, ""]
    write_text(out / REPORT, "\n".join(lines))
    write_json(out / FACTS, without_nan(facts))
    return facts


def _at(
    out: Path, experiment: Experiment, budget: str, settings: list[Setting]
) -> tuple[list[str], dict[str, Any]]:
    one = next((run for s in settings for run in s.whole), settings[0].runs[0])
    people = sorted({p["name"] for s in settings for run in s.whole for p in run["people"]})
    lights = len(one["people"][0]["lights"]) if "people" in one else 0
    lines = [
        f"{counted(len(people), 'person', 'people')} held out, {counted(lights, 'light')}, "
        f"{counted(max(len(s.runs) for s in settings), 'seed')}, textures of "
        f"{one['texture_rows']} rows, on {', '.join(sorted({str(_device(s)) for s in settings}))}. "
        "Mean squared errors in 1e-4 on a scale of 0 to 1, with 95 % intervals by bootstrap over "
        "seeds and people.",
        "",
    ]
    papers = any(s.variant.paper for s in settings)
    titles = ["setting", *([PAPER] if papers else []), *NAMES.values()]
    titles += ["steps", "training, s", "steps a second", "inference, s", "seeds", "diverged"]
    lines += _table_head(titles)
    for setting in settings:
        paper = setting.variant.paper
        cells = [setting.variant.title]
        cells += [f"{SCALE * paper:.0f}" if paper else ""] if papers else []
        cells += [_shown(setting.spread(name)) for name in NAMES]
        cells += [f"{setting.median(n):.3g}" for n in ("steps", "step_seconds", "steps_a_second")]
        cells += [f"{setting.median('infer_seconds'):.2g}", str(len(setting.runs))]
        cells.append(str(len(setting.runs) - len(setting.whole)))
        lines.append(_row(["" if cell == "nan" else cell for cell in cells]))
    lines.append("")
    pairs = [_compared(a, b) for a, b in _pairs(settings)]
    if pairs:
        lines += ["Each setting less the one that is named, on the same seeds and people:", ""]
        lines += _table_head(["setting", "less", *(NAMES[n] for n in _COMPARED), "seeds", "people"])
        for pair in pairs:
            cells = [pair["setting"], pair["less"]]
            cells += [_difference(pair[name]) for name in _COMPARED]
            lines.append(_row([*cells, str(pair["seeds"]), str(pair["people"])]))
        lines.append("")
    few = _too_few(max(len(s.whole) for s in settings), len(people))
    lines += [f"- {sentence}" for sentence in [*few, *_sentences(budget, settings)]]
    lines += [f"- {sentence}" for sentence in _tones(settings)] + [""]
    plot = f"{REFLECTANCE}-{budget}.svg"
    columns = [_column(setting) for setting in settings]
    title = f"{experiment.title}, at {AT[budget]}"
    draw(title, experiment.across, "mean squared error, 1e-4", columns, out / plot)
    lines += [f"![{title}]({plot})", ""]
    numbers = {
        "settings": [_numbers(setting) for setting in settings],
        "compared": [{**p, **{n: dataclasses.asdict(p[n]) for n in _COMPARED}} for p in pairs],
    }
    return lines, numbers


_COMPARED = (REFLECTANCE, "diffuse_albedo", SOURCE, IN_TARGET)


def _pairs(settings: list[Setting]) -> list[tuple[Setting, Setting]]:
    """Each setting behind the one that it names, where that is there, or behind its neighbour."""
    by_name = {setting.variant.name: setting for setting in settings}
    found = []
    for before, setting in itertools.pairwise(settings):
        against = setting.variant.against
        other = by_name.get(against) if against else before
        if other is not None:
            found.append((other, setting))
    return found


def _compared(one: Setting, other: Setting) -> dict[str, Any]:
    found: dict[str, Any] = {"setting": other.variant.title, "less": one.variant.title}
    for name in _COMPARED:
        found[name], found["seeds"], found["people"] = paired(
            one.figures(name), other.figures(name)
        )
    return found


def _too_few(seeds: int, people: int) -> list[str]:
    """What intervals over few seeds or people do not include."""
    sentences = []
    if seeds < LEAST_SEEDS:
        sentences.append(
            f"{counted(seeds, 'seed')}: the intervals hardly include what another seed would give, "
            "so that a difference which they distinguish from zero may be the seed's."
        )
    if people < LEAST_PEOPLE:
        named = counted(people, "person", "people")
        sentences.append(f"{named} held out: the intervals are too narrow for people in general.")
    return sentences


def _sentences(budget: str, settings: list[Setting]) -> list[str]:
    """The results that a reader of the paper looks for first, in words."""
    by_name = {setting.variant.name: setting for setting in settings}
    sentences = []
    first, last = by_name.get("four"), by_name.get(LAST_PUBLISHED)
    both = _on_common(first, last) if first is not None and last is not None else None
    if both is not None:
        gain = 1 - both[1] / both[0]
        less = f"{abs(100 * gain):.0f} % {'below' if gain >= 0 else 'above'}"
        wanted = "as expected" if gain >= WANTED_GAIN else "not as expected"
        sentences.append(
            f"On the same seeds and people the last published step is {less} the first "
            f"({100 * WANTED_GAIN:.0f} % or more below is expected): {wanted}."
        )
    modern = by_name.get(MODERN)
    if modern is not None and last is not None and modern.whole and last.whole:
        found, _, _ = paired(last.figures(REFLECTANCE), modern.figures(REFLECTANCE))
        where = "below" if found.mean < 0 else "above"
        sure = "" if found.distinguished else f", {NOT_DISTINGUISHED}"
        if math.isfinite(found.mean):  # not where they have no seed in common
            sentences.append(
                f"`modern` alone is {where} the last published step at {AT[budget]} by "
                f"{SCALE * abs(found.mean):.1f}{sure}."
            )
    for setting in settings:
        values, seeds, _ = table(setting.figures(REFLECTANCE))
        percent = over_seeds(values)
        if setting.variant.name == LAST_PUBLISHED and math.isfinite(percent):
            sentences.append(
                f"Over {len(seeds)} seeds the standard deviation of {setting.variant.title} is "
                f"{percent:.2f} % of its mean (the paper: 3.14 %, another data set, another size)."
            )
        diverged = len(setting.runs) - len(setting.whole)
        if diverged:
            sentences.append(
                f"{diverged} of {counted(len(setting.runs), 'seed')} of {setting.variant.title} "
                "diverged: the figures are of the others."
            )
    return sentences


def _on_common(one: Setting, other: Setting) -> tuple[float, float] | None:
    """Both settings' mean error on the seeds and people that both have; None without any."""
    first, second = one.figures(REFLECTANCE), other.figures(REFLECTANCE)
    common = sorted(first.keys() & second.keys())
    if not common:
        return None
    return float(np.mean([first[key] for key in common])), float(
        np.mean([second[key] for key in common])
    )


def _tones(settings: list[Setting]) -> list[str]:
    """Where settings leave tones out: the albedo's error on the lightest and the darkest person."""
    if not any(setting.variant.without for setting in settings):
        return []
    sentences = []
    for setting in settings:
        figures = setting.figures("diffuse_albedo")
        tones = {p["name"]: p["tone_deg"] for run in setting.whole for p in run["people"]}
        if len(tones) < 2:
            continue
        ends = {"lightest": max(tones, key=tones.__getitem__)}
        ends["darkest"] = min(tones, key=tones.__getitem__)
        errors = {
            word: SCALE * float(np.mean([v for (_, who), v in figures.items() if who == name]))
            for word, name in ends.items()
        }
        sentences.append(
            f"{setting.variant.title}: albedo's error on the lightest person held out "
            f"{errors['lightest']:.1f}, on the darkest {errors['darkest']:.1f}."
        )
    return sentences


def _numbers(setting: Setting) -> dict[str, Any]:
    return {
        "name": setting.variant.name,
        "title": setting.variant.title,
        "paper": setting.variant.paper,
        "seeds": len(setting.runs),
        "diverged": len(setting.runs) - len(setting.whole),
        **{name: dataclasses.asdict(setting.spread(name)) for name in FIGURES},
        **{n: setting.median(n) for n in ("steps", "step_seconds", "infer_seconds")},
    }


def _column(setting: Setting) -> Column:
    values, _, _ = table(setting.figures(REFLECTANCE))
    seeds = [SCALE * float(np.nanmean(row)) for row in values]
    whole = setting.spread(REFLECTANCE)
    scaled = Interval(SCALE * whole.mean, SCALE * whole.low, SCALE * whole.high)
    return Column(setting.variant.title, seeds, scaled)


def _device(setting: Setting) -> str:
    return ", ".join(sorted({str(run["device"]) for run in setting.runs}))


def _shown(found: Interval) -> str:
    if math.isnan(found.mean):
        return ""
    if math.isnan(found.low):
        return f"{SCALE * found.mean:.1f}"
    return f"{SCALE * found.mean:.1f} ({SCALE * found.low:.1f} to {SCALE * found.high:.1f})"


def _difference(found: Interval) -> str:
    if math.isnan(found.low):
        return _shown(found)
    return _shown(found) + ("" if found.distinguished else f", {NOT_DISTINGUISHED}")


def _table_head(titles: list[str]) -> list[str]:
    return [_row(titles), "|" + "---|" * len(titles)]


def _row(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _sheet(out: Path, runs: Path, experiment: Experiment, config: ExperimentConfig) -> str:
    """Write albedos found by the first seed: a column a setting, a row a person and light.

    Returns the Markdown that shows them; none where no run has pictures.
    """
    for budget in reversed(budgets(config, experiment)):
        named = [(v, runs / run_name(v.name, budget, 0)) for v in experiment.variants]
        there = [(v, run) for v, run in named if (run / picture_name(0, SHOWN[0])).is_file()]
        rows = []
        for person, light in itertools.product(range(SHOWN_PEOPLE), SHOWN):
            parts = [_thirds(run / picture_name(person, light)) for _, run in there]
            whole = [part for part in parts if part is not None]
            if whole and len(whole) == len(parts):
                found = [part[1] for part in whole]
                rows.append(np.concatenate([whole[0][0], *found, whole[0][2]], axis=1))
        if not rows:
            continue
        names = ["texture", *(v.title.replace("`", "") for v, _ in there), "truth"]
        picture = np.concatenate([_titles(names, rows[0].shape[1] // len(names)), *rows])
        write_png(out / SHEET, picture)
        return (
            f"The first seed, people held out, at {AT[budget]}, each in the target light and "
            f"in hard light from the side; `modern` sees the same textures.\n\n"
            f"![albedos found]({SHEET})"
        )
    return ""


def _thirds(path: Path) -> list[np.ndarray] | None:
    """Texture, albedo found and truth of a run's picture; None where it cannot be read."""
    # Fewer people may be held out than are shown; OpenCV warns of every file that is not there.
    image = cv2.imread(str(path)) if path.is_file() else None
    if image is None:
        return None
    high = SHEET_ROWS / len(image)
    wide = round(image.shape[1] / 3 * high)
    parts = np.split(image[:, : image.shape[1] // 3 * 3, ::-1], 3, axis=1)
    return [cv2.resize(np.ascontiguousarray(p), (wide, SHEET_ROWS)) for p in parts]


def _titles(names: list[str], width: int) -> np.ndarray:
    image = np.full((SHEET_TEXT_PX, width * len(names), 3), 255, np.uint8)
    for index, name in enumerate(names):
        scale = min(0.42, 0.42 * width / max(1, len(name) * 8))
        place = (index * width + 4, 15)
        cv2.putText(image, name, place, cv2.FONT_HERSHEY_SIMPLEX, scale, (0, 0, 0), 1, cv2.LINE_AA)
    return image
