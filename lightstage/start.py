"""Where the four programs begin: Ctrl-C is quiet from the first import on."""

from __future__ import annotations

import importlib

from lightstage.interrupts import end_without_traceback


def lightstage() -> None:
    """Entry point of `lightstage`."""
    _start("lightstage")


def processing() -> None:
    """Entry point of `lightstage-processing`."""
    _start("processing")


def learning() -> None:
    """Entry point of `lightstage-learning`."""
    _start("learning")


def sim() -> None:
    """Entry point of `lightstage-sim`."""
    _start("sim")


def _start(package: str) -> None:
    end_without_traceback()
    importlib.import_module(f"{package}.__main__").main()
