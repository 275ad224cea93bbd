"""A photograph's own record of its taking: settings, body, time, and whether it names a person.

Read from the headers alone, and never written: a RAW is not rewritten. Read are

* the picture's directories: Artist, Copyright, ImageDescription, HostComputer, the XP fields,
  an XMP packet and an IPTC record;
* the EXIF directory: settings, BodySerialNumber, DateTimeOriginal, CameraOwnerName, UserComment;
* the GPS directory;
* of makers' notes the serial number and owner's name of Nikon and Canon.

A TIFF-like file (DNG, NEF, CR2, ARW, PEF) has them in its directories [TIFF1992], a CR3 in boxes of
its header, a RAF in the EXIF part of its preview, a JPEG or PNG in a part of its own.
"""

from __future__ import annotations

import dataclasses
import datetime
import math
import re
import struct
from collections.abc import Iterator
from pathlib import Path

from lightstage.containers import JPEG_HEAD, PNG_HEAD, boxes, chunks, segments
from lightstage.tiff import MAX_VALUE_BYTES, Directory, Reader, directories, directory_at

EXPOSURE, F_NUMBER, ISO, ISO_SPEED = 33434, 33437, 34855, 34867
TAKEN, OFFSET, SUBSECONDS = 36867, 36881, 37521
MAKER_NOTE, USER_COMMENT, OWNER, BODY_SERIAL, DNG_SERIAL = 37500, 37510, 42032, 42033, 50735
FOCAL, FOCAL_35MM, PLANE_X, PLANE_UNIT = 37386, 41989, 41486, 41488
WIDE_PX, HIGH_PX = 40962, 40963
PLANE_UNITS_MM = {2: 25.4, 3: 10.0, 4: 1.0}
"""FocalPlaneResolutionUnit: inch, centimetre, millimetre."""
FILM_DIAGONAL_MM = math.hypot(36.0, 24.0)
"""Of the frame to which a 35 mm equivalent refers, by its diagonal [CIPA2005]."""
FILM_RANGE_MM = (11.0, 1080.0)
"""35 mm equivalents of lenses, from a fisheye to a telescope."""
SENSOR_RANGE_MM = (3.0, 60.0)
"""Longer sides of cameras' sensors."""
MOST_BY_PLANE_MM = 300.0
"""35 mm equivalent that a sensor's resolution alone may give: where a program shrank the picture
and its stated size but not the resolution, portrait lenses become longer than this."""
MAKE, MODEL, ORIENTATION, XMP, IPTC = 271, 272, 274, 700, 33723
NAMES = {
    315: "Artist",
    33432: "Copyright",
    270: "ImageDescription",
    316: "HostComputer",
    40091: "XPTitle",
    40092: "XPComment",
    40093: "XPAuthor",
}
"""Fields of a picture's directory that may name a person."""
MAKERS_WORDS = frozenset({"DIGITAL", "STILL", "CAMERA", "DSC"})
"""What an ImageDescription holds beside the maker's name where a camera writes its own into every
file, as Olympus and Sony do: OLYMPUS DIGITAL CAMERA, SONY DSC. It cannot be cleared."""
GPS_FIELDS = (2, 4, 6, 20, 22, 27, 28)
"""Latitude, longitude, altitude, those of the destination, method and area; not the version."""
XMP_NAMES = {
    rb"dc:creator": "XMP creator",
    rb"dc:rights": "XMP rights",
    rb"dc:description": "XMP description",
    rb"\w+:OwnerName": "XMP OwnerName",
    rb"exif:GPS(?:Latitude|Longitude)": "XMP GPS",
    rb"photoshop:(?:Credit|AuthorsPosition|City)": "XMP photoshop",
    rb"Iptc4xmp\w+:\w+": "XMP IPTC",
}
IPTC_NAMES = {25: "IPTC keywords", 80: "IPTC by-line", 90: "IPTC city", 105: "IPTC headline"}
IPTC_NAMES |= {110: "IPTC credit", 116: "IPTC copyright", 120: "IPTC caption"}
_CR3_UUID = bytes.fromhex("85c0b687820f11e08111f4ce462b6a48")
_CR3_PARTS = {b"CMT1": "picture", b"CMT2": "exif", b"CMT3": "canon", b"CMT4": "gps"}
MOST_STOPS = 6.0
"""Exposures of one session's photographs are apart by so much at most."""


