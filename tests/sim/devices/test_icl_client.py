"""ICL's own client, pylightstage's lscli, on our server: every command of it."""

from __future__ import annotations

import json
import subprocess
import sys
import venv
from pathlib import Path

import numpy as np
import pytest

from sim.devices.icl_server import IclServer
from tests.waiting import until

PACKAGE = "pylightstage==0.2.0"
INSTALL_S = 90
"""Where the package index does not give it in that time, there is none."""

CHILD = """
import contextlib, io, json, sys
from pylightstage import lscli

for line in sys.stdin:
    words, keys = json.loads(line)
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stderr(err), contextlib.redirect_stdout(out):
        answers = iter(keys)
        try:
            if keys:
                code = lscli.run(words, input_func=lambda prompt: next(answers))
            else:
                code = lscli.main(words)
        except SystemExit as error:
            code = error.code
    print(json.dumps([code, out.getvalue(), err.getvalue()]), flush=True)
"""
"""Runs one command of lscli after the other, as its entry point does; with keys, interactively."""

SEQUENCE = """
import sys
from pylightstage.sequences import SequenceBuilder

builder = SequenceBuilder("three frames", capture_hz=30.0)
for arc in range(3):
    builder.clear_lightstage().set_light(5, arc, "w", (255, 0, 128)).append_frame()
for path in sys.argv[1:]:
    builder.build().save(path)
"""


@pytest.fixture(scope="module")
def python(tmp_path_factory) -> Path:
    """An interpreter of an environment of its own, with lscli."""
    folder = tmp_path_factory.mktemp("client")
    venv.create(folder, with_pip=False)
    python = folder / "bin" / "python"
    words = [sys.executable, "-m", "pip", "--python", str(python), "install", "--quiet"]
    words += ["--retries", "0", "--timeout", "20", "--no-cache-dir", PACKAGE]
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=INSTALL_S)
    except subprocess.TimeoutExpired:
        pytest.skip(f"{PACKAGE} cannot be installed: no answer in {INSTALL_S} s")
    if done.returncode != 0:
        pytest.skip(f"{PACKAGE} cannot be installed: {done.stderr.strip().splitlines()[-1]}")
    return python


