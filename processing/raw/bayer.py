"""The demosaic's rows: compiled, one thread, buffers of eight rows each that stay in the cache.

Every loop runs over one row without a branch, so that it is vectorised. Row r of a buffer is at
r modulo eight.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from lightstage.formats.half import half_bits

REACH = 6
"""Pixels around a window that its colours are taken from."""
CLIP_REACH = 2
"""Pixels this near to a clipped count are marked: they have taken most of their colour from it."""
NOISE = 0.002
"""Share of white below which differences along rows and along columns count as equally rough."""
STRIP_PX = 1024
"""Columns that are done at a time, so that all buffers stay in the processor's cache."""
SIDE = 8
"""Columns beside a strip that are loaded with it, and pixels around a window that flats reach."""
_LAST = 7  # row & _LAST is a row's place in a ring
_LAST_MARKS = 15


@njit(cache=True, nogil=True)
def develop(
    counts: np.ndarray,
    origin: tuple[int, int],
    size: tuple[int, int],
    window: tuple[int, int, int, int],
    colours: np.ndarray,
    black: np.ndarray,
    gain: np.ndarray,
    limit: np.ndarray,
    coefficients: np.ndarray,
    bent: bool,
    flat: np.ndarray,
    ambient: np.ndarray,
    out: np.ndarray,
    clipped: np.ndarray,
) -> None:
    """See `develop_mosaic` for shapes; `window` is top, left, height, width.

    `out` is (h, w, 3) uint16, the halves' bits; `colours` .. `coefficients` are Development's.
    """
    top, left, height, width = window
    for start in range(0, width, STRIP_PX):
        columns = min(STRIP_PX, width - start)
        wide = columns + 2 * SIDE
        first = left + start - SIDE
        levels, bits = _row_levels(colours, black, gain, limit, first, wide)
        x = np.zeros((8, wide), np.float32)
        along, across = np.zeros_like(x), np.zeros_like(x)
        rough_along, rough_across = np.zeros_like(x), np.zeros_like(x)
        raw_across, green, chroma = np.zeros_like(x), np.zeros_like(x), np.zeros_like(x)
        marks = np.zeros((2 * len(x), wide), np.uint8)  # they wait longer: a larger ring
        line, rgb = np.zeros(wide, np.float32), np.zeros((3, columns), np.float32)
        line_marks = np.zeros(wide, np.uint8)
        for r in range(top - REACH, top + height + REACH):
            k = r & _LAST
            source = counts[origin[0] + _mirrored(r, size[0])]
            _load(source, origin[1], size[1], first, levels[r & 1], bits[r & 1], x[k], line_marks)
            _spread(line_marks, marks[r & _LAST_MARKS])
            if flat.size > 0:
                row = _mirrored(r, size[0]) - max(top - SIDE, 0)
                _flatten(flat[row], max(left - SIDE, 0), size[1], first, x[k])
            y = r - 2
            k = y & _LAST
            sign = levels[y & 1, 3]
            _difference_along(x[k], sign, line)
            _smooth_along(line, along[k], rough_along[k])
            _difference_across(x, y, sign, raw_across[k])
            y = r - 4
            _smooth_across(raw_across, y, across[y & _LAST], rough_across[y & _LAST])
            y = r - 5
            k = y & _LAST
            _weigh(along[k], across[k], rough_along, rough_across, y, line)
            _fill(x[k], line, levels[y & 1, 4], green[k], chroma[k])
            y = r - REACH
            if y < top:
                continue
            red_row = colours[y & 1, 0] == 0 or colours[y & 1, 1] == 0
            _three_colours(green, chroma, y, red_row, rgb)
            _correct(rgb, coefficients, bent)
            if ambient.size > 0:
                _subtract(ambient[y - top, start : start + columns], rgb)
            _store(rgb, out[y - top, start : start + columns])
            _mark(marks, y, clipped[y - top, start : start + columns])


@njit(cache=True, nogil=True)
def _mirrored(i: int, n: int) -> int:
    """An index beyond the picture to the one inside of the same colour, as a mirror shows it."""
    while i < 0 or i >= n:
        i = -i if i < 0 else 2 * n - 2 - i
    return i


