"""The command `retake`: single photographs of a session, finished or not, taken again."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import typer

from lightstage.capture.command import (
    Attended,
    IgnoreClock,
    clearing,
    require_one_rule,
    resume_with,
    take_session,
)
from lightstage.capture.config import read_config
from lightstage.capture.session_run import Order, config_of, unfinished
from lightstage.commands import ConsentsOption, JsonFlag
from lightstage.errors import ConfigError, FormatError, LightstageError, one_error
from lightstage.formats.consents import require_consents
from lightstage.leds.address import LEDS_HELP
from lightstage.rig import Rig
from lightstage.session import read_journal
from lightstage.session.opening import JOURNAL


def register(app: typer.Typer) -> None:
    """Add the command to an application."""
    app.command("retake")(retake_command)


def retake_command(
    session: Path = typer.Argument(help="Session folder."),
    pattern: str = typer.Argument(help="Whose photographs; several with commas."),
    camera: list[str] = typer.Argument(None, help="Cameras that take them; all where absent."),
    leds: str = typer.Option(..., help=LEDS_HELP),
    cameras: str = typer.Option("auto", help="A cameras file (TOML), or auto: by serial number."),
    clear: bool = typer.Option(False, "--clear", help="Clear owner and place on the cameras."),
    delete: bool = typer.Option(
        False, "--delete-from-cameras", help="Delete each photograph there once it is kept here."
    ),
    unattended: bool = typer.Option(False, "--unattended", help="Ask nobody; decide by rule."),
    attended: Attended = False,
    ignore_clock: IgnoreClock = False,
    consents: Path | None = ConsentsOption,
    config: Path | None = typer.Option(None, help="TOML with other values than the session's."),
    as_json: bool = JsonFlag,
) -> None:
    """Take photographs of a session again; the earlier takes stay on the disk.

    A session that is not finished is resumed and finished. What is interrupted is resumed with
    lightstage capture --resume.
    """
    require_one_rule(attended, unattended)
    rig, order = order_retake(session, pattern.split(","), camera or [])
    require_consents(consents, "capture", {order.subject: order.consent})
    own = config_of(session) if config is None else None
    settings = read_config(
        config, own, ignore_clock=ignore_clock, delete_from_cameras=delete or None
    )
    flags = {
        "--clear": clear, "--delete-from-cameras": delete, "--unattended": unattended,
        "--attended": attended, "--ignore-clock": ignore_clock,
    }  # fmt: skip
    again = resume_with(leds, cameras, config, flags)
    order = dataclasses.replace(order, resume_with=again)
    take_session(rig, order, clearing(settings, clear), leds, cameras, as_json)


def order_retake(root: Path, patterns: Sequence[str], cameras: Sequence[str]) -> tuple[Rig, Order]:
    """A session's rig, and the order to take these photographs again.

    Args:
        root: the session's folder.
        patterns: names.
        cameras: ids; all where there are none.

    Raises:
        FormatError: no session, a damaged one, or one whose photographs were not captured here.
        ConfigError: patterns or cameras that it does not have, all in one message.
    """
    if not (root / JOURNAL).is_file():
        raise FormatError(
            root,
            found="no journal" if root.is_dir() else "no such folder",
            expected="the folder of a session that was captured",
        )
    begin = read_journal(root / JOURNAL)[0]
    if "led_device" not in begin or not begin.get("levels"):
        raise FormatError(
            root,
            found="photographs that were imported",
            expected="a session that was captured",
            hint="Take them again where they were taken, and import them again.",
        )
    problems: list[LightstageError] = []
    for what, names, known in (
        ("pattern", patterns, begin["sequence"]),
        ("camera", cameras, begin["cameras"]),
    ):
        problems += [
            ConfigError(
                f"{what} {name!r}",
                found=f"none in {root}",
                expected=", ".join(known),
                hint="Patterns have commas between them, cameras after them have blanks: "
                "x+,x- cam0 cam1.",
            )
            for name in names
            if name not in known
        ]
    if problems:
        raise one_error(problems)
    rig, order = unfinished(root)
    wanted = tuple(dict.fromkeys((p, c) for p in patterns for c in cameras or begin["cameras"]))
    return rig, dataclasses.replace(order, retake=wanted)