class Client:
    """lscli at a server."""

    def __init__(self, python: Path, server: IclServer) -> None:
        self.server = server
        self.child = subprocess.Popen(
            [str(python), "-c", CHILD],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip

    def __call__(self, *words: str, keys: tuple[str, ...] = ()) -> str:
        """What it prints; it must succeed."""
        code, out, err = self.run(*words, keys=keys)
        assert (code, err) == (0, ""), (words, err)
        return out

    def refused(self, *words: str) -> str:
        """What it says; it must fail."""
        code, out, err = self.run(*words)
        assert (code, out) == (1, ""), (words, out)
        return err

    def run(self, *words: str, keys: tuple[str, ...] = ()) -> tuple[int, str, str]:
        line = json.dumps([["--uri", self.server.url(), *words], keys])
        self.child.stdin.write(line + "\n")
        self.child.stdin.flush()
        return tuple(json.loads(self.child.stdout.readline()))

    @property
    def shines(self) -> np.ndarray:
        """(12, 14, 6) of the fixtures now."""
        return self.server.states[-1].counts.reshape(12, 14, 6)


@pytest.fixture
def client(python):
    with IclServer(lambda _: None, at_once=True) as server:
        client = Client(python, server)
        yield client
        client.child.stdin.close()
        client.child.wait()
    assert server.failure is None


RGB, WHITE = slice(0, 3), slice(3, 6)


def test_lights_are_set_and_cleared_one_by_one_by_arc_by_height_and_all(client):
    client("set-lightstage", "--color", "rgbw", "--intensity", "32", "32", "32")
    assert (client.shines == 32 * 257).all()
    assert client("get-mode") == '"Manual"\n'
    client("clear-lightstage", "--color", "w")
    assert (client.shines[..., RGB] == 32 * 257).all()
    assert not client.shines[..., WHITE].any()
    client("clear-lightstage")
    assert not client.shines.any()
    assert client.server.dark

    client(
        "set-light",
        "--arc",
        "0",
        "--light",
        "4",
        "--color",
        "rgb",
        "--intensity",
        "255",
        "0",
        "0.5",
    )
    assert client.shines[0, 4].tolist() == [65535, 0, 128, 0, 0, 0]
    assert np.count_nonzero(client.shines) == 2
    client("set-light", "--arc", "0", "--light", "4", "--color", "w", "--intensity", "1", "2", "3")
    assert client.shines[0, 4].tolist() == [65535, 0, 128, 257, 514, 771]
    client("clear-light", "--arc", "0", "--light", "4")

    client("set-arc", "--arc", "11", "--color", "w", "--intensity", "180", "120", "60")
    assert (client.shines[11, :, WHITE] == [180 * 257, 120 * 257, 60 * 257]).all()
    assert np.count_nonzero(client.shines) == 14 * 3
    client("clear-arc", "--arc", "11")

    client("set-horizontal-arc", "--light", "13")
    assert (client.shines[:, 13] == 65535).all()
    assert np.count_nonzero(client.shines) == 12 * 6
    client("clear-horizontal-arc", "--light", "13")
    assert not client.shines.any()


def test_polarised_lights_are_those_that_our_driver_drives_as_banks(client):
    from lightstage.leds.icl_lights import channel_emitters

    ours = channel_emitters((12, 14), "polarised").reshape(2, 12, 14, 12, 14, 6)
    client("clear-lightstage")  # else the animation stands still where it was
    for arc, light in ((0, 0), (0, 1), (1, 3), (5, 7), (6, 13), (11, 8)):
        for bank, name in enumerate(("pp", "cp")):
            where = ("--arc", str(arc), "--light", str(light), "--polarization", name)
            client("set-polarized-light", *where)
            assert (client.shines == 65535 * ours[bank, arc, light]).all()
            client("clear-polarized-light", *where)
            assert not client.shines.any()
    client("set-polarized-light", "--arc", "2", "--light", "3", "--intensity", "255", "255", "255")
    assert (client.shines[2, 3] == 65535).all()
    client("clear-polarized-light", "--arc", "2", "--light", "3")


def test_the_server_states_its_configuration_and_its_mode(client):
    assert client("get-mode") == '"Demo"\n'
    config = json.loads(client("get-config"))
    assert (config["num_arcs"], config["lights_per_arc"]) == (12, 14)
    assert (config["kinet_port"], config["refresh_rate_ms"]) == (6038, 33)


def test_modes_follow_each_other_and_a_trigger_needs_manual(client):
    assert "Manual trigger only available in manual mode" in client.refused("trigger")
    client("set-mode", "manual")
    client("trigger")
    until(lambda: client.server.stage.triggers == 1)
    client("set-mode", "demo")
    until(lambda: not client.server.dark and client.server.states[-1].counts.any())
    assert "exceeds maximum supported rate (30.3 Hz)" in client.refused(
        "set-mode", "olat", "--capture-hz", "31"
    )
    client("set-mode", "olat", "--capture-hz", "30.3")
    assert client("get-mode") == '"OLAT"\n'
    until(lambda: client.server.stage.triggers == 1 + 168)
    until(lambda: client.server.stage.mode == "Demo")
    lit = [state.counts for state in client.server.states if state.mode == "OLAT"]
    places = [int(np.flatnonzero(counts.any(axis=1))[0]) for counts in lit]
    assert places == list(range(168))
    assert all(
        (counts[place] == [0, 0, 0, 65535, 65535, 65535]).all()
        for counts, place in zip(lit, places, strict=True)
    )
    client("set-mode", "manual")


@pytest.mark.parametrize("suffix", [".cbor", ".cbor.zst"])
def test_sequences_are_uploaded_listed_played_and_deleted(client, python, tmp_path, suffix):
    path = tmp_path / f"three{suffix}"
    subprocess.run([str(python), "-c", SEQUENCE, str(path)], check=True)
    assert client("list-sequences") == "[]\n"
    message = json.loads(client("upload-sequence", str(path)))
    assert (message["name"], message["total_frames"], message["duration_secs"]) == (
        "three frames",
        3,
        0.1,
    )
    assert json.loads(client("list-sequences")) == [message]
    assert json.loads(client("get-sequence", message["id"])) == message
    client("set-mode", "playback", "--sequence-id", message["id"])
    until(lambda: client.server.stage.triggers == 3)
    until(lambda: client.server.stage.mode == "Demo")
    played = [state.counts for state in client.server.states if state.mode == "Playback"]
    for arc, counts in enumerate(played[:3]):
        assert counts[arc * 14 + 5].tolist() == [0, 0, 0, 65535, 0, 128 * 257]
        assert np.count_nonzero(counts) == 2
    client("delete-sequence", message["id"])
    assert "not found" in client.refused("get-sequence", message["id"])
    assert "not found" in client.refused("delete-sequence", message["id"])
    assert "not found" in client.refused("set-mode", "playback", "--sequence-id", message["id"])
    assert "ULID" in client.refused("get-sequence", "nonsense")


def test_the_interactive_console_goes_through_its_menus(client):
    text = client("interactive", "--no-color", keys=(
        "1", "3", "7", "rgbw", "255 128 0", "", "b",  # an arc
        "4", "2", "", "b",  # the mode
        "q",
    ))  # fmt: skip
    assert "Action completed" in text
    assert "Disconnected" in text
    assert (client.shines[7] == [65535, 128 * 257, 0] * 2).all()
