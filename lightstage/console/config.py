"""Defaults of the page's server, in one place."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class ConsoleConfig:
    """How the page is served.

    Attributes:
        port: of 127.0.0.1; 0 takes a free one.
        look_s: how often a journal is looked at for what the page shows.
        alive_s: a stream without news says so often that it lives.
        form_bytes: longest form that is read.
        visitors: sessions of browsers that are remembered; the oldest go first.
        thumbnail_px: longer side of the small pictures.
        large_px: longer side of the pictures that a click shows.
        sum_px: longer side of the pictures of light that should add up.
        thumbnails: small pictures that are kept in memory.
        makers: processes that make pictures, behind the capture in the queue for the processor.
        picture_s: longest time for one picture.
        page_events: lines of a journal that a page gets at most when it comes back.
        most_rows: patterns that the live view shows at a time, beside those that need somebody.
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
