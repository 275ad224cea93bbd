"""The command `capture`: a session, begun or resumed."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, cast, get_args

import typer

from lightstage.calibrations.stale import use_calibrations
from lightstage.cameras.binding import CamerasFile, read_cameras_file
from lightstage.capture.config import CaptureConfig, read_config
from lightstage.capture.session_run import (
    Order,
    capture_session,
    config_of,
    unfinished,
)
from lightstage.capture.stage import Stage, open_stage
from lightstage.commands import ConsentsOption, JsonFlag, finish, output_folder
from lightstage.commands.outputs import try_folder
from lightstage.counting import counted
from lightstage.day import next_open, read_plan
from lightstage.errors import ConfigError, FormatError, LightstageError, PatternError, one_error
from lightstage.findings import accepted_in_words
from lightstage.formats.access import group_of, limited_access
from lightstage.formats.consents import require_consents
from lightstage.leds.address import LEDS_HELP, worst_answer_s
from lightstage.operator import open_operator
from lightstage.patterns import Drive, read_patterns, sequence_patterns, split_emitters
from lightstage.preflight import consent_findings, measured_rig_findings, require_known
from lightstage.rig import Rig, load_rig
from lightstage.safety import check_shots, photosensitivity_findings
from lightstage.sequence import plan_shots
from lightstage.session import (
    Carried,
    check_consent,
    check_pseudonym,
    last_run,
    read_calibration,
    read_journal,
    require_new,
    whole_session,
)
from lightstage.session.opening import JOURNAL

SUBJECT = "subject-1"
EXPRESSION = "neutral"
SEQUENCE = "binary"
IgnoreClock = Annotated[
    bool,
    typer.Option(
        "--ignore-clock",
        help="This computer's clock is right, though a journal beside the session is of the "
        "future: warn alone.",
    ),
]
Attended = Annotated[
    bool,
    typer.Option(
        "--attended",
        help="Somebody answers elsewhere (lightstage console, watch --do): without a terminal, "
        "questions wait, dark, instead of being decided by rule.",
    ),
]


def register(app: typer.Typer) -> None:
    """Add the command to an application."""
    app.command("capture")(capture_command)


def clearing(config: CaptureConfig, clear: bool) -> CaptureConfig:
    """The same, with owner and place cleared on the cameras where somebody wants that."""
    if not clear:
        return config
    return dataclasses.replace(config, preflight=dataclasses.replace(config.preflight, clear=True))


def capture_command(
    out: Path | None = output_folder(
        "--out", help="The session's folder: new, or with --resume.", default=None
    ),
    rig: Path | None = typer.Option(
        None, "--rig", help="rig.json: the places of lamps and cameras."
    ),
    sequence: str | None = typer.Option(
        None, help="Named sequence, or pattern names with commas (binary)."
    ),
    leds: str = typer.Option(..., help=LEDS_HELP),
    cameras: str = typer.Option("auto", help="A cameras file (TOML), or auto: by serial number."),
    resume: bool = typer.Option(False, "--resume", help="Resume the session in --out."),
    subject: str | None = typer.Option(None, help="Pseudonym, such as P07 (subject-1)."),
    expression: str | None = typer.Option(None, help="Such as neutral, the default."),
    consent: str | None = typer.Option(
        None, help="Id of the record of the person's consent; without it there is a warning."
    ),
    consents: Path | None = ConsentsOption,
    patterns: Path | None = typer.Option(None, help="Your own patterns (TOML)."),
    drive: str | None = typer.Option(None, help="solid-angle (the default) or on-off."),
    emitters: str | None = typer.Option(
        None, help="Colours of the emitters that are driven, with commas [all]."
    ),
    colour: Path | None = typer.Option(
        None, help="A calibration folder, or a colour calibration alone, for the session to carry."
    ),
    calibration: Path | None = typer.Option(
        None, help="The lab's folder of calibration shots; stale ones are refused."
    ),
    allow_stale: list[str] = typer.Option(
        [], help="A kind of calibration shots that may be missing or stale; may be repeated."
    ),
    clear: bool = typer.Option(False, "--clear", help="Clear owner and place on the cameras."),
    ignore_clock: IgnoreClock = False,
    delete: bool = typer.Option(
        False, "--delete-from-cameras", help="Delete each photograph there once it is kept here."
    ),
    unattended: bool = typer.Option(False, "--unattended", help="Ask nobody; decide by rule."),
    attended: Attended = False,
    plan: Path | None = typer.Option(
        None, help="The plan of a day (TOML): take its next open session, in its own folder."
    ),
    take: str | None = typer.Option(
        None, help="With --plan: SUBJECT/EXPRESSION, instead of the next open one."
    ),
    config: Path | None = typer.Option(
        None,
        help="TOML with other values than the defaults.",
    ),
    as_json: bool = JsonFlag,
) -> None:
    """Light, photograph and verify every pattern; lights end dark whatever happens."""
    require_one_rule(attended, unattended)
    if plan is not None:
        ours = {
            "--out": out, "--resume": resume or None, "--sequence": sequence,
            "--subject": subject, "--expression": expression, "--consent": consent,
        }  # fmt: skip
        _require_none(ours, "--plan: the plan has it")
        planned = next_open(read_plan(plan), plan, take)
        out, resume = planned.folder, planned.stand == "begun"
        if resume:  # its folder keeps what it began with
            rig = patterns = colour = drive = emitters = None
        else:
            subject, expression = planned.take.subject, planned.take.expression
            sequence, consent = planned.take.sequence, planned.take.consent
        try_folder("--plan", out)
    elif take is not None:
        raise ConfigError("--take", found=repr(take), expected="--plan beside it")
    if allow_stale and calibration is None:
        given = ", ".join(map(repr, allow_stale))
        raise ConfigError("--allow-stale", found=given, expected="--calibration beside it")
    if out is None:
        raise ConfigError(
            "--out", found="nothing", expected="the session's folder, or --plan with a day's plan"
        )
    if resume:
        _require_begun(out)
    own = config_of(out) if resume and config is None else None
    settings = read_config(
        config,
        own,
        ignore_clock=ignore_clock,
        drive=_drive(drive),
        emitters=None if emitters is None else split_emitters(emitters),
        delete_from_cameras=delete or None,
    )
    settings = clearing(settings, clear)
    if resume:
        fixed = {
            "--rig": rig, "--sequence": sequence, "--subject": subject, "--consent": consent,
            "--expression": expression, "--patterns": patterns, "--drive": drive,
            "--emitters": emitters, "--colour": colour,
        }  # fmt: skip
        _require_none(fixed, "--resume: the session has it")
        with limited_access(group_of([out])):
            whole = whole_session(out)
        if whole is not None:
            frames, written = whole
            did = f"{' and '.join(written)} written again; " if written else ""
            read = f"{counted(frames, 'photograph')} read back"
            summary = f"{out}: finished and whole, {read}; {did}nothing is left to do"
            facts = {"session": str(out), "frames": frames, "taken": 0, "written": written}
            finish(summary, facts, as_json)
            return
        the_rig, order = unfinished(out)
    else:
        try:
            the_rig, order = _new_order(
                out, rig, _default(sequence, SEQUENCE), _default(subject, SUBJECT),
                _default(expression, EXPRESSION),
                consent, patterns, colour, settings,
            )  # fmt: skip
        except PatternError as error:
            raise error if plan is None else PatternError(f"{plan}, sequence: {error}") from None

    require_consents(consents, "capture", {order.subject: order.consent})

    def calibrated(order: Order, stage: Stage) -> Order:
        if calibration is None:
            return order
        return _with_calibration(order, stage, calibration, allow_stale, settings)

    flags = {
        "--clear": clear, "--delete-from-cameras": delete, "--unattended": unattended,
        "--attended": attended, "--ignore-clock": ignore_clock,
    }  # fmt: skip
    again = resume_with(leds, cameras, config, flags)
    order = dataclasses.replace(order, resume_with=again)
    take_session(the_rig, order, settings, leds, cameras, as_json, calibrated)


def take_session(
    rig: Rig,
    order: Order,
    settings: CaptureConfig,
    leds: str,
    cameras: str,
    as_json: bool,
    calibrated: Callable[[Order, Stage], Order] | None = None,
) -> None:
    """Open the devices, take what is ordered, and end the command with its line of facts.

    Args:
        rig: the stage.
        order: what is to be taken.
        settings: configuration of the capture.
        leds: the LED device's URL.
        cameras: path of a cameras file, or ``auto``.
        as_json: whether the facts are printed as JSON.
        calibrated: the order that is right when the devices are known.

    Raises:
        LightstageError: as open_stage and capture_session.
    """
    require_known(order.subject, settings.session)
    findings = [*consent_findings(order.consent, settings.session), *measured_rig_findings(rig)]
    order = dataclasses.replace(order, findings=findings)
    worst_s = settings.worst_shot_s(worst_answer_s(leds))
    check_shots(order.shots, rig, settings.safety, worst_s)
    file = CamerasFile() if cameras == "auto" else read_cameras_file(Path(cameras))
    # What is added to a session stays as private as the session is.
    group = group_of([order.root]) if order.resume else settings.session.group
    ask = "--unattended" not in order.resume_with
    elsewhere = "--attended" in order.resume_with
    with (
        limited_access(group),
        open_stage(rig, leds, file, settings) as stage,
        open_operator(order.root, settings.operator, ask=ask, elsewhere=elsewhere) as operator,
    ):
        order = order if calibrated is None else calibrated(order, stage)
        report = capture_session(stage, order, settings, operator)
    accepted = accepted_in_words(report.accepted, report.accepted_findings)
    codes = f" ({', '.join(_warned(order.root))})" if report.warnings else ""
    finish(
        f"{order.root}: {counted(report.frames, 'photograph')}, {report.taken} taken now "
        f"in {report.seconds:.1f} s, overhead {report.overhead_s:.2f} s, "
        f"{report.retakes} retaken, {accepted and accepted + ', '}"
        f"{counted(report.warnings, 'warning')} while it ran{codes}, "
        f"largest trigger skew {1e3 * report.max_skew_s:.2f} ms",
        {
            "session": str(order.root),
            "consent": order.consent,
            **dataclasses.asdict(report),
            "safety": dataclasses.asdict(settings.safety),
            "photosensitivity": [
                str(each) for each in photosensitivity_findings(order.shots, settings.safety)
            ],
        },
        as_json,
    )


def _warned(root: Path) -> list[str]:
    """Of what a session's last run warned, by its code in the journal."""
    lines = last_run(read_journal(root / JOURNAL))
    warned = [each for each in lines if each.get("severity") == "warn"]
    return list(dict.fromkeys(str(each["code"]) for each in warned))