@njit(cache=True, nogil=True)
def _row_levels(
    colours: np.ndarray,
    black: np.ndarray,
    gain: np.ndarray,
    limit: np.ndarray,
    first: int,
    wide: int,
) -> tuple[np.ndarray, np.ndarray]:
    """For even and odd rows: black, gain, limit, +1 on green and -1, 1 off green; clip bits."""
    out, bits = np.zeros((2, 5, wide), np.float32), np.zeros((2, wide), np.uint8)
    for row in range(2):
        for i in range(wide):
            column = (first + i) & 1
            colour = colours[row, column]
            out[row, 0, i] = black[row, column]
            out[row, 1, i] = gain[row, column]
            out[row, 2, i] = limit[row, column]
            out[row, 3, i] = 1 if colour == 1 else -1
            out[row, 4, i] = 0 if colour == 1 else 1
            bits[row, i] = 1 << colour
    return out, bits


@njit(cache=True, nogil=True)
def _load(
    source: np.ndarray,
    offset: int,
    size: int,
    first: int,
    levels: np.ndarray,
    bits: np.ndarray,
    x: np.ndarray,
    marks: np.ndarray,
) -> None:
    """A row of counts to linear values and clip bits, mirrored at the picture's sides."""
    wide = len(x)
    low, high = max(0, -first), min(wide, size - first)
    inside = source[offset + first + low : offset + first + high]
    black, gain, limit = levels[0, low:high], levels[1, low:high], levels[2, low:high]
    row, row_marks, row_bits = x[low:high], marks[low:high], bits[low:high]
    for i in range(len(row)):
        row[i] = (np.float32(inside[i]) - black[i]) * gain[i]
    for i in range(len(row_marks)):
        row_marks[i] = row_bits[i] * np.uint8(np.float32(inside[i]) >= limit[i])
    for i in range(low):
        x[i] = x[_mirrored(first + i, size) - first]
        marks[i] = 0
    for i in range(high, wide):
        x[i] = x[_mirrored(first + i, size) - first]
        marks[i] = 0


@njit(cache=True, nogil=True)
def _spread(marks: np.ndarray, out: np.ndarray) -> None:
    """Clip bits of a row, spread by `CLIP_REACH` to each side."""
    n = len(out) - 4
    a, b, c, d, e = marks[:n], marks[1 : n + 1], marks[2 : n + 2], marks[3 : n + 3], marks[4:]
    inner = out[2 : n + 2]
    for i in range(len(inner)):
        inner[i] = a[i] | b[i] | c[i] | d[i] | e[i]


@njit(cache=True, nogil=True)
def _flatten(gains: np.ndarray, left: int, size: int, first: int, x: np.ndarray) -> None:
    """Multiply a row by gains that begin at the picture's column `left`, mirrored at its sides."""
    low, high = max(0, -first), min(len(x), size - first)
    inside, row = gains[first + low - left : first + high - left], x[low:high]
    for i in range(len(row)):
        row[i] *= inside[i]
    for i in range(low):
        x[i] *= gains[_mirrored(first + i, size) - left]
    for i in range(high, len(x)):
        x[i] *= gains[_mirrored(first + i, size) - left]


@njit(cache=True, nogil=True, fastmath={"contract"}, error_model="numpy")
def _difference_along(x: np.ndarray, sign: np.ndarray, out: np.ndarray) -> None:
    """Green minus the row's other colour, from the row alone."""
    n = len(out) - 4
    a, b, c, d, e = x[:n], x[1 : n + 1], x[2 : n + 2], x[3 : n + 3], x[4:]
    inner, signs = out[2 : n + 2], sign[2 : n + 2]
    for i in range(len(inner)):
        other = np.float32(0.5) * (c[i] + b[i] + d[i]) - np.float32(0.25) * (a[i] + e[i])
        inner[i] = signs[i] * (c[i] - other)


