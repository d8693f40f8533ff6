"""The lines of a program for compiled code, its control lines and calls, and its progress."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.gcode.statements import Coded, Words

Bytes = NDArray[np.uint8]
Counts = NDArray[np.int32]
Ints = NDArray[np.int64]
Table = NDArray[np.float64]
Flags = NDArray[np.uint8]

Progress = Any

NOWHERE = -(1 << 40)
"""No line."""

PROGRESS = np.dtype(
    [
        ("index", np.int64),
        ("done", np.int64),
        ("executed", np.int64),
        ("new", np.int64),
        ("highest", np.int64),
        ("most_repeated", np.int64),
        ("most_done", np.int64),
        ("begun", np.int64),
        ("last", np.int64),
        ("depth", np.int64),
        ("deepest", np.int64),
        ("marks", np.int64),
        ("scope", np.int64),
        ("returned", np.int64),
        ("value", np.float64),
    ]
)
"""Progress: index of the next line, lines executed in this call and in all, lines executed for the
first time, number of the highest line that was ever executed, the limits of lines that are repeated
and of lines of a call, whether a word was executed, number of the last line that was no control
line (-1 for none), calls within each other, the limit of these,
whether calls of the main program are marked, index of the first line of the subroutine around all
(-1 for none), whether a call or return was executed, and the value of the last return (NaN for
none).
"""


class Control(NamedTuple):
    """What the interpreter knows about the control lines of a text.

    Attributes:
        action: (lines,) actions.
        target: (lines,) index of the line to which each leads.
        other: (lines,) index of the next elseif of an IF (-1 for none), or of the first line of the
            loop that the line ends, or of the subroutine that it ends (-1 for any).
        since: (lines,) number of executed lines when a loop was entered; -1 for not in this call.
        rounds: (lines,) rounds left of a REPEAT; 0 if it was not entered.
        sub: (labels,) index of the first line of each subroutine; -1 for an unknown one.
    """

    action: Bytes
    target: Counts
    other: Counts
    since: Ints
    rounds: Ints
    sub: Counts


class Text(NamedTuple):
    """The lines of a text.

    Attributes:
        line: (lines,) their numbers.
        first: (lines + 1,) index of the first word of each simple line.
        words: The words of simple lines.
        coded: The other lines.
        control: The control lines.
    """

    line: Ints
    first: Counts
    words: Words
    coded: Coded
    control: Control


class Frames(NamedTuple):
    """Calls within each other, and what they restore; n calls, m names of the text.

    Attributes:
        back: (n,) index of the line after the call.
        sub: (n,) index of the first line of the subroutine.
        numbered: (n, LOCAL + 1) local parameters of the caller.
        numbered_changes: (n, LOCAL + 1) their flags.
        slot: (m,) slots of the names that are not global.
        named: (n, m) the caller's values of these names.
        named_changes: (n, m) their flags.
    """

    back: Ints
    sub: Ints
    numbered: Table
    numbered_changes: Flags
    slot: Counts
    named: Table
    named_changes: Flags


class Changes(NamedTuple):
    """Flags of the parameters that were set: by number, and by slot of their name."""

    numbered: Bytes
    named: Bytes