@dataclasses.dataclass(frozen=True)
class Exif:
    """The fields of a photograph; None where it does not have one.

    Attributes:
        make: the maker's name.
        model: maker and name, as in the file.
        serial: of the body.
        iso: sensitivity.
        exposure_s: exposure time.
        f_number: aperture.
        taken: DateTimeOriginal, without a zone unless the file has it.
        private: names of the fields that may reveal who or where; never their values.
        focal_mm: the lens's focal length.
        focal_35mm_mm: of the lens that shows as much on film of 36 x 24 mm, by the diagonal.
        focal_plane_px_per_mm: pixels on a millimetre of the sensor.
        longer_px: longer side of the picture that the camera wrote.
        orientation: tag of the picture's first directory, 1 to 8.
    """

    make: str | None = None
    model: str | None = None
    serial: str | None = None
    iso: int | None = None
    exposure_s: float | None = None
    f_number: float | None = None
    taken: datetime.datetime | None = None
    private: tuple[str, ...] = ()
    focal_mm: float | None = None
    focal_35mm_mm: float | None = None
    focal_plane_px_per_mm: float | None = None
    longer_px: int | None = None
    orientation: int | None = None

    @property
    def exposure(self) -> float | None:
        """Seconds * ISO / f-number^2; None where the file does not state them all."""
        time_s, iso, stop = self.exposure_s or 0, self.iso or 0, self.f_number or 0
        return float(time_s * iso / stop**2) if min(time_s, iso, stop) > 0 else None

    def focal_px(self, width_px: int, height_px: int) -> float | None:
        """Focal length in pixels of a picture of that size, uncropped; None where nothing gives it.

        The 35 mm equivalent has precedence: programs that shrink a picture leave it right.
        """
        if self.focal_35mm_mm:
            inside = FILM_RANGE_MM[0] <= self.focal_35mm_mm <= FILM_RANGE_MM[1]
            return film_focal_px(self.focal_35mm_mm, width_px, height_px) if inside else None
        if not (self.focal_mm and self.focal_plane_px_per_mm and self.longer_px):
            return None
        sensor_mm = self.longer_px / self.focal_plane_px_per_mm
        found = self.focal_mm / sensor_mm * max(width_px, height_px)
        film_mm = found / film_focal_px(1.0, width_px, height_px)
        possible = SENSOR_RANGE_MM[0] <= sensor_mm <= SENSOR_RANGE_MM[1]
        return found if possible and FILM_RANGE_MM[0] <= film_mm <= MOST_BY_PLANE_MM else None


def film_focal_px(film_mm: float, width_px: int, height_px: int) -> float:
    """Focal length in pixels of a 35 mm equivalent, which is by the diagonal [CIPA2005]."""
    return film_mm * math.hypot(width_px, height_px) / FILM_DIAGONAL_MM


def read_exif(path: Path) -> Exif:
    """Read a photograph's headers.

    Args:
        path: of a RAW, DNG, JPEG, PNG or TIFF; another file (OpenEXR) has no such fields.

    Raises:
        OSError: the file cannot be read. Damaged headers give less; they are no error.
    """
    with path.open("rb", buffering=1 << 14) as file:
        return _collect(list(_parts(Reader(file))))


def _parts(reader: Reader) -> Iterator[Directory]:
    """Every directory of a photograph, whatever its container."""
    head = reader.bytes_at(0, 16)
    if head[4:11] == b"ftypcrx":
        yield from _cr3_parts(reader)
    elif head[:15] == b"FUJIFILMCCD-RAW":
        yield from _raf_parts(reader)
    elif head.startswith(JPEG_HEAD):
        yield from _jpeg_parts(reader, 0)
    elif head[:8] == PNG_HEAD:
        yield from _png_parts(reader)
    else:
        yield from _tiff_parts(reader)


