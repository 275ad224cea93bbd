"""Drivers' errors in plain words: no codes, ports or exit statuses; those stay in the journal."""

from __future__ import annotations

import re

THEN = "\n  then: "
"""Between why a camera failed and why it could not be started again."""

MEANINGS = {
    -1: "the camera could not take the photograph",
    -2: "the driver was asked for something impossible",
    -3: "the camera's memory is full",
    -5: "the driver does not know this kind of connection",
    -6: "the camera cannot do this",
    -7: "the connection to the camera broke",
    -10: "the camera did not answer in time",
    -52: "the camera is not on the USB bus",
    -53: "another program has the camera",
    -60: "the USB connection was lost",
    -102: "the camera's files are damaged",
    -103: "the camera cannot be reached",
    -105: "no such camera is connected",
    -107: "the folder is not on the camera's card",
    -108: "the file is not on the camera's card",
    -110: "the camera is busy",
    -112: "the command was cancelled",
    -114: "the camera's memory has no room",
}
"""What libgphoto2's error codes mean to somebody at the stage [libgphoto2, gphoto2-result.h]."""

_CODE = re.compile(r"(libgphoto2 )?error (-\d+) \(([^()\n]*)\)")
_PORT = re.compile(r"(?<=camera )([^\s,():;]+) \((?:port )?[^()\s]*\)")
_STATUS = re.compile(r", exit status (?:-?\d+|None)(?:, .*?)?(?=, expected |\.? *$|\n)")
_STATE = re.compile(r" \((?:type 0x[0-9a-f]+|LIT), state [0-9a-f]*\.\.\)")
_ERRNO = re.compile(r"\[Errno -?\d+\] ")


def _meaning(found: re.Match[str]) -> str:
    """Another driver's own words are better than its code; libgphoto2's are for programmers."""
    return MEANINGS.get(int(found[2]), found[3]) if found[1] else found[3]


def cause(text: str, camera: str) -> str:
    """Why a camera gave no photograph, in plain words, where its name is shown beside it.

    Args:
        text: an error of a device: with what it was asked, and what was expected of it.
        camera: its name.
    """
    whole, *later = plain(text).split(THEN)
    first, *rest = whole.split("\n")
    message = "\n".join([_found(first, camera), *rest])
    if not later:
        return message
    # What to do is in the first part: it is the cause.
    still = re.split(r"\.(?: [A-Z]|$)", _found(later[-1].split("\n")[0], camera))[0]
    return f"{message.removesuffix('.')}. It does not start again: {still}."


def _found(text: str, camera: str) -> str:
    """What was found, without where, and without what was expected."""
    prefix = rf"camera {re.escape(camera)}(?:, [^:\n]*)?: found "
    text, removed = re.subn(prefix, "", text, count=1)
    return re.sub(r", expected .*?(?=\. [A-Z]|\.?$)", "", text) if removed else text


def plain(text: str) -> str:
    """An error of a device as somebody at the stage reads it.

    Args:
        text: with the driver's own codes, ports and exit statuses.
    """
    text = _CODE.sub(_meaning, text)
    for code in (_STATUS, _STATE, _ERRNO):
        text = code.sub("", text)
    return _PORT.sub(r"\1", text)
