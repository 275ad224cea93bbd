"""A reader opens the report: a real browser shows its pictures and text."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest

from processing.report import Picture, Section, Table, write_report

QUIET = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--hide-scrollbars",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


def screenshot(page: Path, folder: Path, width: int, height: int) -> np.ndarray:
    """(height, width, 3) BGR of a page as Chromium draws it."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        pytest.skip("no Chromium: install Debian's package chromium")
    picture = folder / "page.png"
    command = [
        chromium,
        *QUIET,
        f"--user-data-dir={folder / 'profile'}",
        f"--window-size={width},{height}",
        f"--screenshot={picture}",
        page.as_uri(),
    ]
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    return np.asarray(cv2.imread(str(picture)))


@pytest.mark.parametrize("width", [420, 1200])
def test_a_browser_shows_the_pictures_and_the_text(tmp_path: Path, width: int) -> None:
    red = np.zeros((200, 300, 3), np.uint8)
    red[:] = (220, 30, 20)
    table = Table(("what", "error"), (("albedo", 0.019),))
    section = Section("Maps", ["What each view shows.", Picture(red, "A red one.", "red"), table])
    page = write_report(tmp_path / "report.html", "Session", [section])
    shot = screenshot(page, tmp_path, width, 900).astype(int)
    assert shot.shape == (900, width, 3)
    shown = (shot[..., 2] > 180) & (shot[..., :2].max(axis=2) < 80)
    # The picture lies on the page whole, not scaled away and not wider than a phone.
    assert 0.5 * 200 * 300 < shown.sum() < 2.5 * 200 * 300
    # Text is dark on light.
    assert (shot.max(axis=2) < 90).sum() > 300
    assert (shot.min(axis=2) > 240).mean() > 0.4
