"""A report is one valid file that shows text as text and pictures as they are."""

from __future__ import annotations

import base64
import re
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest

from lightstage.errors import LightstageError
from processing.report import (
    Link,
    Picture,
    Section,
    Table,
    display,
    display_error,
    display_normals,
    encode,
    side_by_side,
    write_report,
)

EVIL = '<script>alert("1 & 2")</script>'


class Balanced(HTMLParser):
    """Fails on a tag that closes another than the last open one; keeps text and attributes."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def page(tmp_path: Path) -> tuple[str, Balanced]:
    rng = np.random.default_rng(0)
    picture = rng.integers(0, 256, (20, 30, 3), dtype=np.uint8)
    parts = [
        f"words {EVIL}",
        Picture(picture, f"caption {EVIL}", f'alt "{EVIL}', lossless=True),
        Table(["name", f"mm {EVIL}"], [["a", 0.123456], [EVIL, 7]], f"of {EVIL}"),
    ]
    path = write_report(tmp_path / "r.html", EVIL, [Section(EVIL, parts)], f"by {EVIL}")
    text = path.read_text()
    parsed = Balanced()
    parsed.feed(text)
    parsed.close()
    return text, parsed


def test_page_is_balanced_and_loads_nothing(tmp_path: Path) -> None:
    text, parsed = page(tmp_path)
    assert parsed.open == []
    assert not re.search(r"(src|href)=\"(?!data:)", text)
    assert "http" not in text
    assert any(attrs.get("name") == "viewport" for _, attrs in parsed.tags)


def test_a_link_leads_to_a_file_beside_the_report_whatever_its_name(tmp_path: Path) -> None:
    link = Link('head/a "page" & more.html', f"turn {EVIL}")
    path = write_report(tmp_path / "r.html", "report", [Section("pages", [link])])
    parsed = Balanced()
    parsed.feed(path.read_text())
    targets = [attrs["href"] for tag, attrs in parsed.tags if tag == "a"]
    assert targets == ["head/a%20%22page%22%20%26%20more.html"]
    assert f"turn {EVIL}" in parsed.text


def test_text_is_shown_and_never_run(tmp_path: Path) -> None:
    text, parsed = page(tmp_path)
    assert "<script" not in text
    assert parsed.text.count(EVIL) == 9
    assert "0.1235" in parsed.text


def test_a_lossless_picture_comes_back_as_it_was(tmp_path: Path) -> None:
    _, parsed = page(tmp_path)
    source = next(attrs["src"] for tag, attrs in parsed.tags if tag == "img")
    assert source is not None
    data = np.frombuffer(base64.b64decode(source.split(",")[1]), np.uint8)
    expected = np.random.default_rng(0).integers(0, 256, (20, 30, 3), dtype=np.uint8)
    np.testing.assert_array_equal(cv2.imdecode(data, cv2.IMREAD_COLOR)[:, :, ::-1], expected)


def test_jpeg_keeps_red_red() -> None:
    red = np.zeros((16, 16, 3), np.uint8)
    red[:, :, 0] = 255
    back = cv2.imdecode(np.frombuffer(encode(red), np.uint8), cv2.IMREAD_COLOR)[:, :, ::-1]
    assert back[8, 8, 0] > 240
    assert back[8, 8, 1:].max() < 20


def test_a_float_picture_is_refused() -> None:
    with pytest.raises(LightstageError, match="uint8"):
        encode(np.zeros((4, 4, 3)))


def test_display_encodes_known_values() -> None:
    linear = np.array([[0.0, 0.18, 1.0, 50.0, -1.0, np.nan, np.inf]])
    np.testing.assert_array_equal(display(linear)[0, :, 1], [0, 118, 255, 255, 0, 0, 255])


def test_normals_show_forward_as_light_blue_and_nothing_as_black() -> None:
    shown = display_normals(np.array([[[0, 0, 1.0], [-1, 0, 0], [0, 0, 0]]]))
    np.testing.assert_array_equal(shown[0], [[128, 128, 255], [0, 128, 128], [0, 0, 0]])


def test_error_colours_grow_brighter_and_end_at_the_largest() -> None:
    shown = display_error(np.array([[0, 1, 2, 4, np.nan]]), 2.0).astype(int).sum(axis=2)[0]
    assert shown[0] < shown[1] < shown[2] == shown[3] == shown[4]


def test_pictures_in_a_row_have_one_height() -> None:
    row = side_by_side([np.zeros((10, 20, 3), np.uint8), np.zeros((40, 40), np.uint8)], 30)
    assert row.shape == (30, 60 + 6 + 30, 3)
