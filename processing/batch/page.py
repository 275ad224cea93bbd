"""DIR/batch.html and DIR/batch.json: all sessions of a batch, and which to inspect first."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lightstage.counting import counted
from lightstage.formats.files import write_json
from processing.batch.drive import Item
from processing.batch.figures import FIGURES, numbers, standing_out
from processing.pipeline import STAGES
from processing.report import Link, Marked, Section, Table, write_report

PAGE, FACTS = "batch.html", "batch.json"
SCHEMA = "processing.batch/1"
FIRST = 10
"""Sessions that the page's first table names."""
Cell = str | float | int | Link | Marked


def write_page(out: Path, items: Sequence[Item], limit: float) -> list[dict[str, Any]]:
    """Write batch.html and batch.json.

    Args:
        out: the batch's folder, in which each session has a folder of its id.
        items: the sessions.
        limit: robust z from which a figure is an outlier.

    Returns:
        Each session's entry in batch.json.
    """
    rows = [numbers(item.facts) for item in items]
    apart = standing_out(rows)
    sessions = [
        {
            "session": item.order.session,
            "id": item.session_id,
            "subject": item.subject,
            "expression": item.expression,
            "state": item.state,
            "left": None if item.left is None else list(item.left),
            "reason": item.reason or None,
            "figures": {f.name: value for f, value in zip(FIGURES, row, strict=True)},
            "stands_out": {
                figure.name: round(float(z), 2)
                for figure, z in zip(FIGURES, far, strict=True)
                if z >= limit
            },
        }
        for item, row, far in zip(items, rows, apart, strict=True)
    ]
    write_json(out / FACTS, {"schema": SCHEMA, "stands_out_from_z": limit, "sessions": sessions})
    failed = [item for item in items if item.state == "failed"]
    sections = []
    if failed:
        table = Table(
            ("session", "folder", "why"),
            [(_report(out, item), item.order.session, item.reason) for item in failed],
        )
        sections.append(Section(f"{counted(len(failed), 'session')} failed", [table]))
    sections.append(Section("Inspect these first", _first(out, items, rows, apart, limit)))
    sections.append(Section("All sessions", [_all(out, items, rows, apart, limit)]))
    write_report(out / PAGE, f"Batch of {counted(len(items), 'session')}", sections)
    return sessions


def _report(out: Path, item: Item) -> str | Link:
    there = (out / item.session_id / "report.html").is_file()
    return Link(f"{item.session_id}/report.html", item.session_id) if there else item.session_id


def _first(
    out: Path,
    items: Sequence[Item],
    rows: Sequence[Sequence[float | None]],
    apart: np.ndarray,
    limit: float,
) -> list[str | Table]:
    """The sessions whose figures are farthest from the others'."""
    worst = apart.max(axis=1, initial=0)
    order = [int(i) for i in np.argsort(-worst, kind="stable") if worst[i] >= limit][:FIRST]
    if not order:
        return ["No figure of a session is far from the others'."]
    found: list[tuple[Cell, ...]] = []
    for index in order:
        parts = [
            f"{figure.name} {rows[index][column]:.4g} (z {apart[index, column]:.1f})"
            for column, figure in enumerate(FIGURES)
            if apart[index, column] >= limit
        ]
        item = items[index]
        found.append((_report(out, item), item.subject, item.expression, "; ".join(parts)))
    caption = (
        "The figures that are worse than the median of all sessions by at least "
        f"{limit:g} robust standard deviations (1.4826 times the median absolute deviation)."
    )
    return [Table(("session", "subject", "expression", "outliers"), found, caption)]


def _all(
    out: Path,
    items: Sequence[Item],
    rows: Sequence[Sequence[float | None]],
    apart: np.ndarray,
    limit: float,
) -> Table:
    header = ["session", "subject", "expression", "state", *(f"{stage}, s" for stage in STAGES)]
    header += [figure.name for figure in FIGURES]
    table: list[list[Cell]] = []
    for item, row, far in zip(items, rows, apart, strict=True):
        state: Cell = Marked("failed") if item.state == "failed" else item.state
        cells: list[Cell] = [_report(out, item), item.subject, item.expression, state]
        for stage in STAGES:
            seconds = item.facts.get(stage, {}).get("seconds")
            cells.append("" if seconds is None else float(seconds))
        for value, z in zip(row, far, strict=True):
            shown: Cell = "" if value is None else value
            cells.append(Marked(value) if value is not None and z >= limit else shown)
        table.append(cells)
    return Table(header, table, "Seconds of each stage; marked figures stand out of the others'.")
