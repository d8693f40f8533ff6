"""SINUMERIK's drilling cycles CYCLE81, CYCLE82 and CYCLE83, once or after each move (MCALL).

The arguments are RTP (return plane), RFP (reference plane), SDIS (safety distance), DP (depth) or
DPR (depth from the reference plane); then DTB (dwell, s) of CYCLE82, and FDEP or FDPR (first depth)
and DAM (degression) of CYCLE83. All are absolute, whatever the distance mode. Source: Siemens,
"SINUMERIK 840D sl/828D Programming Manual, Cycles", drilling.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from cnc.gcode.program.call_stack import Flow
from cnc.gcode.program.line_index import Place
from cnc.gcode.syntax.statement import Control, Statement
from cnc.gcode.syntax.words import Word

MOST_PECKS = 10_000
"""Most pecks of a hole. More are a typing error."""
_END = 0
_ROUNDING = 1e-9


class Cycle:
    """A line with a cycle. Its arguments are computed when the line is executed."""

    __slots__ = ("at", "control", "modal")

    def __init__(self, line: int, control: Control) -> None:
        self.at = Place(line, control.column, control.length)
        self.control = control
        self.modal = control.keyword == "mcall"

    def run(self, flow: Flow, line: int) -> int:
        """Make the cycle, or keep it for the moves after this line."""
        assert isinstance(self.control.label, str)
        kind = int(self.control.label)
        flow.interpreter.begun = True
        if kind == _END:
            flow.modal = None
            return line + 1
        heights = [value(flow.parameters) for value in self.control.values]
        moves = list(self._moves(flow, kind, heights))
        if not self.modal:
            return _perform(flow, moves, line)
        flow.modal = None
        flow.begin_modal(lambda after: _perform(flow, moves, after))
        return line + 1

    def _moves(self, flow: Flow, kind: int, given: list[float]) -> Iterator[str]:
        """Yield the moves of the cycle as words: a code and a height, or a dwell."""
        names = ("RTP", "RFP", "SDIS", "DP", "DPR")
        known = dict(zip(names, [*given, *[math.nan] * 5], strict=False))
        more = [*given[5:], *[math.nan] * 8]
        back, top, safe = (known[name] for name in names[:3])
        depth = known["DP"]
        if depth != depth:
            depth = top - abs(known["DPR"])
        if any(value != value for value in (back, top, safe, depth)):
            message = f"CYCLE{kind} needs RTP, RFP, SDIS, and DP or DPR"
            raise flow.listing.fault(self.at, "cycle-word-missing", message)
        start = top + abs(safe)
        if depth > start or back < start - _ROUNDING:
            message = f"CYCLE{kind}: the return plane, start and depth are not in this order"
            raise flow.listing.fault(self.at, "cycle-retract-below-bottom", message)
        yield f"G0 Z{start:.9f}"
        if kind == 83:
            yield from self._pecks(flow, top, start, depth, more)
        else:
            yield f"G1 Z{depth:.9f}"
        if kind == 82 and more[0] == more[0] and more[0] > 0.0:
            yield f"G4 F{more[0]:.9f}"
        yield f"G0 Z{back:.9f}"

    def _pecks(
        self, flow: Flow, top: float, start: float, depth: float, more: list[float]
    ) -> Iterator[str]:
        """Yield the pecks of CYCLE83, each with a retraction out of the hole."""
        first = more[0] if more[0] == more[0] else top - abs(more[1])
        if first != first or first >= top:
            message = "CYCLE83 needs FDEP or FDPR, the first depth"
            raise flow.listing.fault(self.at, "cycle-word-missing", message)
        peck, less = top - first, 0.0 if more[2] != more[2] else abs(more[2])
        at, count = first, 0
        while True:
            reached = max(at, depth)
            yield f"G1 Z{reached:.9f}"
            if reached <= depth + _ROUNDING:
                return
            yield f"G0 Z{start:.9f}"
            yield f"G0 Z{reached + min(peck, abs(start - top) or peck) / 2.0:.9f}"
            peck = max(peck - less, less) if less else peck
            at -= peck
            count += 1
            if count > MOST_PECKS:
                message = f"CYCLE83 makes more than {MOST_PECKS} pecks"
                raise flow.listing.fault(self.at, "cycle-too-long", message)


def _perform(flow: Flow, moves: list[str], line: int) -> int:
    """Make the moves, and restore the modes that the cycle changes."""
    interpreter = flow.interpreter
    modal = interpreter.modal
    motion, absolute = modal.motion, modal.absolute
    for move in ("G90", *moves):
        words = tuple(Word(text[0], float(text[1:]), text, 1, 1) for text in move.split())
        try:
            interpreter.execute(Statement(words), line)
        finally:
            modal.absolute = absolute if move == moves[-1] else modal.absolute
    modal.motion = motion
    return line + 1


def _maker(_: Flow, line: int, control: Control) -> Cycle:
    return Cycle(line, control)


MAKERS = {"cycle": _maker, "mcall": _maker}