def _tiff_parts(reader: Reader) -> Iterator[Directory]:
    """A TIFF's directories, with the makers' notes that are in EXIF's."""
    order = "<" if reader.bytes_at(0, 2) == b"II" else ">"
    make = ""
    for directory in directories(reader):
        make = make or directory.text(MAKE)
        yield directory
        note = directory.tags.get(MAKER_NOTE)
        if not isinstance(note, bytes):
            continue
        place = directory.places[MAKER_NOTE] - reader.base
        if note[:6] == b"Nikon\0":
            # A TIFF of its own behind ten bytes.
            inner = reader.at(place + 10)
            yield from (dataclasses.replace(d, kind="nikon") for d in directories(inner))
        elif make.startswith("Canon"):
            # Canon's is a directory without a head, whose places count from the file's.
            yield directory_at(reader, place, order, "canon")[0]


def _cr3_parts(reader: Reader) -> Iterator[Directory]:
    """The four TIFF parts in a CR3's header box (ISO base media file format)."""
    for kind, place, size in boxes(reader, 0, None):
        if kind != b"moov":
            continue
        for inner, start, length in boxes(reader, place, place + size):
            if inner != b"uuid" or reader.bytes_at(start, 16) != _CR3_UUID:
                continue
            for name, at, _ in boxes(reader, start + 16, start + length):
                if name in _CR3_PARTS:
                    for directory in directories(reader.at(at)):
                        yield dataclasses.replace(directory, kind=_CR3_PARTS[name])


def _raf_parts(reader: Reader) -> Iterator[Directory]:
    """The EXIF part of the JPEG to which a RAF's header points."""
    place = reader.bytes_at(84, 4)
    if len(place) == 4:
        yield from _jpeg_parts(reader, struct.unpack(">I", place)[0])


def _jpeg_parts(reader: Reader, place: int) -> Iterator[Directory]:
    """The EXIF part of a JPEG that begins at a byte."""
    for marker, at, _ in segments(reader, place + 2):
        if marker == 0xE1 and reader.bytes_at(at, 6) == b"Exif\0\0":
            yield from _tiff_parts(reader.at(at + 6))


def _png_parts(reader: Reader) -> Iterator[Directory]:
    """The EXIF part of a PNG."""
    for kind, at, _ in chunks(reader):
        if kind == b"eXIf":
            yield from _tiff_parts(reader.at(at))


def _collect(parts: list[Directory]) -> Exif:
    """The value of directories, from the first one that has it."""

    def text(*tags: int, kind: str = "") -> str | None:
        texts = (d.text(t) for t in tags for d in parts if not kind or d.kind == kind)
        return next((each for each in texts if each), None)

    def number(*tags: int) -> float | None:
        numbers = (d.number(t) for t in tags for d in parts if d.kind in ("exif", "picture"))
        return next((each for each in numbers if each is not None and each > 0), None)

    iso = number(ISO)
    if iso == 65535:  # what does not fit in 16 bits is in another field
        iso = number(ISO_SPEED) or iso
    turned = next((d.number(ORIENTATION) for d in parts if d.kind == "picture"), None)
    plane, unit = number(PLANE_X), number(PLANE_UNIT)
    longer = max(number(WIDE_PX) or 0, number(HIGH_PX) or 0)
    return Exif(
        make=text(MAKE, kind="picture"),
        model=text(MODEL, kind="picture"),
        serial=text(BODY_SERIAL, kind="exif") or _maker_serial(parts) or text(DNG_SERIAL),
        iso=None if iso is None else round(iso),
        exposure_s=number(EXPOSURE),
        f_number=number(F_NUMBER),
        focal_mm=number(FOCAL),
        focal_35mm_mm=number(FOCAL_35MM),
        longer_px=round(longer) if longer > 0 else None,
        focal_plane_px_per_mm=None
        if plane is None
        else plane / PLANE_UNITS_MM.get(round(unit or 2), 25.4),
        orientation=None if turned is None or not 1 <= turned <= 8 else int(turned),
        taken=_moment(text(TAKEN), text(SUBSECONDS), text(OFFSET)),
        private=tuple(dict.fromkeys(_private(parts))),
    )