def _new_order(
    out: Path,
    rig: Path | None,
    sequence: str,
    subject: str,
    expression: str,
    consent: str | None,
    patterns: Path | None,
    colour: Path | None,
    config: CaptureConfig,
) -> tuple[Rig, Order]:
    """A new session's rig and order; everything is checked before a device is opened."""
    if rig is None:
        raise ConfigError(
            "--rig",
            found="nothing",
            expected="the stage's rig.json, or --resume",
            hint="The default stage's is lightstage/data/rig.json; the simulated stage prints "
            "where its own is.",
        )
    check_pseudonym(subject, "subject")
    check_pseudonym(expression, "expression")
    if consent is not None:
        check_consent(consent)
    require_new(out)
    the_rig = load_rig(rig)
    own = {} if patterns is None else read_patterns(patterns, the_rig)
    shots = plan_shots(
        sequence_patterns(sequence, the_rig), the_rig, config.drive, own, config.emitters
    )
    own_calibration = Carried() if colour is None else read_calibration(colour, the_rig)
    return the_rig, Order(
        out, shots, subject=subject, expression=expression, consent=consent,
        colour=own_calibration.colour, beside=own_calibration.beside,
    )  # fmt: skip


def _with_calibration(
    order: Order, stage: Stage, lab: Path, allow_stale: list[str], config: CaptureConfig
) -> Order:
    used = use_calibrations(
        lab, stage.rig, stage.summaries, stage.lights.hello, allow_stale, config.calibration
    )
    facts = {**order.facts, "calibration_shots": used.facts}
    return dataclasses.replace(order, facts=facts, findings=[*order.findings, *used.findings])


