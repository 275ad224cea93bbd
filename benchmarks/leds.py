"""What a light costs on each controller, beside the plain carrying of the same bytes.

Peer, in the same run: the same number of bytes sent over the same kind of line and echoed, without
framing (for the controllers without an answer: sent, and the far end's word that they came). And
how long a killed capture's lights stay on.
"""

from __future__ import annotations

import binascii
import hashlib
import os
import select
import signal
import socket
import statistics
import struct
import subprocess
import sys
import tempfile
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import serial
from cobs import cobs

from benchmarks.record import record
from lightstage.leds.address import parse_url
from lightstage.leds.opening import open_leds
from lightstage.rig import default_rig, save_rig
from sim.devices.adalight_device import AdalightDevice
from sim.devices.led_device import EndDevice, LedDevice
from sim.devices.sacn_device import SacnDevice

LIGHTS = 168
FRAMES = 1500
KILLS = 15
ROOT = Path(__file__).parents[1]

FAR_END = """
import sys
from benchmarks.leds import answer, far_end
if sys.argv[1] in ("pty", "socket"):
    answer(sys.argv[1])
else:
    with far_end(sys.argv[1]) as device:
        print(device.path, flush=True)
        sys.stdin.read()
        print(len(device.states) - 1, flush=True)
"""

ECHO = """
import os, socket, sys, tty
if sys.argv[1] == "pty":
    master, slave = os.openpty()
    tty.setraw(slave)
    print(os.ttyname(slave), flush=True)
    while True:
        os.write(master, os.read(master, 65536))
kind = socket.SOCK_STREAM if sys.argv[1] == "socket" else socket.SOCK_DGRAM
end = socket.socket(socket.AF_INET, kind)
end.bind(("127.0.0.1", 0))
if sys.argv[1] == "socket":
    end.listen()
print("127.0.0.1:%d" % end.getsockname()[1], flush=True)
if sys.argv[1] == "socket":
    end, _ = end.accept()
    end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    while data := end.recv(65536):
        end.sendall(data)
    sys.exit()
while True:
    data, host = end.recvfrom(65536)
    end.sendto(data, host)
"""

CAPTURE = """
import sys, time
from pathlib import Path
import numpy as np
from lightstage.leds.opening import open_leds
from lightstage.rig import load_rig
from lightstage.safety import SafeLights, SafetyConfig
rig = load_rig(Path(sys.argv[2]))
with open_leds(sys.argv[1], len(rig.lights)) as leds:
    with SafeLights(leds, SafetyConfig(), rig) as lights:
        lights.light(np.ones(len(rig.lights)))
        print("lit", flush=True)
        time.sleep(60)
"""


def far_end(kind: str) -> EndDevice:
    """A simulated device of 168 lights."""
    if kind == "adalight":
        return AdalightDevice(LIGHTS, lambda _: None)
    if kind == "sacn":
        return SacnDevice(LIGHTS, lambda _: None)
    return LedDevice(LIGHTS, lambda _: None, over="socket" if kind == "socket" else "pty")


def answer(line: str) -> None:
    """A device that answers as in docs/led_wire.md, with as little work as may be."""
    if line == "pty":
        handle, slave = os.openpty()
        tty.setraw(slave)
        print(os.ttyname(slave), flush=True)
    else:
        listener = socket.create_server(("127.0.0.1", 0))
        print(f"127.0.0.1:{listener.getsockname()[1]}", flush=True)
        host, _ = listener.accept()
        host.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        handle = host.fileno()
    pending, counts, sets = b"", b"\0" * (2 * LIGHTS), 0
    while select.select([handle, sys.stdin], [], [])[0] != [sys.stdin]:
        *frames, pending = (pending + os.read(handle, 65536)).split(b"\0")
        for frame in frames:
            packet = cobs.decode(frame)
            reply, payload = b"\x20", b""
            if packet[1] == 0x01:
                reply, payload = b"\x02", struct.pack("<IH", 1, LIGHTS) + b"bench"
            else:
                counts = packet[6:-2] if packet[1] == 0x10 else counts
                sets += packet[1] == 0x10
                payload = hashlib.sha256(counts).digest()
            body = b"\x01" + reply + packet[2:4] + payload
            body += struct.pack("<H", binascii.crc_hqx(body, 0xFFFF))
            os.write(handle, cobs.encode(body) + b"\0")
        if not pending and not frames:
            break  # the host has closed its socket
    print(sets, flush=True)


