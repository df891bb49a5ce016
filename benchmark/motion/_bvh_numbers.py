"""The numbers of a BVH motion block, read many at a time.

The vectorised reader splits a block of text at white space with whole-array operations and converts digits eight at a
time: eight ASCII digits sit in one 64-bit word, and three multiplications add up neighbours, then pairs, then fours. Each
value is an exact integer divided by an exact power of ten, hence correctly rounded (Clinger 1990, *How to read floating
point numbers accurately*, fast path). It either explains every byte of the block or declines; the plain reader then goes
through the block line by line and finds the exact fault, or reads what was merely unusual.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import MotionFileError
from benchmark.motion._bvh_fixed import read_fixed

#: Bytes of padding after the text, so that a word may be loaded at any byte of it.
PADDING = 16

#: A block of this many bytes keeps its temporaries within a core's own cache.
BLOCK = 1 << 18

#: Larger values in either direction are refused: no angle or length of a motion is, and sums of squares must not overflow.
LARGEST = 1e12

_NUMBER = re.compile(rb"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")

_WORD = np.uint64
_INT_POWERS = 10 ** np.arange(19, dtype=np.int64)
_POWERS = 10.0 ** np.arange(23)
_EXACT = 1 << 53
_NONE = np.empty(0, np.int64)
_WHITE = np.zeros(33, np.bool_)
_WHITE[[9, 10, 13, 32]] = True
_SPACE, _NEWLINE, _PLUS, _MINUS, _DOT, _ZERO = 32, 10, 43, 45, 46, 48


def number_in(token: bytes) -> float | None:
    """The value of a decimal number of at most :data:`LARGEST`; ``nan``, ``inf``, ``1_0`` and ``0x1`` are none."""
    value = float(token) if _NUMBER.fullmatch(token) else np.inf
    return value if abs(value) <= LARGEST else None


def read_values(
    text: bytearray,
    start: int,
    stop: int,
    out: NDArray[np.float64],
    *,
    path: Path,
    line: int,
    names: list[str],
    block: int = BLOCK,
) -> int:
    """Read rows of numbers, one line each, from ``text[start:stop]`` into ``out``.

    Parameters
    ----------
    text
        The file, ending in a newline at ``stop - 1`` and followed by :data:`PADDING` bytes of anything.
    start, stop
        Where the rows are. Blank lines count for nothing.
    out
        (T, C) array to fill.
    path, line, names
        The file, the 1-based number of the first line, and what each column is, for messages.
    block
        Bytes handled at a time.

    Returns
    -------
    int
        How many rows there were; ``out`` is filled when it is T.

    Raises
    ------
    MotionFileError
        Names the line and, where it is a single value, the column.
    """
    frames, columns = out.shape
    words = np.ndarray(len(text) - 7, "<u8", text, 0, (1,))
    longest = 1024 + 256 * columns
    row = declined = 0
    first = start

    def line_at(place: int) -> int:
        return line + text.count(b"\n", first, place)

    while start < stop:
        end = _block_end(text, start, stop, block, longest)
        if end < 0:
            raise MotionFileError(
                path,
                f"a line of more than {longest} bytes where a row of {columns} values was expected",
                line=line_at(start),
            )
        values = None
        if declined < 2:
            values = read_fixed(bytes(memoryview(text)[start:end]), columns)
            declined = 0 if values is not None else declined + 1
        if values is None:
            values = _read_fast(text, words, start, end, columns)
        if values is None:
            values = _read_plain(bytes(text[start:end]), columns, path, line_at(start), names)
        rows = len(values)
        if row + rows > frames:
            surplus = _line_of_row(text, start, line_at(start), frames - row)
            raise MotionFileError(path, f"a row beyond the {frames} announced by 'Frames:'", line=surplus)
        out[row : row + rows] = values
        row += rows
        start = end
    return row


def _block_end(text: bytearray, start: int, stop: int, block: int, longest: int) -> int:
    """End of the last whole line within ``block`` bytes, or of the first where that is longer; -1 beyond ``longest``."""
    if start + block >= stop:
        end = stop
    else:
        end = text.rfind(b"\n", start, start + block) + 1
        if end == 0:
            end = text.find(b"\n", start + block, start + block + longest) + 1
            if end == 0:
                return -1
    return end


def _line_of_row(text: bytearray, start: int, line: int, row: int) -> int:
    """Line number of the ``row``-th (from 0) line that is not blank, from ``start`` on."""
    while True:
        end = text.find(b"\n", start)
        if text[start:end].strip():
            if row == 0:
                return line
            row -= 1
        start, line = end + 1, line + 1


def _read_fast(text: bytearray, words: NDArray, start: int, end: int, columns: int) -> NDArray[np.float64] | None:
    """(rows, columns) values of a block of whole lines, or ``None`` where anything about it is out of the ordinary."""
    data = np.frombuffer(text, np.uint8, end - start, start)
    # Exclusive-or with 2 brings '-' next to the digits, so one comparison finds everything that is neither.
    special = data ^ 2
    special -= 0x2F
    places = np.flatnonzero(special > 0x0C)
    kinds = data[places]
    spaces = np.flatnonzero(kinds <= _SPACE)
    ends = places[spaces]
    starts = np.empty_like(ends)
    starts[0] = 0
    np.add(ends[:-1], 1, out=starts[1:])
    filled = ends > starts
    separators = kinds[spaces]
    if not _WHITE[separators].all():
        return None
    newlines = np.flatnonzero(separators == _NEWLINE)
    if filled.all():
        per_line = newlines + np.int64(1)
    else:
        per_line = np.asarray(np.cumsum(filled)[newlines], np.int64)
        starts, ends, spaces = starts[filled], ends[filled], spaces[filled]
    count = len(ends)
    rows = count // columns
    if not np.array_equal(per_line[np.diff(per_line, prepend=0) > 0], columns * np.arange(1, rows + 1)):
        return None
    if count == 0:
        return np.empty((0, columns))

    preceding = places[spaces - 1]
    before = kinds[spaces - 1]  # the last special character ahead of the token's end; wraps to the end for the first
    dotted = (before == _DOT) & (preceding >= starts)
    points = preceding if dotted.all() else np.where(dotted, preceding, ends)
    # Bytes that are no digits, each of which must be accounted for below.
    odd = len(data) - len(separators) - int(np.count_nonzero(data - np.uint8(_ZERO) < 10))

    tails = ends
    exponents = None
    if int(dotted.sum()) + len(separators) != len(places):
        found = _exponents(data, places, kinds, starts, ends, points)
        if found is None:
            return None
        tails, points, exponents, explained = found
        odd -= explained
    negative = data[starts] == _MINUS
    odd -= int(negative.sum()) + int((points < tails).sum())
    if odd != 0:
        return None
    starts = starts + negative
    whole_digits = points - starts
    fraction_digits = tails - points
    fraction_digits -= 1
    fewest = int(fraction_digits.min())
    if fewest < 0:
        fraction_digits = np.maximum(fraction_digits, 0)
    most = int(fraction_digits.max())
    digits = whole_digits + fraction_digits
    if digits.min() < 1:
        return None

    wide = _NONE
    if most > 8 or whole_digits.max() > 8:
        wide = np.flatnonzero((whole_digits > 8) | (fraction_digits > 8))
    # Most files print every value with the same number of decimals: then the powers of ten need no look-up.
    fraction = most if fewest == most <= 8 else np.minimum(fraction_digits, 8) if most > 8 else fraction_digits
    mantissa = _digits(words, starts + start, np.minimum(whole_digits, 8) if len(wide) else whole_digits)
    mantissa *= _INT_POWERS[fraction]
    mantissa += _digits(words, points + (start + 1), fraction)
    values = mantissa.astype(np.float64)
    values /= _POWERS[fraction]
    exceptional = []
    if digits.max() > 15:
        exceptional.append(np.flatnonzero(mantissa >= _EXACT))
    if len(wide):
        fits = (whole_digits[wide] <= 8) & (fraction_digits[wide] <= 16) & (digits[wide] <= 18)
        exceptional.append(wide[~fits])
        wide = wide[fits]
        long = fraction_digits[wide]
        lower = _digits(words, points[wide] + (start + 1), 8) * _INT_POWERS[long - 8]
        lower += _digits(words, points[wide] + (start + 9), long - 8)
        exact = _digits(words, starts[wide] + start, whole_digits[wide]) * _INT_POWERS[long] + lower
        values[wide] = exact / _POWERS[long]
        mantissa[wide] = exact
        exceptional.append(wide[exact >= _EXACT])
    if exponents is not None:
        which, powers = exponents
        scale = powers - fraction_digits[which]
        narrow = (np.abs(scale) <= 22) & (mantissa[which] < _EXACT)
        exceptional.append(which[~narrow])
        near = which[narrow]
        factor = _POWERS[np.abs(scale[narrow])]
        exact_mantissa = mantissa[near].astype(np.float64)
        values[near] = np.where(scale[narrow] < 0, exact_mantissa / factor, exact_mantissa * factor)
    np.negative(values, out=values, where=negative)
    if exceptional:
        which = np.concatenate(exceptional)
        block = data.tobytes()
        bounds = zip((starts - negative)[which].tolist(), ends[which].tolist(), strict=True)
        values[which] = [float(block[first:last]) for first, last in bounds]
    if not max(values.max(), -values.min()) <= LARGEST:
        return None
    return values.reshape(rows, columns)


def _exponents(
    data: NDArray[np.uint8], places: NDArray, kinds: NDArray, starts: NDArray, ends: NDArray, points: NDArray
) -> tuple[NDArray, NDArray, tuple[NDArray, NDArray], int] | None:
    """Where mantissas end, given exponents; ``None`` where the block holds anything but plain exponents.

    Returns
    -------
    tails, points, (which, powers), explained
        End of each mantissa, its decimal point (or end), the tokens that have an exponent with its value, and how many
        bytes that are no digits the exponents account for.
    """
    marks = places[(kinds == 101) | (kinds == 69)]
    plus = places[kinds == _PLUS]
    which = np.searchsorted(ends, marks)
    if len(marks) == 0 or np.any(np.diff(which) == 0) or np.any(marks < starts[which]):
        return None
    tails = ends.copy()
    tails[which] = marks
    dots = places[kinds == _DOT]
    owner = np.searchsorted(ends, dots)
    if np.any(np.diff(owner) == 0) or np.any(dots > tails[owner]):
        return None
    points = tails.copy()
    points[owner] = dots
    sign = data[marks + 1]
    signed = (sign == _MINUS) | (sign == _PLUS)
    if int((sign == _PLUS).sum()) != len(plus):
        return None
    first = marks + 1 + signed
    length = ends[which] - first
    if length.min() < 1 or length.max() > 3:
        return None
    powers = np.zeros(len(marks), np.int64)
    for place in range(3):
        inside = place < length
        digit = data[np.minimum(first + place, len(data) - 1)].astype(np.int64) - _ZERO
        powers = np.where(inside, 10 * powers + digit, powers)
    powers = np.where(sign == _MINUS, -powers, powers)
    return tails, points, (which, powers), len(marks) + int(signed.sum())


def _digits(words: NDArray, places: NDArray, count: NDArray | int) -> NDArray[np.int64]:
    """Integers written by ``count`` (0 to 8) ASCII digits at ``places``."""
    word = words[places]
    word &= _WORD(0x0F0F0F0F0F0F0F0F)
    # The last digit goes to the highest byte; zeros come in below it, where the leading digits are.
    word <<= _WORD(64 - 8 * count) if isinstance(count, int) else (64 - 8 * count).view(_WORD)
    word *= _WORD(10 * 2**8 + 1)
    word >>= _WORD(8)
    word &= _WORD(0x00FF00FF00FF00FF)
    word *= _WORD(100 * 2**16 + 1)
    word >>= _WORD(16)
    word &= _WORD(0x0000FFFF0000FFFF)
    word *= _WORD(10000 * 2**32 + 1)
    word >>= _WORD(32)
    return word.view(np.int64)


def _read_plain(block: bytes, columns: int, path: Path, line: int, names: list[str]) -> NDArray[np.float64]:
    """As :func:`_read_fast`, a line at a time, raising at the first fault."""
    longest = 1024 + 256 * columns
    rows = []
    for number, content in enumerate(block.split(b"\n"), line):
        if len(content) > longest:
            raise MotionFileError(
                path, f"a line of {len(content)} bytes where a row of {columns} values was expected", line=number
            )
        tokens = content.split()
        if not tokens:
            continue
        row = []
        for column, token in enumerate(tokens[:columns]):
            value = number_in(token)
            if value is None:
                shown = token[:40].decode("utf-8", "backslashreplace")
                raise MotionFileError(
                    path,
                    f"{shown!r} is not a number of at most {LARGEST:g} (value {column + 1}, {names[column]})",
                    line=number,
                )
            row.append(value)
        if len(tokens) != columns:
            raise MotionFileError(path, f"{len(tokens)} values where the hierarchy has {columns} channels", line=number)
        rows.append(row)
    return np.array(rows, dtype=np.float64).reshape(len(rows), columns)