def resume_with(
    leds: str, cameras: str, config: Path | None, flags: Mapping[str, bool]
) -> list[str]:
    """What a later --resume needs; files by their whole paths, so that it works from anywhere."""
    file = cameras if cameras == "auto" else str(Path(cameras).absolute())
    given = [] if config is None else ["--config", str(config.absolute())]
    return ["--leds", leds, "--cameras", file, *given, *(name for name, on in flags.items() if on)]


def _require_begun(out: Path) -> None:
    """FormatError where there is nothing to resume."""
    if not (out / JOURNAL).exists():
        raise FormatError(
            out,
            found="no journal" if out.is_dir() else "no such folder",
            expected="a session that was begun",
            hint="There is nothing to resume: start without --resume.",
        )


def _default(given: str | None, default: str) -> str:
    """What is not given; an empty text is given, and refused later."""
    return default if given is None else given


def _drive(text: str | None) -> Drive | None:
    if text is None:
        return None
    for drive in get_args(Drive):
        if text == drive:
            return cast(Drive, drive)
    raise ConfigError("--drive", found=repr(text), expected="solid-angle or on-off")


def require_one_rule(attended: bool, unattended: bool) -> None:
    """ConfigError where somebody is to be asked and nobody is."""
    if attended and unattended:
        raise ConfigError("--attended", found="--unattended beside it", expected="one of the two")


def _require_none(fixed: dict[str, Any], beside: str) -> None:
    """What a session or a plan has cannot be given again."""
    problems: list[LightstageError] = [
        ConfigError(name, found=str(value), expected=f"nothing beside {beside}")
        for name, value in fixed.items()
        if value is not None
    ]
    if problems:
        raise one_error(problems)
