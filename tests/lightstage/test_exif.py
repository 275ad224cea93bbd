"""Reading what photographs say of their taking."""

import datetime
import io
import struct
import warnings

import numpy as np
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st

from lightstage.exif import Exif, read_exif
from sim.camera import dng
from sim.camera.sensor import Sensor, SensorConfig

SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 7: 1}
LETTERS = {1: "B", 2: "B", 3: "H", 4: "I", 5: "I", 7: "B"}


def tiff(picture, exif=None, gps=None, order="<", magic=42, base=0):
    """A TIFF's bytes; tags: number to (type, bytes or numbers). `base`: where places count from."""
    picture = dict(picture)
    if exif is not None:
        picture[34665] = (4, [0])
    if gps is not None:
        picture[34853] = (4, [0])
    at = 8
    places = {}
    blobs = []
    for number, tags in ((0, picture), (34665, exif), (34853, gps)):
        if tags is not None:
            places[number] = at
            at += len(directory(tags, 0, order))
    for number, tags in ((0, picture), (34665, exif), (34853, gps)):
        if tags is not None:
            for pointer in (34665, 34853):
                if pointer in tags:
                    tags[pointer] = (4, [base + places[pointer]])
            blobs.append(directory(tags, base + places[number], order))
    head = (b"II" if order == "<" else b"MM") + struct.pack(order + "HI", magic, base + 8)
    return head + b"".join(blobs)


def directory(tags, at, order):
    entries, longer = struct.pack(order + "H", len(tags)), b""
    behind = at + 2 + 12 * len(tags) + 4
    for tag, (kind, value) in sorted(tags.items()):
        data = struct.pack(f"{order}{len(value)}{LETTERS[kind]}", *value)
        count = len(data) // SIZES[kind]
        entries += struct.pack(order + "HHI", tag, kind, count)
        if len(data) > 4:
            entries += struct.pack(order + "I", behind + len(longer))
            longer += data + b"\0" * (len(data) % 2)
        else:
            entries += data.ljust(4, b"\0")
    return entries + struct.pack(order + "I", 0) + longer


def words(text):
    return 2, text.encode() + b"\0"


CAMERA = {
    33434: (5, [10, 600]),
    33437: (5, [80, 10]),
    34855: (3, [400]),
    36867: words("2026:03:04 05:06:07"),
    42033: words("6012345"),
}
NIKON = {271: words("NIKON CORPORATION"), 272: words("NIKON D750")}


def read(tmp_path, data):
    path = tmp_path / "photograph.raw"
    path.write_bytes(data)
    return read_exif(path)


@pytest.mark.parametrize("order", ["<", ">"])
def test_settings_body_and_time_are_read_in_both_byte_orders(tmp_path, order):
    found = read(tmp_path, tiff(NIKON, dict(CAMERA), order=order))
    taken = datetime.datetime(2026, 3, 4, 5, 6, 7)
    assert found == Exif(
        "NIKON CORPORATION", "NIKON D750", "6012345", 400, pytest.approx(1 / 60), 8.0, taken, ()
    )


def test_a_zone_and_parts_of_a_second_are_read(tmp_path):
    exif = CAMERA | {36881: words("-03:30"), 37521: words("25")}
    taken = read(tmp_path, tiff(NIKON, exif)).taken
    assert taken.isoformat() == "2026-03-04T05:06:07.250000-03:30"


def test_what_the_simulated_camera_writes_is_read_back(tmp_path):
    sensor = Sensor(SensorConfig(iso=200), np.eye(3), 1 / 40)
    exif = dng.Exif("Nikon DSC D750", "6012399", 11.0, 60.0)
    counts = np.full((32, 48), 700, np.uint16)
    found = read(tmp_path, dng.dng_bytes(counts, sensor, exif))
    taken = datetime.datetime(2000, 1, 1, 12, tzinfo=datetime.UTC)
    assert found == Exif(
        "Nikon", "Nikon DSC D750", "6012399", 200, 1 / 40, 11.0, taken, (), 60.0, orientation=1
    )


