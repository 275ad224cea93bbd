"""The page of a processed folder shows the maps that are there and what each stage said."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from lightstage.formats.processed import ProcessedFolder
from processing.pages import ATLAS_CAPTIONS, CAPTIONS, lacks_head, show, write_processed_report

REPORT = {
    "subject": "person <7>",
    "expression": "neutral",
    "stages": {"decode": {"seconds": 1.25, "peak_rss_mb": 99.6, "frames": 63, "views": [1]}},
    "versions": {"numpy": "2.4"},
    "warnings": ["cam3: dark"],
}


def test_maps_that_are_there_are_shown(tmp_path: Path, make_processed: Callable[..., Path]) -> None:
    folder = ProcessedFolder(make_processed(tmp_path / "out"))
    folder.write_view("cam0", "diffuse_albedo", np.full((40, 30, 3), 0.4))
    folder.write_view("cam1", "diffuse_albedo", np.full((40, 30, 3), 0.4))
    folder.write_view("cam1", "specular_albedo", np.full((40, 30), 0.03))
    page = write_processed_report(folder.root, REPORT).read_text()
    # Two kinds of views' maps, six of the atlas.
    assert page.count("<figure>") == 2 + 6
    assert "cam0, cam1." in page
    assert "person &lt;7&gt;" in page
    assert "frames 63" in page
    assert "Warning: cam3: dark" in page


def test_a_folder_without_maps_has_a_page_too(tmp_path: Path) -> None:
    page = write_processed_report(tmp_path, {**REPORT, "warnings": []}).read_text()
    assert "<figure>" not in page
    assert "Warning" not in page
    cells = re.findall(r"<td[^>]*>([^<]*)</td>", page)
    assert cells[:4] == ["decode", "1.2", "100", "frames 63"]


def test_a_page_links_to_the_head_that_lies_in_the_folder(
    tmp_path: Path, make_processed: Callable[..., Path]
) -> None:
    out = make_processed(tmp_path / "out")
    assert "href=" not in write_processed_report(out, REPORT).read_text()
    assert not lacks_head(out)
    head = out / "head" / "page.html"
    head.parent.mkdir()
    head.write_text("<html></html>")
    later = (out / "report.html").stat().st_mtime_ns + 10**9
    os.utime(head, ns=(later, later))
    assert lacks_head(out)
    page = write_processed_report(out, REPORT).read_text()
    assert 'href="head/page.html"' in page
    assert "earlier atlas" not in page
    os.utime(ProcessedFolder(out).atlas_path("diffuse_albedo"), ns=(later + 1, later + 1))
    assert "earlier atlas" in write_processed_report(out, REPORT).read_text()


def test_roughness_is_shown_on_its_own_scale() -> None:
    wide, none = np.full((4, 5), 0.25, np.float32), np.full((4, 5), np.nan, np.float32)
    assert show("roughness", wide).shape == (4, 5, 3)
    assert (show("roughness", wide) == 128).all()
    assert (show("roughness", 9 * wide) == 255).all()
    assert (show("roughness", none) == 0).all()
    assert set(CAPTIONS) >= {"roughness", "specular_normal", "confidence"}


def test_a_confidence_states_what_its_dots_are_and_what_would_be_bad() -> None:
    for captions, black in ((CAPTIONS, "not solved"), (ATLAS_CAPTIONS, "no camera")):
        for message in ("Dark dots", "Bad would be", black):
            assert message in captions["confidence"]
