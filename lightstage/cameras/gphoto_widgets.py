"""Settings through libgphoto2: read under their makers' names, changed, and read back."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from typing import Any

from lightstage.cameras import gphoto_settings as known
from lightstage.cameras.camera import Summary
from lightstage.cameras.gphoto_link import BUSY, IO, Link
from lightstage.errors import DeviceError


def read_summary(link: Link, serial: str | None) -> Summary:
    """The camera's summary; the library's errors pass, so that the whole may be read again.

    Args:
        link: the camera, connected.
        serial: read_text(link, "serial"), or None where that means nothing.
    """
    values = {name: read_text(link, name) for name in known.TEXTS}
    automatic = _first(link, known.AUTO_ISO)
    if values["iso"] is not None and automatic is not None and known.is_on(automatic):
        values["iso"] = f"auto, from {values['iso']}"
    charge = _first(link, known.NAMES["battery_percent"])
    return Summary(
        serial=serial,
        model=link.model,
        battery_percent=None if charge is None else known.percent(charge),
        card_free_bytes=_free_bytes(link),
        clock_offset_s=_clock_offset_s(link),
        **values,
    )


def read_text(link: Link, name: str) -> str | None:
    """The camera's value of a field of Summary; None where it has no such setting."""
    return _first(link, known.NAMES[name], name in known.MAY_BE_EMPTY)


def change(link: Link, name: str, value: str) -> None:
    """Set a field of Summary and read it back; the clock by the offset that it is to have.

    Raises:
        DeviceError: the camera has no such setting, no such choice, or does not keep it.
    """
    for key, widget in _widgets(link, known.NAMES.get(name, ())):
        kind = widget.get_type()
        if name == "clock_offset_s":
            widget.set_value(round(time.time() + float(value)))
        elif kind in (link.library.GP_WIDGET_RADIO, link.library.GP_WIDGET_MENU):
            choices = [widget.get_choice(i) for i in range(widget.count_choices())]
            if value not in choices:
                raise DeviceError(
                    link.port, field=name, found=repr(value), expected=f"of {', '.join(choices)}"
                )
            widget.set_value(value)
        else:
            widget.set_value(value)
        link.camera.set_single_config(key, widget)
        kept = link.camera.get_single_config(key).get_value()
        if name != "clock_offset_s" and str(kept).strip() != value.strip():
            raise DeviceError(
                link.port,
                field=name,
                found=str(kept),
                expected=value,
                hint="The camera does not take it from here: set it on the camera.",
            )
        return
    raise DeviceError(
        link.port,
        field=name,
        found="a camera that has no such setting",
        expected=f"one of {', '.join(known.NAMES)}",
        hint="Set it on the camera.",
    )


def keep_on_card(link: Link) -> None:
    """Have photographs go to the card: in the camera's memory they end with the connection."""
    with contextlib.suppress(link.library.GPhoto2Error):
        widget = link.camera.get_single_config(known.TARGET)
        choices = [widget.get_choice(i) for i in range(widget.count_choices())]
        cards = [choice for choice in choices if known.CARD in choice.lower()]
        if cards and widget.get_value() not in cards:
            widget.set_value(cards[0])
            link.camera.set_single_config(known.TARGET, widget)


def _first(link: Link, names: tuple[str, ...], may_be_empty: bool = False) -> str | None:
    """Value of the first of these settings that the camera has, and that is not empty."""
    for _, widget in _widgets(link, names):
        value = str(widget.get_value() or "").strip()
        if value or may_be_empty:
            return value
    return None


def _widgets(link: Link, names: tuple[str, ...]) -> Iterator[tuple[str, Any]]:
    """Those of these settings that the camera has; errors of the connection pass."""
    for name in names:
        try:
            widget = link.camera.get_single_config(name)
        except link.library.GPhoto2Error as error:
            if error.code in (IO, BUSY):
                raise
            continue
        yield name, widget


def _clock_offset_s(link: Link) -> float | None:
    for _, widget in _widgets(link, known.NAMES["clock_offset_s"]):
        value = widget.get_value()
        if isinstance(value, int):
            return value - time.time()
    return None


def _free_bytes(link: Link) -> int | None:
    """Room on the fullest of its cards: it does not report which one it writes to."""
    library = link.library
    try:
        stores = link.camera.get_storageinfo()
    except library.GPhoto2Error as error:
        if error.code in (IO, BUSY):
            raise
        return None
    has_it = library.GP_STORAGEINFO_FREESPACEKBYTES
    room = [1024 * int(store.freekbytes) for store in stores if store.fields & has_it]
    return min(room, default=None)