@contextmanager
def process(script: str, *words: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A Python process that prints one line first."""
    child = subprocess.Popen(
        [sys.executable, "-c", script, *words],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )
    assert child.stdout is not None
    try:
        yield child, child.stdout.readline().strip()
    finally:
        child.kill()
        child.wait()


def milliseconds(action: Callable[[int], None], count: int) -> np.ndarray:
    """(count,) ms that each call took."""
    took = np.empty(count)
    for index in range(count):
        begun = time.perf_counter()
        action(index)
        took[index] = 1e3 * (time.perf_counter() - begun)
    return took


def echo_ms(line: str, size: int) -> np.ndarray:
    """Milliseconds that `size` bytes take there and back, nothing else done to them."""
    data = np.random.default_rng(0).bytes(size)
    with process(ECHO, line) as (_, place):
        if line == "pty":
            with serial.Serial(place, timeout=5) as port:
                tty.setraw(port.fileno())

                def there_and_back(_: int) -> None:
                    port.write(data)
                    assert port.read(size) == data

                return milliseconds(there_and_back, FRAMES)
        host, number = place.split(":")
        kind = socket.SOCK_DGRAM if line == "udp" else socket.SOCK_STREAM
        with socket.socket(socket.AF_INET, kind) as end:
            end.connect((host, int(number)))
            if line == "socket":
                end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

            def round_trip(_: int) -> None:
                end.sendall(data)
                left = size
                while left:
                    left -= len(end.recv(65536))

            return milliseconds(round_trip, FRAMES)


def light_ms(kind: str) -> tuple[np.ndarray, int]:
    """Milliseconds of each `light` of random levels, and how many states were never shown."""
    states = np.random.default_rng(0).integers(0, 256, (FRAMES, LIGHTS)) / 255
    options = {"adalight": "attempts=1&settle_s=0", "sacn": "attempts=1&settle_s=0"}
    with process(FAR_END, kind) as (child, place):
        url = f"{kind}://{place}?{options.get(kind, 'timeout_s=5')}"
        wrong = 0
        with open_leds(parse_url(url), LIGHTS) as leds:

            def light(index: int) -> None:
                nonlocal wrong
                wrong += not np.allclose(leds.light(states[index]), states[index], atol=1e-4)

            took = milliseconds(light, FRAMES)
            time.sleep(0.2)
            assert child.stdin is not None
            assert child.stdout is not None
            child.stdin.close()
            shown = int(child.stdout.readline())
        return took, wrong + FRAMES - shown


def wire_rows() -> list[list[object]]:
    """Latency of a plain echo and of a light, on each line."""
    rows: list[list[object]] = []
    for kind, line, size, what in (
        ("pty", "pty", 2 * LIGHTS + 11, "ours, terminal: SET, CRC, LIT with its hash"),
        ("socket", "socket", 2 * LIGHTS + 11, "ours, TCP: SET, CRC, LIT with its hash"),
        ("adalight", "pty", 3 * LIGHTS + 6, "Adalight, terminal: sent, no answer"),
        ("sacn", "udp", 638, "E1.31, UDP: sent, no answer"),
    ):
        echoed = echo_ms(line, size)
        lit, wrong = light_ms(kind)
        for name, took, bad in (
            (f"plain echo of {size} bytes, {line}", echoed, 0),
            (what, lit, wrong),
        ):
            rows.append(
                [
                    name,
                    f"{1e3 / took.mean():.0f}",
                    f"{np.median(took):.3f}",
                    f"{np.percentile(took, 99):.3f}",
                    bad,
                    f"{np.median(took) / np.median(echoed):.2f}",
                ]
            )
    return rows


def killed_rows(desk: Path) -> list[list[object]]:
    """Milliseconds from SIGKILL of a capture until its lights were dark, on each controller."""
    rig = save_rig(default_rig(), desk / "rig.json")
    rows: list[list[object]] = []
    for kind in ("pty", "socket", "adalight", "sacn"):
        took_ms, left_on = [], 0
        for _ in range(KILLS):
            with (
                far_end(kind) as device,
                process(CAPTURE, _url(kind, device), str(rig)) as (
                    child,
                    state,
                ),
            ):
                assert state == "lit"
                while device.dark:
                    time.sleep(0.001)
                killed_s = time.monotonic()
                os.kill(child.pid, signal.SIGKILL)
                while not device.dark and time.monotonic() < killed_s + 10:
                    time.sleep(0.0005)
                left_on += not device.dark
                took_ms.append(1e3 * (device.states[-1].at_s - killed_s))
        rows.append(
            [
                kind,
                KILLS,
                left_on,
                f"{statistics.median(took_ms):.1f}",
                f"{max(took_ms):.1f}",
            ]
        )
    return rows


def _url(kind: str, device: EndDevice) -> str:
    return f"{kind}://{device.path}?timeout_s=5"


def main() -> None:
    record(
        "LEDs: light over the wire",
        ["exchange", "per second", "median ms", "99th percentile ms", "wrong or lost", "ratio"],
        wire_rows(),
        f"{FRAMES} states of {LIGHTS} lights, the far end in a process of its own: for our "
        "protocol one that does the least that an answer needs, else the simulated device; no "
        "settling time.",
    )
    with tempfile.TemporaryDirectory() as name:
        record(
            "LEDs: dark after kill -9",
            ["line", "captures killed", "lights left on", "median ms", "longest ms"],
            killed_rows(Path(name)),
            "From SIGKILL of the capture's process until the simulated device's lights were off.",
        )


if __name__ == "__main__":
    main()
