"""Rows of numbers that all have the same few decimals, as ``%.6f`` prints them: the commonest layout of a motion block.

Counted from its end, such a number has its digits at known places: a *tail* of one digit, the point and the decimals in
one 64-bit word, and in front of it a *front* of up to four characters, sign included, in one 32-bit word. Two loads a
number and arithmetic without branches read it; anything else about the text makes the reader decline.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

# The end of a block: decimals, of which a word can hold six, and what a line ends in beside the newline.
_LAST_NUMBER = re.compile(rb"[0-9]\.([0-9]{1,6})([ \r]*)\n\Z")
_PADDING = b" " * 16

_TAIL, _FRONT = np.uint64, np.uint32
_SIX = 0x0606060606060606
_HIGH = 0xF0F0F0F0F0F0F0F0


def read_fixed(block: bytes, columns: int) -> NDArray[np.float64] | None:
    """(rows, columns) values of a block of whole lines, or ``None`` where its numbers are not all of this kind.

    Numbers must be separated by one blank or tab; a line may end in a blank or a carriage return.
    """
    match = _LAST_NUMBER.search(block, max(0, len(block) - 12))
    if match is None:
        return None
    if match[2]:
        block = block.replace(b"\r\n", b"\n").replace(b" \n", b"\n")
    if b"\t" in block:
        block = block.replace(b"\t", b" ")
    # Blanks in front let every number's tail and front be loaded, the first's included.
    padded = _PADDING + block
    words = np.ndarray(len(padded) - 7, "<u8", padded, 0, (1,))
    halves = np.ndarray(len(padded) - 3, "<u4", padded, 0, (1,))
    data = np.frombuffer(padded, np.uint8, len(block), len(_PADDING))
    return _read(words, halves, data, columns, len(match[1]))


def _read(
    words: NDArray, halves: NDArray, data: NDArray[np.uint8], columns: int, decimals: int
) -> NDArray[np.float64] | None:
    ends = np.flatnonzero(data <= 32)
    count = len(ends)
    rows = count // columns
    if (
        rows * columns != count
        or np.count_nonzero(data == 10) != rows
        or np.count_nonzero(data == 32) != count - rows
        or not (data[ends[columns - 1 :: columns]] == 10).all()
    ):
        return None
    tail_length = decimals + 2
    front_length = np.empty(count, np.int64)
    front_length[0] = ends[0]
    np.subtract(ends[1:], ends[:-1], out=front_length[1:])
    front_length[1:] -= 1
    front_length -= tail_length
    if front_length.min() < 0 or front_length.max() > 4:
        return None

    ends += len(_PADDING) - 8
    tail = words[ends]
    # Zero the bytes ahead of the tail; turn digits into their values and the point into zero.
    tail &= _TAIL((1 << 64) - (1 << (64 - 8 * tail_length)))
    point = 8 * (7 - decimals)
    tail ^= _TAIL((0x3030303030303030 ^ (0x30 ^ 0x2E) << point) & ((1 << 64) - (1 << (64 - 8 * tail_length))))
    if int(np.bitwise_or.reduce(tail | (tail + _TAIL(_SIX)))) & _HIGH:
        return None
    ends += 4 - tail_length
    front = halves[ends]
    front ^= _FRONT(0x30303030)
    front &= _MASKS[front_length]
    # A character that is no digit leaves a fifth bit. It may only come first, and only be '-', which leaves 0x1D.
    sign = front >> _FRONT(4)
    sign &= _FRONT(0x01010101)
    if (sign & _LATER[front_length]).any():
        return None
    negative = sign != 0
    minus = sign * _FRONT(0x1D)
    sign *= _FRONT(0xFF)
    sign &= front
    if not np.array_equal(sign, minus):
        return None
    front -= minus
    if int(np.bitwise_or.reduce(front | (front + _FRONT(_SIX & 0xFFFFFFFF)))) & 0xF0F0F0F0:
        return None

    if not _is_zero_at(tail, point):
        return None
    # The digit ahead of the point moves onto the point's place: u + 255 u = 256 u.
    units = tail & _TAIL(0xFF << (point - 8))
    units *= _TAIL(255)
    tail += units
    for step, (shift, mask) in zip((10, 100, 10000), _MERGES, strict=True):
        tail *= _TAIL(step * (1 << shift) + 1)
        tail >>= _TAIL(shift)
        tail &= _TAIL(mask)
    for step, (shift, mask) in zip((10, 100), _MERGES, strict=False):
        front *= _FRONT(step * (1 << shift) + 1)
        front >>= _FRONT(shift)
        front &= _FRONT(mask & 0xFFFFFFFF)
    values = front * 10.0 ** (decimals + 1)
    values += tail.view(np.int64)
    values /= 10.0**decimals
    np.negative(values, out=values, where=negative)
    return values.reshape(rows, columns)


def _is_zero_at(tail: NDArray[np.uint64], place: int) -> bool:
    return not int(np.bitwise_or.reduce(tail)) >> place & 0xFF


_MERGES = ((8, 0x00FF00FF00FF00FF), (16, 0x0000FFFF0000FFFF), (32, 0x00000000FFFFFFFF))
#: Of four bytes, the last n; and of those all but the first.
_MASKS = np.array([0, 0xFF000000, 0xFFFF0000, 0xFFFFFF00, 0xFFFFFFFF], _FRONT)
_LATER = np.array([0, 0, 0xFF000000, 0xFFFF0000, 0xFFFFFF00], _FRONT)