@pytest.mark.parametrize(("unit", "px_per_mm"), [(2, 4000 / 25.4), (3, 400.0), (4, 4000.0)])
def test_focal_lengths_and_the_sensor_s_pixels_are_read(tmp_path, unit, px_per_mm):
    exif = CAMERA | {37386: (5, [850, 10]), 41989: (3, [127]), 41486: (5, [4000, 1])}
    wide = {40962: (3, [4016]), 40963: (4, [6016])}
    found = read(tmp_path, tiff(NIKON, exif | wide | {41488: (3, [unit])}))
    assert (found.focal_mm, found.focal_35mm_mm) == (85.0, 127.0)
    assert found.longer_px == 6016
    assert found.focal_plane_px_per_mm == pytest.approx(px_per_mm)


PHONE = {"focal_mm": 6.86, "focal_35mm_mm": 26.0, "longer_px": 4032}
PORTRAIT = {"focal_mm": 85.0, "focal_plane_px_per_mm": 6000 / 36}


@pytest.mark.parametrize(
    ("fields", "size", "focal_px"),
    [
        # By the diagonal: of 4:3 the longer side would give 3.7 % less.
        (PHONE, (4032, 3024), 26 * 5040 / 43.2666),
        (PHONE, (3024, 4032), 26 * 5040 / 43.2666),
        (PHONE, (800, 600), 26 * 1000 / 43.2666),
        (PORTRAIT | {"longer_px": 6000}, (6000, 4000), 85 / 36 * 6000),
        # Shrunk by a program that left all fields as they were.
        (PORTRAIT | {"longer_px": 6000}, (1200, 800), 85 / 36 * 1200),
        # It wrote the new size and kept the resolution: a lens of 425 mm.
        (PORTRAIT | {"longer_px": 1200}, (1200, 800), None),
        (PORTRAIT | {"longer_px": 1200, "focal_35mm_mm": 85.0}, (1200, 800), 85 / 36 * 1200),
        # Sensors of 75 mm and 2.4 mm, and no size.
        (PORTRAIT | {"longer_px": 12500}, (1200, 800), None),
        ({"focal_mm": 4.0, "focal_plane_px_per_mm": 500.0, "longer_px": 1200}, (1200, 900), None),
        (PORTRAIT, (1200, 800), None),
        ({"focal_35mm_mm": 3.0}, (1200, 800), None),
        ({"focal_mm": 50.0}, (1200, 800), None),
        ({}, (1200, 800), None),
    ],
)
def test_a_focal_length_in_pixels_is_the_lens_s_or_none(fields, size, focal_px):
    found = Exif(**fields).focal_px(*size)
    assert found == (None if focal_px is None else pytest.approx(focal_px, rel=1e-5))