@njit(cache=True, nogil=True, fastmath={"contract"}, error_model="numpy")
def _difference_across(x: np.ndarray, y: int, sign: np.ndarray, out: np.ndarray) -> None:
    """Green minus the column's other colour, from the column alone."""
    a, b, c = x[(y - 2) & _LAST], x[(y - 1) & _LAST], x[y & _LAST]
    d, e = x[(y + 1) & _LAST], x[(y + 2) & _LAST]
    for i in range(len(out)):
        other = np.float32(0.5) * (c[i] + b[i] + d[i]) - np.float32(0.25) * (a[i] + e[i])
        out[i] = sign[i] * (c[i] - other)


@njit(cache=True, nogil=True, fastmath={"contract"}, error_model="numpy")
def _smooth_along(line: np.ndarray, out: np.ndarray, rough: np.ndarray) -> None:
    """Binomial smoothing of differences, and the square of what it takes away."""
    n = len(out) - 4
    a, b, c, d, e = line[:n], line[1 : n + 1], line[2 : n + 2], line[3 : n + 3], line[4:]
    inner, lost = out[2 : n + 2], rough[2 : n + 2]
    for i in range(len(inner)):
        smooth = np.float32(0.375) * c[i] + np.float32(0.25) * (b[i] + d[i])
        smooth += np.float32(0.0625) * (a[i] + e[i])
        inner[i] = smooth
    for i in range(len(lost)):
        lost[i] = (c[i] - inner[i]) * (c[i] - inner[i])


@njit(cache=True, nogil=True, fastmath={"contract"}, error_model="numpy")
def _smooth_across(lines: np.ndarray, y: int, out: np.ndarray, rough: np.ndarray) -> None:
    """The same along columns."""
    a, b, c = lines[(y - 2) & _LAST], lines[(y - 1) & _LAST], lines[y & _LAST]
    d, e = lines[(y + 1) & _LAST], lines[(y + 2) & _LAST]
    for i in range(len(out)):
        smooth = np.float32(0.375) * c[i] + np.float32(0.25) * (b[i] + d[i])
        smooth += np.float32(0.0625) * (a[i] + e[i])
        out[i] = smooth
    for i in range(len(rough)):
        rough[i] = (c[i] - out[i]) * (c[i] - out[i])


@njit(cache=True, nogil=True, fastmath={"contract"}, error_model="numpy")
def _roughness(rough: np.ndarray, y: int, out: np.ndarray) -> None:
    """Mean over a pixel and its four neighbours, and what noise makes."""
    n = len(out) - 2
    a, e = rough[(y - 1) & _LAST][1 : n + 1], rough[(y + 1) & _LAST][1 : n + 1]
    row = rough[y & _LAST]
    b, c, d = row[:n], row[1 : n + 1], row[2:]
    inner = out[1 : n + 1]
    for i in range(len(inner)):
        total = a[i] + e[i] + (b[i] + c[i] + d[i])
        inner[i] = np.float32(0.2) * total + np.float32(NOISE * NOISE)


@njit(cache=True, nogil=True, fastmath={"contract"}, error_model="numpy")
def _weigh(
    along: np.ndarray,
    across: np.ndarray,
    rough_along: np.ndarray,
    rough_across: np.ndarray,
    y: int,
    out: np.ndarray,
) -> None:
    """Differences along and across, each weighed by how smooth it is."""
    one, other = np.ones_like(out), np.ones_like(out)
    _roughness(rough_along, y, one)
    _roughness(rough_across, y, other)
    for i in range(len(out)):
        share = other[i] / (one[i] + other[i])
        out[i] = across[i] + share * (along[i] - across[i])


@njit(cache=True, nogil=True, fastmath={"contract"}, error_model="numpy")
def _fill(
    x: np.ndarray,
    difference: np.ndarray,
    coloured: np.ndarray,
    green: np.ndarray,
    chroma: np.ndarray,
) -> None:
    """Green everywhere in a row, and its difference to the row's other colour everywhere."""
    for i in range(len(x)):
        difference[i] *= coloured[i]
        green[i] = x[i] + difference[i]
    # Where the other colour was measured its difference is known; between, the mean of two.
    n = len(x) - 2
    before, here, after = difference[:n], difference[1 : n + 1], difference[2:]
    inner = chroma[1 : n + 1]
    for i in range(len(inner)):
        inner[i] = here[i] + np.float32(0.5) * (before[i] + after[i])


