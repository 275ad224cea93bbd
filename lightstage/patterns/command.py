"""`lightstage patterns`: what a sequence will light, in figures and as a picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from lightstage.commands import JsonFlag, finish, output_file
from lightstage.counting import counted
from lightstage.errors import PatternError
from lightstage.formats.png import write_png
from lightstage.patterns.drive import Drive, drive_levels, split_emitters
from lightstage.patterns.names import (
    MEANINGS,
    SEQUENCES,
    bank_mask,
    complement,
    has_coloured_lights,
    on_plane,
    sequence_patterns,
)
from lightstage.patterns.own import UserPattern, read_patterns
from lightstage.patterns.picture import pattern_sheet
from lightstage.patterns.weights import unevenness
from lightstage.rig import Rig, default_rig, load_rig
from lightstage.sequence import plan_shots

MOST_PICTURES = 600
"""Patterns that one sheet shows."""


def register(app: typer.Typer) -> None:
    """Add the command `patterns` to an application."""
    app.command("patterns")(patterns_command)


def patterns_command(
    sequence: str = typer.Argument("", help="Named sequence, or pattern names with commas."),
    rig: Path | None = typer.Option(None, help="rig.json; the default rig where absent."),
    drive: str = typer.Option("solid-angle", help="How lamps are driven: solid-angle or on-off."),
    emitters: str = typer.Option(
        "", help="Colours of the emitters that are driven, with commas [all]."
    ),
    patterns: Path | None = typer.Option(None, help="Your own patterns (TOML)."),
    out: Path | None = output_file(
        "--out", help="Picture of all of them, .png.", suffixes=[".png"], default=None, shared=True
    ),
    as_json: bool = JsonFlag,
) -> None:
    """List what each pattern lights, and draw it; with nothing given, list the sequences."""
    how = _drive(drive)
    the_rig = default_rig() if rig is None else load_rig(rig)
    own = {} if patterns is None else read_patterns(patterns, the_rig)
    if not sequence and out is None and not own:
        _list_sequences(the_rig, as_json)
        return
    sequence = sequence or ",".join(own) or "binary"
    colours = split_emitters(emitters)
    shots = plan_shots(sequence_patterns(sequence, the_rig), the_rig, how, own, colours)
    if out is not None and len(shots) > MOST_PICTURES:
        raise PatternError(
            f"sequence {sequence!r}",
            found=counted(len(shots), "pattern"),
            expected=f"at most {MOST_PICTURES} in one picture",
            hint="Name some of them with commas.",
        )
    planes = on_plane(the_rig)
    rows = [_row(s.pattern, s.levels, the_rig, planes) for s in shots]
    even = unevenness(the_rig, drive_levels("full", the_rig, how, emitters=colours))
    # One polarisation bank has half of the lamps: its field is less even than that of both.
    banks = {
        s.pattern: unevenness(the_rig, s.levels)
        for s in shots
        if s.pattern in SEQUENCES["polarised"]
    }
    lit_by_none = [s.pattern for s in shots if not s.levels.any()]
    unlit = [name for name in lit_by_none if name.partition("@")[0] != "dark"]
    facts: dict[str, Any] = {
        "sequence": sequence,
        "drive": how,
        "emitters": list(colours),
        "lights": len(the_rig.lights),
        "full_unevenness": round(even, 5),
        "bank_unevenness": {name: round(share, 5) for name, share in banks.items()},
        "unlit": unlit,
        "on_plane": planes,
        "patterns": rows,
        "own": {
            name: {"kind": p.kind, "said": p.summary, "scale": p.scale} for name, p in own.items()
        },
        "picture": None if out is None else str(out),
    }
    if not as_json:
        _show(rows, own)
        for axis, ids in planes.items():
            some = ", ".join(map(str, ids[:12])) + (" .." if len(ids) > 12 else "")
            lit = counted(len(ids), "lamp")
            print(f"On the plane {axis} = 0, half in each of a pair: {lit} ({some})")
        if unlit:
            print(f"No lamp is lit in {', '.join(unlit)}: such photographs are dark.")
        if any(s.pattern.startswith("mux-") for s in shots) and not has_coloured_lights(the_rig):
            print("These lamps are not red, green and blue: mux-1 and mux-2 hold one diagonal")
            print("gradient and its complement, not six. Take `binary` for normals.")
    if out is not None:
        title = f"{counted(len(the_rig.lights), 'lamp')}, driven {_words(how)}"
        write_png(out, pattern_sheet(the_rig, [(s.pattern, s.levels) for s in shots], title))
    drawn = "" if out is None else f", drawn in {out}"
    finish(
        f"{counted(len(shots), 'pattern')} on {counted(len(the_rig.lights), 'lamp')} driven "
        f"{_words(how)}; {_uneven(even, banks)}{drawn}",
        facts,
        as_json,
    )


def _drive(drive: str) -> Drive:
    for known in get_args(Drive):
        if drive == known:
            return known
    raise PatternError(
        "--drive", found=repr(drive), expected=" or ".join(map(str, get_args(Drive)))
    )


def _uneven(full: float, banks: dict[str, float]) -> str:
    """How uneven `full` is, and each bank's part of it in which a lamp is lit."""
    parts = [f", {name} by {100 * share:.2f} %" for name, share in banks.items() if share > 0]
    return f"full is uneven by {100 * full:.2f} %{''.join(parts)}"


def _words(drive: Drive) -> str:
    return "by solid angle" if drive == "solid-angle" else "on and off"


def _row(
    pattern: str, levels: np.ndarray, rig: Rig, planes: dict[str, list[int]]
) -> dict[str, Any]:
    """What one pattern lights, in figures."""
    base = pattern.partition("@")[0]
    axes = "xyz" if base.startswith("mux-") else base[-2:-1] if complement(base) else ""
    halved = {light_id for axis in axes for light_id in planes.get(axis, ())}
    left = bank_mask(pattern, rig) > 0
    split = sum(light.id in halved for light, lit in zip(rig.lights, left, strict=True) if lit)
    return {
        "pattern": pattern,
        "lit": int((levels > 0).sum()),
        "mean_level": round(float(levels.mean()), 5),
        "most_level": round(float(levels.max()), 5),
        "on_plane": split,
    }


def _show(rows: list[dict[str, Any]], own: dict[str, UserPattern]) -> None:
    table = Table(box=None, pad_edge=False)
    for head in ("pattern", "lit", "mean level", "highest", "on a plane"):
        table.add_column(head, justify="left" if head == "pattern" else "right")
    for row in rows:
        table.add_row(
            row["pattern"],
            str(row["lit"]),
            f"{row['mean_level']:.4f}",
            f"{row['most_level']:.4f}",
            str(row["on_plane"] or ""),
        )
    Console().print(table)
    shown = {row["pattern"].partition("@")[0] for row in rows}
    for mine in (pattern for name, pattern in own.items() if name in shown):
        print(f"{mine.name}, your own, by {mine.kind}: {mine.summary}")


def _list_sequences(rig: Rig, as_json: bool) -> None:
    counts = {name: len(sequence_patterns(name, rig)) for name in MEANINGS}
    if not as_json:
        table = Table(box=None, pad_edge=False)
        for head in ("sequence", "shots", "what for"):
            table.add_column(head, justify="right" if head == "shots" else "left")
        for name, meaning in MEANINGS.items():
            table.add_row(name, str(counts[name]), meaning)
        Console().print(table)
    finish(f"{len(counts)} named sequences", {"sequences": counts}, as_json)
