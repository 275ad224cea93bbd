"""Run time of a frame of a head's page without a graphics card: Chromium's software WebGL.

`python -m benchmarks.avatar_page` opens the page of our template with noise in all maps, lights it
anew for each frame, and measures the time until its pixels can be read.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from benchmarks.avatar_speed import write_head
from benchmarks.record import record
from learning.export.command import export_command
from lightstage.commands import quiet
from lightstage.formats.processed import ProcessedFolder
from sim.browser import Browser

SOFTWARE = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")
SIZES = ((640, 480), (1280, 900))
ROWS = (1536, 3072)
FRAMES = 10
TIME = """
(async () => {
  const gl = document.querySelector("canvas").getContext("webgl2"), pixel = new Uint8Array(4);
  const lamp = document.getElementById("lamp"), frame = () => new Promise(requestAnimationFrame);
  const draw = async () => {
    lamp.dispatchEvent(new Event("input"));
    await frame();
    await frame();
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
  };
  await draw();
  const began = performance.now();
  for (let k = 0; k < FRAMES; k++) await draw();
  window.frameMs = (performance.now() - began) / FRAMES;
})()
"""


def main() -> None:
    """Measure, print, record."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    body = []
    with tempfile.TemporaryDirectory() as place:
        for rows in ROWS:
            folder = ProcessedFolder(Path(place) / f"head-{rows}")
            write_head(folder, rows)
            out = Path(place) / f"page-{rows}"
            export_command(folder.root, None, "page", out, None, None, quiet)
            page = out / "page.html"
            for width, height in SIZES:
                profile = Path(place) / f"profile-{rows}-{width}"
                with Browser(profile, width, height, SOFTWARE) as browser:
                    browser.go(page.as_uri())
                    browser.wait("document.getElementById('map').length > 3", 120)
                    browser.js(TIME.replace("FRAMES", str(FRAMES)))
                    browser.wait("window.frameMs", 300)
                    took = browser.js("window.frameMs")
                    errors = len(browser.errors)
                size = page.stat().st_size / 1e6
                body.append(
                    [rows, f"{width} x {height}", f"{took:.0f}", f"{size:.1f}", str(errors)]
                )
                print(body[-1], flush=True)
    record(
        "A head's page in software rendering",
        ["rows", "window px", "ms a frame", "page MB", "errors in the console"],
        body,
        f"Headless Chromium with SwiftShader, mean of {FRAMES} frames, others use the machine too; "
        "noise in all maps makes the pages as large as they can be. At most 2048 rows are shown.",
    )


if __name__ == "__main__":
    main()