@njit(cache=True, nogil=True, fastmath={"contract"}, error_model="numpy")
def _three_colours(
    green: np.ndarray, chroma: np.ndarray, y: int, red_row: bool, rgb: np.ndarray
) -> None:
    """Red, green and blue of a row; a row without the one colour takes it from those beside it."""
    own, other = (rgb[0], rgb[2]) if red_row else (rgb[2], rgb[0])
    before, here, after = chroma[(y - 1) & _LAST], chroma[y & _LAST], chroma[(y + 1) & _LAST]
    level, middle = green[y & _LAST], rgb[1]
    for i in range(len(own)):
        own[i] = level[i + SIDE] - here[i + SIDE]
        middle[i] = level[i + SIDE]
    for i in range(len(other)):
        mean = np.float32(0.5) * (before[i + SIDE] + after[i + SIDE])
        other[i] = level[i + SIDE] - mean


@njit(cache=True, nogil=True, fastmath={"contract"}, error_model="numpy")
def _correct(rgb: np.ndarray, m: np.ndarray, bent: bool) -> None:
    """The sensor's colours to linear rgb, in place."""
    red, green, blue = rgb[0], rgb[1], rgb[2]
    zero = np.float32(0)
    if bent:
        for i in range(rgb.shape[1]):
            r, g, b = red[i], green[i], blue[i]
            rg = np.sqrt(max(r, zero) * max(g, zero))
            gb = np.sqrt(max(g, zero) * max(b, zero))
            rb = np.sqrt(max(r, zero) * max(b, zero))
            red[i] = m[0, 0] * r + m[0, 1] * g + m[0, 2] * b
            red[i] += m[0, 3] * rg + m[0, 4] * gb + m[0, 5] * rb
            green[i] = m[1, 0] * r + m[1, 1] * g + m[1, 2] * b
            green[i] += m[1, 3] * rg + m[1, 4] * gb + m[1, 5] * rb
            blue[i] = m[2, 0] * r + m[2, 1] * g + m[2, 2] * b
            blue[i] += m[2, 3] * rg + m[2, 4] * gb + m[2, 5] * rb
        return
    for i in range(rgb.shape[1]):
        r, g, b = red[i], green[i], blue[i]
        red[i] = m[0, 0] * r + m[0, 1] * g + m[0, 2] * b
        green[i] = m[1, 0] * r + m[1, 1] * g + m[1, 2] * b
        blue[i] = m[2, 0] * r + m[2, 1] * g + m[2, 2] * b


@njit(cache=True, nogil=True)
def _subtract(ambient: np.ndarray, rgb: np.ndarray) -> None:
    for i in range(rgb.shape[1]):
        for c in range(3):
            rgb[c, i] -= ambient[i, c]


@njit(cache=True, nogil=True)
def _store(rgb: np.ndarray, out: np.ndarray) -> None:
    """Three rows to interleaved half floats."""
    red, green, blue = rgb[0], rgb[1], rgb[2]
    for i in range(len(out)):
        out[i, 0] = half_bits(red[i])
        out[i, 1] = half_bits(green[i])
        out[i, 2] = half_bits(blue[i])


@njit(cache=True, nogil=True)
def _mark(marks: np.ndarray, y: int, clipped: np.ndarray) -> None:
    """Add the clip bits of five rows."""
    k = _LAST_MARKS
    a, b, c = marks[(y - 2) & k], marks[(y - 1) & k], marks[y & k]
    d, e = marks[(y + 1) & k], marks[(y + 2) & k]
    for i in range(len(clipped)):
        clipped[i] |= a[i + SIDE] | b[i + SIDE] | c[i + SIDE] | d[i + SIDE] | e[i + SIDE]
