"""Somebody opens the page of a head: a real browser draws it by software, from the disk."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from lightstage.formats.processed import ProcessedFolder
from sim.browser import Browser, chromium
from tests.learning.export.called import copied, printed

pytestmark = pytest.mark.skipif(
    chromium() is None, reason="no Chromium: install Debian's package chromium"
)
SOFTWARE = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")
"""WebGL by the processor: there is no graphics card where tests run."""
WIDTH, HEIGHT = 480, 400
ROUGHNESS = "roughness"
PANEL_PX = 330
"""Left of this the page has its controls."""


@pytest.fixture(scope="module")
def page(person: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A red head captured, and a blue one inferred of it."""
    root = tmp_path_factory.mktemp("page")
    captured, inferred = (copied(person, root / name) for name in ("captured", "inferred"))
    for folder, colour in ((captured, (0.6, 0.1, 0.1)), (inferred, (0.1, 0.1, 0.6))):
        _paint(folder, colour)
    words = ("--format", "page", "--compare", inferred.root, "--out", root / "out")
    printed("export", captured.root, *words)
    return root / "out" / "page.html"


@pytest.fixture(scope="module")
def lacking(person: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page whose inferred side has no roughness."""
    root = tmp_path_factory.mktemp("lacking")
    captured, inferred = (copied(person, root / name) for name in ("captured", "inferred"))
    inferred.atlas_path("roughness").unlink()
    words = ("--format", "page", "--compare", inferred.root, "--out", root / "out")
    printed("export", captured.root, *words)
    return root / "out" / "page.html"


def listed(browser: Browser) -> list[str]:
    """The maps that the page lets one choose."""
    words = browser.js("[...document.getElementById('map').options].map(o => o.value)")
    assert isinstance(words, list)
    return words


def _paint(folder: ProcessedFolder, colour: tuple[float, float, float]) -> None:
    shape = folder.read_atlas("diffuse_albedo").shape
    folder.write_atlas("diffuse_albedo", np.broadcast_to(colour, shape).astype(np.float32))


@pytest.fixture(scope="module")
def browser(page: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    profile = tmp_path_factory.mktemp("browser") / "profile"
    with Browser(profile, PANEL_PX + WIDTH, HEIGHT, SOFTWARE) as browser:
        browser.go(page.as_uri())
        yield browser


def shown(browser: Browser, page: Path, asked: str, folder: Path) -> np.ndarray:
    """(height, width, 3) red first, of the page without its controls, when it changes no more."""
    browser.go("about:blank")
    browser.go(f"{page.as_uri()}#{asked}")
    # Pictures are decoded after the page is complete, and each draws again.
    browser.wait("document.querySelector('canvas') && document.getElementById('map').length > 3")
    picture = np.zeros((HEIGHT, WIDTH, 3))
    for _ in range(40):
        before = picture
        image = cv2.imread(str(browser.picture(folder / "page.png")))
        picture = np.asarray(image)[:, PANEL_PX:, ::-1].astype(float)
        if picture.max() > 60 and np.array_equal(picture, before):
            break
    return picture


def reds_and_blues(picture: np.ndarray) -> tuple[int, int]:
    """Pixels that are clearly red, and clearly blue."""
    beside = picture[..., 0] - picture[..., 2]
    return int((beside > 40).sum()), int((beside < -40).sum())


def test_the_page_draws_the_head_and_its_slider_uncovers_inferred_left_and_captured_right(
    browser: Browser, page: Path, tmp_path: Path
) -> None:
    asked = "map=diffuse albedo&around=none&wipe="
    right_only = shown(browser, page, asked + "0", tmp_path)
    red, blue = reds_and_blues(right_only)
    assert red > 10_000
    assert blue == 0
    red, blue = reds_and_blues(shown(browser, page, asked + "1", tmp_path))
    assert red == 0
    assert blue > 10_000
    both = shown(browser, page, asked + "0.7", tmp_path)
    red, blue = reds_and_blues(both)
    assert min(red, blue) > 1_000
    # The line of the slider is at .7 of the window.
    line = round(0.7 * (PANEL_PX + WIDTH)) - PANEL_PX
    assert reds_and_blues(both[:, : line - 1])[0] == 0
    assert reds_and_blues(both[:, line + 1 :])[1] == 0
    assert browser.errors == []


def test_a_map_that_one_side_lacks_is_not_in_the_list_and_a_map_that_nobody_has_is_ignored(
    browser: Browser, page: Path, lacking: Path, tmp_path: Path
) -> None:
    shown(browser, page, "map=nonsense&around=elsewhere&wipe=0", tmp_path)
    chosen = "['map','around'].map(name => document.getElementById(name).value)"
    assert browser.js(chosen) == ["skin, lit", "studio"]
    assert ROUGHNESS in listed(browser)
    shown(browser, lacking, f"map={ROUGHNESS}&wipe=0.7", tmp_path)
    assert browser.js(chosen) == ["skin, lit", "studio"]
    names = listed(browser)
    assert ROUGHNESS not in names
    assert {"occlusion", "mirror share of n = 1.4"} <= set(names)
    for name in names:
        picture = shown(browser, lacking, f"map={name}&around=none&wipe=0.7", tmp_path)
        assert (picture.max(axis=2) > 60).sum() > 5_000, name
    assert browser.errors == []


def test_numbers_are_shown_as_they_are_stored_and_colours_too(
    browser: Browser, page: Path, tmp_path: Path
) -> None:
    wanted = {
        "normals": (127, 127, 250),  # the ball's own, (0, 0, 1), and noise
        "occlusion": (127, 127, 127),  # even between 0 and 1
        "diffuse albedo": (203, 89, 89),  # sRGB of .6 and .1
    }
    for name, expected in wanted.items():
        picture = shown(browser, page, f"map={name}&around=none&wipe=0", tmp_path)
        head = np.abs(picture - 34).max(axis=2) > 10  # the background is #222
        np.testing.assert_allclose(np.median(picture[head], axis=0), expected, atol=8, err_msg=name)
    assert browser.errors == []


def test_a_lit_head_is_brighter_on_the_lamps_side_and_a_drag_turns_it(
    browser: Browser, page: Path, tmp_path: Path
) -> None:
    asked = "map=skin, lit&around=none&wipe=0&height=0&azimuth="
    middle = (PANEL_PX + WIDTH) // 2 - PANEL_PX
    for azimuth, brighter in (("-80", 0), ("80", 1)):
        picture = shown(browser, page, asked + azimuth, tmp_path)
        sides = [picture[:, :middle].sum(), picture[:, middle : 2 * middle].sum()]
        assert sides[brighter] > 1.5 * sides[1 - brighter]
    before = picture
    y = HEIGHT // 2
    browser.drag((PANEL_PX + middle, y), (PANEL_PX + middle + 60, y))
    image = cv2.imread(str(browser.picture(tmp_path / "turned.png")))
    assert np.abs(np.asarray(image)[:, PANEL_PX:, ::-1].astype(float) - before).max() > 20
    assert browser.errors == []
