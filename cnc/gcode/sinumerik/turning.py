"""SINUMERIK's turning cycles: stock removal CYCLE95, threads CYCLE97 and CYCLE98.

Grooves and undercuts are in :mod:`cnc.gcode.sinumerik.grooves`.

MID, FALX, FAL, TDEP and VRT are radii. Diameters of threads are diameters, in every mode. The cycle
begins at any position from which its start can be reached. Source: Siemens, "SINUMERIK 840D sl/828D
Programming Manual, Cycles" and "SINUMERIK 808D Programming and Operating Manual, Turning, Part 2",
turning cycles.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

from cnc.gcode.core.call_stack import Flow, Listing
from cnc.gcode.reader.statements import Statement
from cnc.gcode.reader.words import Word
from cnc.gcode.sinumerik.cycles import COARSE, TurningValues
from cnc.gcode.sinumerik.flow import how_it_begins, labelled, subprogram
from cnc.gcode.sinumerik.grooves import Groove, Undercut
from cnc.gcode.turning.codes import MOST_PASSES
from cnc.gcode.turning.cycles import TurningCycles
from cnc.gcode.turning.moves import Helix, TurningMoves
from cnc.gcode.turning.profiles import (
    MOST_LINES,
    ProfileCycles,
    ProfileLine,
    offset_profile,
    path_of,
)
from cnc.gcode.turning.roughing import (
    TINY,
    Cut,
    Piece,
    Profile,
    Roughing,
    Traverse,
    TurningStep,
    View,
    highest,
    is_monotone,
    profile_of,
    rough,
)
from cnc.gcode.turning.threads import TurningThreads, turns_per_second
from cnc.model.blocks import Dwell, Polyline
from cnc.model.diagnostics import CncError

_NAMES = {
    "93": "SPD SPL WIDG DIAG STA1 ANG1 ANG2 RCO1 RCO2 RCI1 RCI2 FAL1 FAL2 IDEP DTB VARI VRT DN",
    "94": "SPD SPL FORM VARI",
    "95": "NPP MID FALZ FALX FAL FF1 FF2 FF3 VARI DT DAM VRT",
    "96": "DIATH SPL FORM VARI",
    "97": "PIT MPIT SPL FPL DM1 DM2 APP ROP TDEP FAL IANG NSP NRC NID VARI NUMT VRT",
    "98": "PO1 DM1 PO2 DM2 PO3 DM3 PO4 DM4 APP ROP TDEP FAL IANG NSP NRC NID PP1 PP2 PP3 VARI"
    " NUMT VRT",
}
"""Arguments of each cycle in their order. Later ones must be 0 or left out."""
_NO_PATH = frozenset("TSMDHL")
_NO_PATH_CODES = frozenset((17.0, 18.0, 19.0, 40.0, 41.0, 42.0, 60.0, 64.0, 94.0, 95.0, 96.0, 97.0))
_IDLE = ("s-end", "s-proc")
"""Control lines that a contour passes over."""
_ROUNDING = 1e-9


class TurningCycle(TurningValues):
    """A line with a turning cycle."""

    __slots__ = ("moves",)

    def run(self, flow: Flow, line: int) -> int:
        """Make the cycle; go on with the next line."""
        interpreter, kind = flow.interpreter, str(self.control.label)
        interpreter.here.line = line
        interpreter.begun = True
        self.flow = flow
        turning = interpreter.turning_cycles
        if turning is None:
            hint = 'set kind = "lathe" under [machine] of the machine file'
            raise self.fault("code-not-supported", " is for a lathe", hint)
        self.compute(flow, _NAMES[kind])
        self.moves = turning.moves
        self.moves.check(self.word)
        state = interpreter.modal
        before = state.motion, state.feed
        if kind == "95":
            _Contour(self, turning, line).make()
        elif kind == "93":
            Groove(self, turning).make()
        elif kind in ("94", "96"):
            Undercut(self, turning).make()
        else:
            _Threads(self).make()
        state = interpreter.modal
        state.motion, state.feed = before
        interpreter.update_plain()
        return line + 1


# Stock removal: CYCLE95.


class _Kind(NamedTuple):
    """VARI: whether the passes are along Z, the stock is outside, and what is made."""

    along_z: bool
    outside: bool
    roughs: bool
    finishes: bool


class _Contour:
    """CYCLE95: passes along Z or X down to a contour, and a finishing pass.

    The passes of a section have the same depth, which is MID at most. Each goes straight to the
    contour, follows it to the depth before, and lifts off by VRT in both axes. Sections below the
    ends of the contour come last; the tool enters them along the contour, with FF2. FALX, FALZ
    and, at right angles to the contour, FAL stay for the finish. The stock ends at the highest
    point of the contour.
    """

    def __init__(self, cycle: TurningCycle, turning: TurningCycles, line: int) -> None:
        self.cycle, self.line = cycle, line
        self.moves: TurningMoves = turning.moves
        self.maker = ProfileCycles(turning)
        number = cycle.whole("VARI", 1, 212)
        number, rounds = number % 200, number < 200
        if not 1 <= number <= 12 or not rounds:
            message = ": VARI is 1 to 12; that without rounding (201 to 212) is not supported"
            raise cycle.fault("code-not-supported", message)
        part = number - 1
        self.kind = _Kind(part % 2 == 0, part % 4 < 2, not 4 <= part < 8, part >= 4)

    def make(self) -> None:
        """Make the cycle, from the position and back to its start."""
        cycle, moves = self.cycle, self.moves
        start = list(moves.motion.position)
        self._feed("FF1" if self.kind.roughs else "FF3")
        blocks = path_of(cycle.flow.interpreter, self._lines(), self.line)
        if len(blocks) < 2 and not (
            blocks and isinstance(blocks[0], Polyline) and len(blocks[0].points) > 1
        ):
            raise cycle.fault("profile-empty", ": the contour has no move")
        z, x = moves.columns
        columns = (z, x) if self.kind.along_z else (x, z)
        across = -1 if self.kind.along_z and not self.kind.outside else 1
        view = View(columns, (1, across), z_along=self.kind.along_z)
        body = profile_of(blocks, start, view)[1:]
        if not body:
            raise cycle.fault("profile-empty", ": the contour has one point only")
        rises = body[-1].end.imag >= body[0].start.imag
        if rises or not self.kind.roughs:
            forwards = body[-1].end.real >= body[0].start.real
            body = body if forwards else [_mirrored(piece) for piece in body]
        else:
            forwards = body[-1].end.real < body[0].start.real
            body = [replace(piece, start=piece.end, end=piece.start, spin=-piece.spin)
                    for piece in reversed(body)]  # fmt: skip
            body = body if forwards else [_mirrored(piece) for piece in body]
        view = replace(view, mirror=(1 if forwards else -1, across))
        if not is_monotone((body[0].start.real, *(piece.end.real for piece in body))):
            axis = "Z" if self.kind.along_z else "X"
            hint = "let it go in one direction"
            raise cycle.fault(
                "profile-not-monotone", f": the contour turns back along {axis}", hint
            )
        self._perform(body, view)

    def _perform(self, body: Profile, view: View) -> None:
        cycle, moves = self.cycle, self.moves
        top, lead = highest(body), cycle.lift
        allowed = cycle.size("FALZ"), cycle.size("FALX")
        along, up = allowed if self.kind.along_z else allowed[::-1]
        rest = self._with_allowance(body, along, up)
        here = view.point(moves.motion.position)
        if here.imag < min(piece.start.imag for piece in body) - TINY:
            hint = "start the cycle on the side of the stock"
            raise cycle.fault("profile-start", ": the tool is behind the contour", hint)
        clear = max(top, highest(rest)) + lead
        with moves.context.exact_path():
            start = complex(min(rest[0].start.real, body[0].start.real) - lead, clear)
            for to in (complex(here.real, max(here.imag, clear)), complex(start.real,
                       max(here.imag, clear)), start):  # fmt: skip
                self._step(Traverse(to), view)
            if self.kind.roughs:
                self._rough(rest, view, start)
            if self.kind.finishes:
                self._finish(body, view, start)

    def _rough(self, rest: Profile, view: View, start: complex) -> None:
        cycle = self.cycle
        depth = cycle.size("MID")
        if not depth:
            raise cycle.fault("cycle-word-missing", " needs MID, the largest depth of a pass")
        top = highest(rest)
        first = complex(start.real, rest[0].start.imag)
        ahead = [Piece(complex(start.real, top), first), Piece(first, rest[0].start)]
        profile = [piece for piece in ahead if abs(piece.end - piece.start) > TINY] + rest
        plan = Roughing(
            profile, 0j, depth, cycle.lift, pockets=True, even=True, clearance=start.imag - top
        )
        if plan.passes > MOST_PASSES:
            raise cycle.fault("cycle-too-long", f" makes more than {MOST_PASSES} passes")
        for step in rough(plan):
            falls = isinstance(step, Cut) and step.piece.end.imag < step.piece.start.imag - TINY
            self._feed("FF2" if falls and cycle.get("FF2", 0.0) else "FF1")
            self._step(step, view)

    def _finish(self, body: Profile, view: View, start: complex) -> None:
        """Follow the contour, lift off and return."""
        self._feed("FF3")
        before = complex(start.real, body[0].start.imag)
        self._step(Traverse(before), view)
        self._step(Cut(Piece(before, body[0].start)), view)
        for piece in body:
            self._step(Cut(piece), view)
        self._step(Traverse(complex(body[-1].end.real, start.imag)), view)
        self._step(Traverse(start), view)

    def _feed(self, name: str) -> None:
        """Put a feed into effect; without it that of the program stays."""
        interpreter = self.cycle.flow.interpreter
        if (feed := self.cycle.get(name)) > 0.0:
            interpreter.execute(Statement((Word("F", feed, f"F{feed:g}", 1, 1),)), self.line)

    def _step(self, step: TurningStep, view: View) -> None:
        """Make a step; a pass that is longer than DAM stops each time for DT seconds."""
        length, wait = self.cycle.size("DAM"), self.cycle.get("DT")
        parts = [step]
        if isinstance(step, Cut) and length and wait > 0.0 and step.piece.center is None:
            begin, end = step.piece.start, step.piece.end
            count = math.ceil(abs(end - begin) / length - _ROUNDING)
            if abs(end.imag - begin.imag) <= TINY and 1 < count <= MOST_PASSES:
                way = (end - begin) / abs(end - begin) * length
                places = [*(begin + number * way for number in range(count)), end]
                parts = [Cut(Piece(a, b)) for a, b in pairwise(places)]
        for number, part in enumerate(parts):
            if number:
                here = self.moves.here
                self.moves.out.add(Dwell(here.file, here.line, wait))
            self.maker.make_step(part, view, self.cycle.word, rapid_in=True)

    def _with_allowance(self, body: Profile, along: float, up: float) -> Profile:
        """Return the contour with its allowances: walls shift away from the part on both sides."""
        profile = offset_profile(body, self.cycle.size("FAL"), self.cycle.word)
        shifts: list[float] = []
        for piece in profile:
            rise = piece.end.imag - piece.start.imag
            level = shifts[-1] if shifts else -along
            shifts.append(level if abs(rise) <= TINY else math.copysign(along, -rise))
        rest: Profile = []
        for number, piece in enumerate(profile):
            is_level = abs(piece.end.imag - piece.start.imag) <= TINY
            here = complex(shifts[number], up)
            after = complex(shifts[min(number + 1, len(shifts) - 1)], up) if is_level else here
            if rest and abs(rest[-1].end - (piece.start + here)) > TINY:
                if rest[-1].end.real > piece.start.real + shifts[number]:
                    raise self._too_narrow()
                rest.append(Piece(rest[-1].end, piece.start + here))
            if is_level and piece.end.real + after.real < piece.start.real + here.real - TINY:
                raise self._too_narrow()
            if is_level and piece.center is None:
                rest.append(Piece(piece.start + here, piece.end + after))
            else:
                rest.append(piece.shifted(here))
        return rest

    def _too_narrow(self) -> CncError:
        message = ": the allowance does not fit into a relief cut of the contour"
        return self.cycle.fault("allowance-in-pocket", message, "give a smaller FALZ or FALX")

    def _lines(self) -> Iterator[ProfileLine]:
        """Yield the lines of the contour: those of a subprogram, or between two labels."""
        cycle, flow = self.cycle, self.cycle.flow
        if not cycle.control.names:
            raise cycle.fault("cycle-word-missing", " needs NPP, the name of the contour in quotes")
        name = str(cycle.control.names[0])
        first, colon, last = name.partition(":")
        if colon:
            begin, end = (self._label(flow.listing, label) for label in (first, last))
            listing, inclusive = flow.listing, True
        else:
            listing, begin = self._subprogram(name)
            end, inclusive = begin + MOST_LINES, False
        for number in range(begin if inclusive else begin + 1, end + 1):
            if listing.page(number) is None:
                return
            statement = listing.statement_at(number)
            if statement is None:
                continue
            control = statement.control
            ends = control is not None and control.keyword == "s-end"
            if not inclusive and (statement.percent or ends):
                return
            if statement.percent or (control is not None and control.keyword not in _IDLE):
                message = f": line {number} of the contour is no move"
                raise cycle.fault("profile-line", message, "contours have no jumps and calls")
            if control is None and statement.words:
                yield ProfileLine(number, _moves_of(statement))
        if not inclusive:
            raise cycle.fault("profile-too-long", f": the contour has over {MOST_LINES} lines")

    def _label(self, listing: Listing, label: str) -> int:
        line = next(labelled(listing, label, 1), 0)
        if not line:
            hint = "write the label and a colon first in the target line"
            raise self.cycle.fault("jump-target-missing", f": there is no {label}:", hint)
        return line

    def _subprogram(self, name: str) -> tuple[Listing, int]:
        flow = self.cycle.flow
        if found := subprogram(flow, name, self.cycle.at):
            return found
        message = f": there is no subprogram {name} with the contour"
        hint = how_it_begins(name)
        if next(labelled(flow.listing, name, 1), 0):
            hint = f'{name} is a label: give the first and the last one, such as "{name}:END"'
        raise self.cycle.fault("sub-unknown", message, hint)


def _mirrored(piece: Piece) -> Piece:
    """Return a piece with its direction along reversed."""
    center = None if piece.center is None else -piece.center.conjugate()
    return Piece(-piece.start.conjugate(), -piece.end.conjugate(), center, -piece.spin)


def _moves_of(statement: Statement) -> Statement:
    """A line of a contour without tools, speeds, compensation and machine codes."""
    computed = dict(statement.computed)
    kept = (
        index
        for index, word in enumerate(statement.words)
        if word.letter not in _NO_PATH
        and (word.letter != "G" or index in computed or word.number not in _NO_PATH_CODES)
    )
    return replace(statement.with_words(kept), remarks=())


# Threads: CYCLE97 (one section) and CYCLE98 (a chain of three).


class _Section(NamedTuple):
    """A part of a thread: its end, z and x (radius) of the crest, and its lead, mm."""

    z: float
    x: float
    lead: float


class _Threads:
    """CYCLE97 and CYCLE98.

    NRC passes take the depth without the allowance FAL, each the same depth (VARI 1 and 2) or the
    same area (3 and 4). One pass takes the allowance, and NID more have no infeed. The tool moves
    in along a flank by IANG, on both flanks in turn if it is negative; the last pass begins at the
    start of the run-in, and those before it farther back. A start angle is made by a start farther
    back, since a turn of the spindle is one lead.
    """

    def __init__(self, cycle: TurningCycle) -> None:
        self.cycle = cycle
        self.scale = cycle.flow.interpreter.modal.scale
        kind = cycle.whole("VARI", 1, 4)
        self.inward = -1.0 if kind in (1, 3) else 1.0
        self.shrinks = kind > 2
        self.depth, self.allowance = cycle.size("TDEP"), cycle.size("FAL")
        if not self.depth > self.allowance:
            raise cycle.fault("value-out-of-range", ": TDEP, the depth, must be more than FAL")
        self.angle = math.radians(cycle.get("IANG", 0.0))
        if not abs(self.angle) < math.radians(60.0):
            raise cycle.fault("value-out-of-range", ": IANG must be from -60 to 60 degrees")

    def make(self) -> None:
        """Make all passes of all starts, and end at the start of the run-in."""
        cycle = self.cycle
        threads = TurningThreads(cycle.moves)
        turns = turns_per_second(cycle.moves.context, cycle.word.written, cycle.word)
        start, sections = self._sections()
        ahead = math.copysign(1.0, sections[-1].z - start[0])
        crests = [start[1], *(section.x for section in sections)]
        outermost = min(crests) if self.inward > 0.0 else max(crests)
        clear = outermost - self.inward * cycle.lift
        if min(crests) <= 0.0 or clear < 0.0:
            raise cycle.fault("value-out-of-range", ": the diameters must be more than 0")
        count, moves = cycle.whole("NUMT", 0, MOST_PASSES, 1.0) or 1, cycle.moves
        starts = [(cycle.get("NSP", 0.0) / 360.0 + k / count) % 1.0 for k in range(count)]
        depths = list(self._depths())
        with moves.context.exact_path():
            z, x = moves.place
            back = start[0] - ahead * (starts[0] * sections[0].lead + self._flank(depths[0], 0))
            if (x - clear) * self.inward > 0.0:
                moves.rapid(z, clear)
            moves.rapid(back, moves.place[1])
            moves.context.add_overrides(feed=False, spindle=False)
            for turn in starts:
                for number, depth in enumerate(depths):
                    flank = -ahead * self._flank(depth, number)
                    begin = start[0] + flank - ahead * turn * sections[0].lead
                    slope = (sections[0].x - start[1]) / (sections[0].z - start[0])
                    crest = begin, start[1] + slope * (begin - flank - start[0])
                    moved = [*(part._replace(z=part.z + flank) for part in sections[:-1]),
                             sections[-1]]  # fmt: skip
                    self._pass(threads, [_Section(*crest, 0.0), *moved], (depth, clear), turns)
            moves.context.add_overrides()

    def _flank(self, depth: float, number: int) -> float:
        """How far before the place of the last pass one begins, along the thread."""
        shift = (self.depth - depth) * math.tan(abs(self.angle))
        return -shift if self.angle < 0.0 and number % 2 else shift

    def _depths(self) -> Iterator[float]:
        """Yield the depth of each pass below the crest."""
        count = self.cycle.whole("NRC", 1, MOST_PASSES)
        rough = self.depth - self.allowance
        for number in range(1, count + 1):
            share = number / count
            yield rough * (math.sqrt(share) if self.shrinks else share)
        for _ in range(self.cycle.whole("NID", 0, MOST_PASSES, 0.0) + (self.allowance > 0.0)):
            yield self.depth

    def _pass(
        self,
        threads: TurningThreads,
        crest: list[_Section],
        infeed: tuple[float, float],
        turns: float,
    ) -> None:
        """One pass along the crest and back; ``infeed`` is its depth, and a clear x."""
        (depth, clear), moves = infeed, self.cycle.moves
        begin, *parts = [part._replace(x=part.x + self.inward * depth) for part in crest]
        moves.rapid(begin.z, clear)
        here = begin.z, begin.x
        moves.rapid(*here)
        for z, x, lead in parts:
            threads.follow(here, (z, x), Helix(lead, turns))
            here = z, x
        threads.context.end_follow()
        moves.rapid(here[0], clear)
        moves.rapid(begin.z, clear)

    def _sections(self) -> tuple[tuple[float, float], list[_Section]]:
        """Return the start of the run-in, z and x of the crest, and the sections to the end."""
        cycle, scale = self.cycle, self.scale
        if cycle.control.label == "97":
            names, leads = [("SPL", "DM1"), ("FPL", "DM2")], [self._lead()]
        else:
            names = [(f"PO{k}", f"DM{k}") for k in (1, 2, 3, 4)]
            leads = [abs(cycle.needs(f"PP{k}", "the lead")) * scale for k in (1, 2, 3)]
        places = [
            (cycle.needs(z, "a place along Z") * scale, cycle.needs(x, "a diameter") * scale / 2.0)
            for z, x in names
        ]
        ways = [b[0] - a[0] for a, b in pairwise(places)]
        if not min(leads) > 0.0:
            raise cycle.fault("pitch-missing", " needs a lead above 0")
        if min(ways) <= 0.0 <= max(ways):
            raise cycle.fault("thread-length", ": the places do not go in one direction along Z")
        ahead = math.copysign(1.0, ways[0])
        first = _beyond(places[1], places[0], -ahead * cycle.size("APP"))
        last = _beyond(places[-2], places[-1], ahead * cycle.size("ROP"))
        ends = [*places[1:-1], last]
        return first, [_Section(*end, lead) for end, lead in zip(ends, leads, strict=True)]

    def _lead(self) -> float:
        """The lead: PIT, or that of the size MPIT of a metric thread."""
        cycle, size = self.cycle, self.cycle.get("MPIT")
        if lead := cycle.size("PIT"):
            return lead
        if size not in COARSE:
            raise cycle.fault("pitch-missing", " needs PIT, the lead, or MPIT, the size")
        return float(COARSE[int(size)])


def _beyond(a: tuple[float, float], b: tuple[float, float], distance: float) -> tuple[float, float]:
    """Return the point beyond b on the line from a, at a distance along Z with its sign."""
    return b[0] + distance, b[1] + distance * (b[1] - a[1]) / (b[0] - a[0])
