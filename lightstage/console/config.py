"""Defaults of the page's server, in one place."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class ConsoleConfig:
    """How the page is served.

    Attributes:
        port: port on 127.0.0.1; 0 takes a free one.
        look_s: seconds between two reads of a journal.
        alive_s: seconds without news after which a stream sends a sign of life.
        form_bytes: bytes of the longest form that is accepted.
        visitors: number of browsers whose logins are kept; the oldest are dropped first.
        thumbnail_px: longer side of a small picture.
        large_px: longer side of the picture that a click shows.
        sum_px: longer side of the picture of a sum of light.
        thumbnails: number of small pictures that are kept in memory.
        makers: number of processes that make pictures; the capture has the processor before them.
        picture_s: seconds after which a picture is given up.
        page_events: number of journal lines, at most, that a page gets when it reconnects.
        most_rows: number of patterns that the live view shows, beside those that need somebody.
    """

    port: int = 8750
    look_s: float = 0.1
    alive_s: float = 10.0
    form_bytes: int = 1 << 16
    visitors: int = 64
    thumbnail_px: int = 160
    large_px: int = 1600
    sum_px: int = 480
    thumbnails: int = 2000
    makers: int = 2
    picture_s: float = 60.0
    page_events: int = 200
    most_rows: int = 14