def test_a_dng_by_another_hand_tells_only_what_stands_in_it(tmp_path):
    file = io.BytesIO()
    tags = [(50735, 2, 0, "77", True), (315, 2, 0, "A. Person", True)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        tifffile.imwrite(file, np.zeros((4, 4), np.uint16), metadata=None, extratags=tags)
    found = read(tmp_path, file.getvalue())
    assert (found.serial, found.iso, found.private) == ("77", None, ("Artist",))


@pytest.mark.parametrize(
    ("where", "tag", "value", "name"),
    [
        ("picture", 315, words("A. Person"), "Artist"),
        ("picture", 33432, words("(c) A. Person"), "Copyright"),
        ("picture", 270, words("A. Person at home"), "ImageDescription"),
        ("picture", 316, words("person-laptop"), "HostComputer"),
        ("picture", 40093, (1, "P".encode("utf-16-le")), "XPAuthor"),
        ("picture", 33723, (7, b"\x1c\x02\x50\0\x01P"), "IPTC by-line"),
        ("exif", 42032, words("A. Person"), "CameraOwnerName"),
        ("exif", 37510, (7, b"ASCII\0\0\0A. Person"), "UserComment"),
        ("gps", 2, (5, [51, 1, 30, 1, 0, 1]), "GPS"),
        ("gps", 28, (7, b"ASCII\0\0\0Kensington"), "GPS"),
    ],
)
def test_each_field_that_may_name_a_person_is_reported_by_its_name_alone(
    tmp_path, where, tag, value, name
):
    parts = {"picture": dict(NIKON), "exif": dict(CAMERA), "gps": {0: (1, [2, 3, 0, 0])}}
    parts[where][tag] = value
    found = read(tmp_path, tiff(parts["picture"], parts["exif"], parts["gps"]))
    assert found.private == (name,)
    assert "Person" not in repr(found)


@pytest.mark.parametrize(
    ("make", "description", "private"),
    [
        ("OLYMPUS IMAGING CORP.", "OLYMPUS DIGITAL CAMERA         ", ()),
        ("SONY", "SONY DSC", ()),
        ("SONY", "SONY DSC of A. Person", ("ImageDescription",)),
    ],
)
def test_a_description_that_a_maker_writes_itself_names_nobody(
    tmp_path, make, description, private
):
    picture = NIKON | {270: words(description), 271: words(make)}
    assert read(tmp_path, tiff(picture, CAMERA)).private == private


def test_empty_fields_as_cameras_write_them_are_not_private(tmp_path):
    blank = {315: words(" " * 36), 33432: words(" " * 54), 40093: (1, b"\0\0")}
    exif = CAMERA | {37510: (7, b"ASCII\0\0\0" + b" " * 36), 42032: words("")}
    gps = {0: (1, [2, 3, 0, 0])}
    assert read(tmp_path, tiff(NIKON | blank, exif, gps)).private == ()


@pytest.mark.parametrize(
    ("packet", "names"),
    [
        (b"<dc:creator><rdf:Seq><rdf:li>A. Person</rdf:li></rdf:Seq></dc:creator>", "XMP creator"),
        (b'<rdf:Description aux:OwnerName="A. Person"/>', "XMP OwnerName"),
        (b'<rdf:Description exif:GPSLatitude="51,30N"/>', "XMP GPS"),
        (b"<dc:rights><rdf:Alt><rdf:li>x</rdf:li></rdf:Alt></dc:rights>", "XMP rights"),
        (b'<dc:creator></dc:creator><r xmp:Rating="0" aux:OwnerName=""/>', None),
        (b"<dc:creator><rdf:Seq></rdf:Seq></dc:creator>", None),
    ],
)
def test_names_in_an_xmp_packet_are_reported(tmp_path, packet, names):
    found = read(tmp_path, tiff(NIKON | {700: (1, packet)}, dict(CAMERA)))
    assert found.private == (() if names is None else (names,))


def without_serial():
    return {tag: value for tag, value in CAMERA.items() if tag != 42033}


def test_a_nikons_serial_is_read_from_its_own_note(tmp_path):
    note = b"Nikon\0\x02\x10\0\0" + tiff({0x1D: words("6077777")}, order=">")
    exif = without_serial() | {37500: (7, note)}
    assert read(tmp_path, tiff(NIKON, exif)).serial == "6077777"


def test_a_canons_serial_and_owner_are_read_from_its_own_note(tmp_path):
    # The note's places count from the file's begin: four bytes and fewer need none.
    note = directory({0x0C: (4, [123456]), 9: words("Ann")}, 0, "<")
    exif = without_serial() | {37500: (7, note)}
    found = read(tmp_path, tiff({271: words("Canon")}, exif))
    assert (found.serial, found.private) == ("123456", ("Canon OwnerName",))


def box(kind, content):
    return struct.pack(">I4s", 8 + len(content), kind) + content


def test_a_cr3_tells_from_its_header_boxes(tmp_path):
    uuid = bytes.fromhex("85c0b687820f11e08111f4ce462b6a48")
    # Each part is a TIFF of its own.
    parts = box(b"CMT1", tiff({271: words("Canon"), 272: words("EOS R5"), 315: words("P")}))
    parts += box(b"CMT2", tiff(dict(CAMERA))) + box(b"CMT4", tiff({2: (5, [51, 1])}))
    moov = box(b"moov", box(b"uuid", uuid + box(b"CNCV", b"x" * 30) + parts))
    picture = struct.pack(">I4sQ", 1, b"mdat", 16 + 100) + bytes(100)
    found = read(tmp_path, box(b"ftyp", b"crx \0\0\0\1crx isom") + moov + picture)
    assert (found.model, found.serial, found.iso) == ("EOS R5", "6012345", 400)
    assert found.private == ("Artist", "GPS")


def test_a_raf_tells_from_its_preview(tmp_path):
    app0 = b"\xff\xe0" + struct.pack(">H", 16) + b"JFIF\0" + bytes(9)
    inner = b"Exif\0\0" + tiff({271: words("FUJIFILM")}, dict(CAMERA))
    jpeg = b"\xff\xd8" + app0 + b"\xff\xe1" + struct.pack(">H", 2 + len(inner)) + inner
    head = b"FUJIFILMCCD-RAW 0201".ljust(84, b"\0") + struct.pack(">II", 160, len(jpeg))
    found = read(tmp_path, head.ljust(160, b"\0") + jpeg + b"\xff\xda" + bytes(99))
    assert (found.make, found.serial, found.f_number) == ("FUJIFILM", "6012345", 8.0)


@pytest.mark.parametrize("data", [b"", b"II*\0", b"\x76\x2f\x31\x01rest", b"no photograph at all"])
def test_what_has_no_headers_shows_nothing(tmp_path, data):
    assert read(tmp_path, data) == Exif()


def test_numbers_without_meaning_are_left_out(tmp_path):
    exif = CAMERA | {33434: (5, [1, 0]), 33437: (5, [0, 1]), 36867: words("2026:13:99 25:61:61")}
    found = read(tmp_path, tiff(NIKON, exif))
    assert (found.exposure_s, found.f_number, found.taken) == (None, None, None)


def test_reading_touches_headers_only(tmp_path):
    path = tmp_path / "large.dng"
    data = tiff(NIKON | {273: (4, [10_000]), 279: (4, [50_000_000])}, dict(CAMERA))
    with path.open("wb") as file:
        file.write(data)
        file.truncate(60_000_000_000)  # reading it all would never end
    assert read_exif(path).serial == "6012345"


def test_directories_in_a_ring_end(tmp_path):
    ring = b"II*\0" + struct.pack("<IHI", 8, 0, 8)
    assert read(tmp_path, ring) == Exif()


GOOD = tiff(
    NIKON | {700: (1, b'<r aux:OwnerName="A"/>'), 315: words("A. Person")},
    CAMERA | {37500: (7, b"Nikon\0\x02\x10\0\0" + tiff({0x1D: words("1")}))},
    {2: (5, [51, 1, 30, 1, 0, 1])},
)


@pytest.fixture(scope="module")
def scratch(tmp_path_factory):
    return tmp_path_factory.mktemp("exif")


@given(st.lists(st.tuples(st.integers(0, len(GOOD) - 1), st.binary(min_size=1, max_size=6))))
def test_changed_bytes_never_crash_a_reader_nor_hold_it(scratch, changes):
    data = bytearray(GOOD)
    for place, new in changes:
        data[place : place + len(new)] = new
    found = read(scratch, bytes(data))
    assert found.iso is None or found.iso > 0
    assert found.exposure_s is None or 0 < found.exposure_s < float("inf")


@given(
    st.sampled_from([b"II*\0\x08\0\0\0", b"MM\0*\0\0\0\x08", b"\0\0\0\x18ftypcrx \0\0\0\0",
                     b"FUJIFILMCCD-RAW 0201".ljust(84, b"\0") + b"\0\0\0\x60" + bytes(8)]),
    st.binary(max_size=600),
)  # fmt: skip
def test_noise_behind_a_known_head_never_crashes_a_reader(scratch, head, noise):
    assert isinstance(read(scratch, head + noise), Exif)


@given(st.integers(0, len(GOOD)))
def test_every_truncation_is_read_as_far_as_it_goes(scratch, size):
    found = read(scratch, GOOD[:size])
    assert found.serial in ("6012345", "1", None)
