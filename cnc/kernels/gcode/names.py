"""Names in a text, each with an index. Capital and small letters are equal."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.jit import njit

Bytes = NDArray[np.uint8]
Counts = NDArray[np.int32]

_A, _Z, _LOWER = 65, 90, 32
_HASH_MASK = (1 << 40) - 1


class Names(NamedTuple):
    """Different names of parameters in a text.

    Attributes:
        begin: (names,) position of the first byte.
        end: (names,) position after the last byte.
        table: (a power of two,) hash table of indices of names, -1 for none.
        used: (1,) number of names.
    """

    begin: Counts
    end: Counts
    table: Counts
    used: Counts


@njit
def index_of_name(data: Bytes, begin: int, end: int, names: Names) -> int:
    """Return the index of a name, which is added if it is new; -1 if the arrays are full."""
    mixed = 0
    for i in range(begin, end):
        char = int(data[i])
        if _A <= char <= _Z:
            char |= _LOWER
        mixed = ((mixed ^ char) * 16777619) & _HASH_MASK
    places = len(names.table)
    at = (mixed ^ (mixed >> 17)) & (places - 1)
    while names.table[at] >= 0:
        known = int(names.table[at])
        first = int(names.begin[known])
        same = int(names.end[known]) - first == end - begin
        i = 0
        while same and i < end - begin:
            a, b = int(data[first + i]), int(data[begin + i])
            if a != b:
                a = a | _LOWER if _A <= a <= _Z else a
                b = b | _LOWER if _A <= b <= _Z else b
                same = a == b
            i += 1
        if same:
            return known
        at = (at + 1) & (places - 1)
    new = int(names.used[0])
    if new == len(names.begin):
        return -1
    names.table[at] = new
    names.begin[new] = begin
    names.end[new] = end
    names.used[0] = new + 1
    return new
