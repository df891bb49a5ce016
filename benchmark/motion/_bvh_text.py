"""Numbers as text, many at a time: the counterpart of :mod:`benchmark.motion._bvh_numbers`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Decimals of a value that was computed rather than read: 1e-8 degrees are 1.7e-10 rad.
DECIMALS = 8

# A value is laid out in 16 bytes, two words: separator, sign, five digits, point; eight decimals. Bytes left zero are
# squeezed out at the end.
_LARGEST = 1e5
_BLOCK = 1 << 14
_WORD = np.uint64


def format_rows(values: NDArray[np.float64]) -> bytes:
    """Text of the rows of ``values`` (T, C), blank-separated, a newline after each row.

    Every value is written with as few decimals as give it back exactly when read: up to eight by whole-array
    operations, others one by one in the shortest form that is exact.
    """
    columns = values.shape[1]
    rows = max(1, _BLOCK // columns)
    return b"".join(_format_block(values[at : at + rows]) for at in range(0, len(values), rows))


def _format_block(values: NDArray[np.float64]) -> bytes:
    rows, columns = values.shape
    flat = np.ascontiguousarray(values).reshape(-1)
    size = np.abs(flat)
    small = size < _LARGEST
    if not small.all():
        size = np.where(small, size, 0.0)
    scaled = np.rint(size * 10.0**DECIMALS)
    exact = (scaled / 10.0**DECIMALS == size) & small
    whole = scaled.astype(np.uint64)
    units = whole // _WORD(10**DECIMALS)
    decimals = whole - units * _WORD(10**DECIMALS)

    slots = np.zeros((len(flat), 2), "<u8")
    word = _eight_digits(decimals)
    smear = word | word >> _WORD(8)
    smear |= smear >> _WORD(16)
    smear |= smear >> _WORD(32)
    kept = _nonzero_bytes(smear)  # up to the last digit that is not zero
    slots[:, 1] = word + kept * _WORD(0x30)
    point = (kept & _WORD(1)) * _WORD(ord("."))
    # Five digits of eight, moved down one byte to make room for the point; the last is always shown.
    word = _eight_digits(units) >> _WORD(8)
    smear = word | word << _WORD(8)
    smear |= smear << _WORD(16)
    smear |= smear << _WORD(32)
    shown = (_nonzero_bytes(smear) | _WORD(1 << 48)) & _WORD(0x0001010101010000)
    word += shown * _WORD(0x30)
    word |= point << _WORD(56)
    word |= np.signbit(flat).astype(np.uint64) * _WORD(ord("-") << 8)
    word |= _WORD(ord(" "))
    slots[:, 0] = word
    separators = slots.view(np.uint8).reshape(rows, columns, 16)
    separators[:, 0, 0] = 0
    text = separators
    if not exact.all():
        text = _with_exceptions(text, flat, np.flatnonzero(~exact))
    lines = np.zeros((rows, text.shape[1] * text.shape[2] + 1), np.uint8)
    lines[:, :-1] = text.reshape(rows, -1)
    lines[:, -1] = ord("\n")
    return lines.tobytes().translate(None, b"\0")


def _with_exceptions(text: NDArray[np.uint8], flat: NDArray[np.float64], which: NDArray) -> NDArray[np.uint8]:
    rows, columns, width = text.shape
    written = np.array([repr(float(value)).removesuffix(".0").encode() for value in flat[which]], dtype=np.bytes_)
    length = written.dtype.itemsize
    wide = np.zeros((rows * columns, max(width, 1 + length)), np.uint8)
    wide[:, :width] = text.reshape(-1, width)
    wide[which, 1:] = 0
    wide[which, 1 : 1 + length] = written.view(np.uint8).reshape(-1, length)
    return wide.reshape(rows, columns, -1)


def _nonzero_bytes(word: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """1 in each byte that is not zero; bytes must be below 128."""
    return ((word + _WORD(0x7F7F7F7F7F7F7F7F)) >> _WORD(7)) & _WORD(0x0101010101010101)


def _eight_digits(number: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Decimal digits of numbers below 10**8, one a byte, the first in the lowest byte.

    Halves, then quarters, then single digits are split off in all lanes at once; division by 100 and by 10 is a
    multiplication and a shift, exact below 10**4 and 10**2.
    """
    high = number // _WORD(10000)
    word = high | (number - high * _WORD(10000)) << _WORD(32)
    high = ((word * _WORD(5243)) >> _WORD(19)) & _WORD(0x0000007F0000007F)
    word = high | (word - high * _WORD(100)) << _WORD(16)
    high = ((word * _WORD(103)) >> _WORD(10)) & _WORD(0x000F000F000F000F)
    return high | (word - high * _WORD(10)) << _WORD(8)
