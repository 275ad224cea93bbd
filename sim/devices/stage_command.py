"""Commands `stage` and `calibrate`: devices that stand ready, for `lightstage` by hand."""

from __future__ import annotations

import shlex
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TextIO

import typer

from lightstage.commands import output_file, output_folder, progress_bar
from sim.errors import SimError

POLL_S = 0.2
LEAST_ROWS = 96
"""Of a person's textures."""
RESUME = "  To resume: "
SCALE = 0.12
"""Scale of `stage` and `calibrate` alike, since calibration shots hold for one rig.json alone. At
half of it a marker of the ChArUco board is 12 pixels wide, which is too few to be read."""
RewiredOption = typer.Option(
    None, min=0, help="Wire the lamps by chance of this seed, in another order than the rig's."
)
ScaleOption = typer.Option(SCALE, min=0.005, max=1.0, help="Share of the rig's pixels a side.")


def add_stage_commands(app: typer.Typer) -> None:
    """Add the commands to an application."""
    app.command("stage")(stage)
    app.command("calibrate")(calibrate)


def stage(
    subject: str = typer.Option("P1", help="As in `session`."),
    sequence: str = typer.Option("binary", help="What will be shot; others may be shot too."),
    seed: int = typer.Option(0, min=0, help="Of the person and the noise."),
    scale: float = ScaleOption,
    rig: Path | None = typer.Option(None, help="rig.json; the default rig where absent."),
    rewired: int | None = RewiredOption,
    faults: Path | None = typer.Option(None, help="What goes wrong (TOML, docs/faults.md)."),
    landmarks: Path | None = output_file(
        "--landmarks",
        help="The landmarks as someone would click them, for SESSION/landmarks.json.",
        suffixes=[".json"],
        default=None,
    ),
) -> None:
    """Keep a simulated stage ready until Ctrl-C, and print how to capture it."""
    from lightstage.formats.landmarks import LANDMARKS
    from lightstage.patterns import sequence_patterns
    from lightstage.rig import default_rig, load_rig
    from lightstage.sequence import plan_shots
    from sim.devices.faults import FaultLog, Story
    from sim.devices.photographer import lab_white
    from sim.devices.standing_stage import standing_stage
    from sim.devices.wiring import shuffled_wires
    from sim.light.world import World
    from sim.people.subjects import check_subject, load_subject
    from sim.session import SessionConfig, write_landmarks

    config = SessionConfig()
    check_subject(subject)
    story = Story() if faults is None else Story.read(faults)
    where = (default_rig() if rig is None else load_rig(rig)).scaled(scale)
    patterns = sequence_patterns(sequence, where)
    plan_shots(patterns, where)  # an unknown pattern is refused before a person is made
    story.check_cameras([camera.id for camera in where.cameras], "--faults")
    # Finer texels than a third of a pixel show in no photograph.
    seen_rows = 3 * max(camera.height_px for camera in where.cameras)
    person = load_subject(subject, seed, None, min(config.texture_rows, max(seen_rows, LEAST_ROWS)))
    with progress_bar("shadow rays, cameras") as progress:
        world = World(person, where, progress)
    if landmarks is not None:
        write_landmarks(world, landmarks, seed, config.click_noise_px)
    with tempfile.TemporaryDirectory(prefix="lightstage-stage-") as name:
        desk = Path(name)
        log = FaultLog(None if faults is None else faults.with_suffix(".jsonl").absolute())
        wires = None if rewired is None else shuffled_wires(where, rewired)
        devices = standing_stage(
            world, desk, seed, patterns, None, story, log, lab_white(where), wires
        )
        with devices as standing:
            command = [*standing.command(Path("SESSION")), "--sequence", sequence]
            print(f"Ready; Ctrl-C ends it. In another terminal:\n\n{_in_lines(command)}\n")
            if landmarks is not None:
                to = shlex.quote(f"SESSION/{LANDMARKS}")
                print(f"Afterwards, for `register`: cp {shlex.quote(str(landmarks))} {to}\n")
            if log.path is not None:
                print("What goes wrong is logged in", log.path)
            sys.stdout.flush()
            try:
                while standing.device.failure is None:
                    time.sleep(POLL_S)
            except KeyboardInterrupt:
                return
            raise SimError("LED device", found=str(standing.device.failure)) from None


def _in_lines(words: Sequence[str]) -> str:
    """A command of `lightstage` for a shell, each option on a line of its own."""
    lines = ["lightstage"]
    for word in words:
        begins = word.startswith("--")
        lines = (
            [*lines, shlex.quote(word)]
            if begins
            else [*lines[:-1], f"{lines[-1]} {shlex.quote(word)}"]
        )
    return " \\\n    ".join(lines)


def calibrate(
    kind: str = typer.Argument(help="charuco, mirror, grey, chart, dark or flat."),
    out: Path = output_folder("--out", help="The lab's folder of calibration shots.", shared=True),
    seed: int = typer.Option(0, min=0, help="Of poses, lenses and noise."),
    scale: float = ScaleOption,
    rig: Path | None = typer.Option(None, help="rig.json; the default rig where absent."),
    rewired: int | None = RewiredOption,
) -> None:
    """Let `lightstage calibrate` take a simulated target, held pose by pose as it asks."""
    from lightstage.calibrations.config import require_kind
    from lightstage.rig import default_rig, load_rig
    from sim.devices.target_stage import TargetStage
    from sim.devices.wiring import shuffled_wires

    require_kind(kind, "kind")
    where = (default_rig() if rig is None else load_rig(rig)).scaled(scale)
    wires = None if rewired is None else shuffled_wires(where, rewired)
    with (
        tempfile.TemporaryDirectory(prefix="lightstage-stage-") as name,
        TargetStage(Path(name), where, kind, seed, None, wires) as standing,
    ):
        done = standing.calibrate(out, kind, echo=Echo(sys.stderr))
    print(done.stdout, end="")
    if done.returncode != 0:
        # The command has reported the fault itself.
        helps = _what_may_help(done.stderr)
        print(
            f"The simulated devices are gone: begin again with this command{helps}.",
            file=sys.stderr,
        )
        raise typer.Exit(done.returncode)


def _what_may_help(message: str) -> str:
    """What to do otherwise, by what failed; empty where nothing is known."""
    if "no answer to" in message:
        return ", when this computer is less busy or at a smaller --scale: the lamps were too slow"
    if "was not usable in" in message:
        return ", at a larger --scale if the target is too small in the pictures"
    return ""


class Echo:
    """What a command prints, letter by letter, without the line that resumes with its devices.

    Args:
        file: to write to.
    """

    def __init__(self, file: TextIO) -> None:
        self._file = file
        self._line = ""
        self._shown = 0

    def __call__(self, text: str) -> None:
        """Print more."""
        for letter in text:
            self._line += letter
            if not (RESUME.startswith(self._line) or self._line.startswith(RESUME)):
                self._file.write(self._line[self._shown :])
                self._shown = len(self._line)
            if letter == "\n":
                self._line, self._shown = "", 0
        self._file.flush()