def _maker_serial(parts: list[Directory]) -> str | None:
    for part in parts:
        if part.kind == "nikon" and part.text(0x1D):
            return part.text(0x1D)
        if part.kind == "canon" and part.number(0x0C):
            return str(int(part.number(0x0C) or 0))
    return None


def _moment(
    text: str | None, subseconds: str | None, offset: str | None
) -> datetime.datetime | None:
    try:
        taken = datetime.datetime.strptime(text or "", "%Y:%m:%d %H:%M:%S")
        if subseconds is not None and re.fullmatch(r"\d{1,6}", subseconds, re.ASCII):
            taken = taken.replace(microsecond=int(subseconds.ljust(6, "0")))
        if offset is not None and re.fullmatch(r"[+-]\d\d:\d\d", offset, re.ASCII):
            sign = -1 if offset[0] == "-" else 1
            ahead = datetime.timedelta(hours=int(offset[1:3]), minutes=int(offset[4:]))
            taken = taken.replace(tzinfo=datetime.timezone(sign * ahead))
    except ValueError:
        return None
    return taken


def _private(parts: list[Directory]) -> Iterator[str]:
    """Names of fields that are not empty and may reveal who or where."""
    for part in parts:
        if part.kind == "picture":
            for tag, name in NAMES.items():
                if _has_text(part.tags.get(tag)) and not _is_makers_own(part, tag):
                    yield name
        if part.kind == "exif":
            if _has_text(part.tags.get(OWNER)):
                yield "CameraOwnerName"
            comment = part.tags.get(USER_COMMENT)
            # Its first eight bytes name the letters' code.
            if isinstance(comment, bytes) and _has_text(comment[8:]):
                yield "UserComment"
        if part.kind == "canon" and _has_text(part.tags.get(9)):
            yield "Canon OwnerName"
        if part.kind == "gps" and any(_is_placed(part.tags.get(tag)) for tag in GPS_FIELDS):
            yield "GPS"
        packet = part.tags.get(XMP, b"")
        if part.kind == "picture":
            yield from _xmp_names(_bytes(packet))
            yield from _iptc_names(_bytes(part.tags.get(IPTC, b"")))


def _has_text(value: object) -> bool:
    return any(c not in b" \0\t\r\n" for c in _bytes(value))


def _is_makers_own(part: Directory, tag: int) -> bool:
    """Whether a field is the description that a maker writes into every photograph."""
    words, makers = (set(part.text(each).upper().split()) for each in (tag, MAKE))
    return NAMES[tag] == "ImageDescription" and words <= makers | MAKERS_WORDS


def _is_placed(value: object) -> bool:
    if isinstance(value, tuple):
        return any(v == v for v in value)
    return _has_text(value)


def _bytes(value: object) -> bytes:
    """A value as bytes: some writers give XMP and XP fields as numbers of one byte."""
    if isinstance(value, bytes):
        return value
    if isinstance(value, tuple):
        return bytes(int(v) & 255 for v in value if v == v and abs(v) < 2**32)
    return b""


def _xmp_names(packet: bytes) -> Iterator[str]:
    """Fields of an XMP packet (of its first part, where it is long) that have content."""
    packet = packet[:MAX_VALUE_BYTES]
    for pattern, name in XMP_NAMES.items():
        attribute = rb"(?<![\w:/])" + pattern + rb'\s{0,9}=\s{0,9}["\'][^"\'\s]'
        element = rb"<" + pattern + rb"(?:\s[^<>]{0,200})?>(?:\s|<[^/!][^<>]{0,200}>){0,20}[^<\s]"
        if re.search(attribute, packet) or re.search(element, packet):
            yield name


def _iptc_names(record: bytes) -> Iterator[str]:
    """Fields of an IPTC record that have content."""
    place = 0
    while place + 5 <= len(record) and record[place] == 0x1C:
        set_, field, size = struct.unpack_from(">BBH", record, place + 1)
        if set_ == 2 and field in IPTC_NAMES and _has_text(record[place + 5 :][:size]):
            yield IPTC_NAMES[field]
        place += 5 + size
