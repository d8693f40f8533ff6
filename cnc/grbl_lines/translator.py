"""Translation of a path into lines of G-code for a GRBL 1.1 board.

Arcs stay arcs. All other motion becomes lines and arcs within a tolerance.

    PathChunk ──► PathSampler ──► samples ──► fit_moves ──► LineWriter ──► GcodeLine
    Block ──────► CommandLines ───────────────────────────────────────────►

**Coordinates.** The path is in machine coordinates. GRBL takes these for straight moves only (G53
holds for one line and not for arcs), so lines are in work coordinates with G54 selected. The
Translator must know the offset that the board adds to them:

    work_offset = G54 + G92 + tool length of each axis of the board, mm: the ``WCO`` of a status
    report while G54 is selected.

The first line selects G54, and no line changes an offset, so that WCO stays. A driver asks the
board for these numbers (``$#``, or ``?`` after G54) and has the program read with the same offsets.
Once the first line has been carried out, and before any motion, it compares WCO with
``work_offset``. For a file it is the offset of G54 with which the program was read: the file runs
wherever G54 is set on the part.

**Speed.** The board makes its own ramps and slows down at corners. A straight move of the program
has its feed. A curve has the highest speed at which the axes keep their acceleration and jerk. An F
word stands where the speed differs by more than 5 % from the feed in effect. It never exceeds the
programmed feed. Traverses are G0.

**Short moves.** A board on an AVR reads about 385 lines a second. The program's own moves stay as
they are where that is enough. Elsewhere fewer lines and arcs replace them, but no slower ones.

**Rests.** Where the path rests between two moves (G61.1), G4 P0 makes GRBL come to rest. GRBL also
comes to rest for every line of CommandLines but comments.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from cnc.grbl_lines.board_limits import BoardLimits
from cnc.grbl_lines.grbl_timing import BoardTime
from cnc.grbl_lines.number_format import (
    LETTERS,
    LONGEST,
    PLANE_COLUMNS,
    Move,
    PlaneArc,
    Point,
    board_axes,
    board_letters,
    message_lines,
)
from cnc.grbl_lines.path_samples import (
    Fit,
    PathSampler,
    PathSamples,
    SpeedLimits,
    TravelMargin,
    fit_moves,
)
from cnc.grbl_lines.writer import LineWriter, LoweredFeeds, line_time
from cnc.machine.models import Machine
from cnc.model.blocks import (
    AXIS_LETTERS,
    Abort,
    AnalogOutput,
    AxisLetter,
    Block,
    BoardCommand,
    Coolant,
    DigitalOutput,
    Dwell,
    End,
    Held,
    Message,
    Orient,
    Overrides,
    PathMode,
    Probe,
    Spindle,
    SpindleSync,
    Stop,
    Tool,
    WaitInput,
)
from cnc.model.diagnostics import Diagnostic, GcodeError
from cnc.model.line_effects import MODES, REST, LineEffect, LineKind
from cnc.model.parameter_numbers import G54_ORIGIN
from cnc.model.streams import GcodeLine
from cnc.model.units import decimal_text
from cnc.path.build import exact_path
from cnc.path.chunk import PathChunk

# Lines of GRBL 1.1 for blocks without motion; GcodeError for blocks that GRBL does not support.
#
# GRBL supports G4, M0 to M5, M7 if it was built with mist, M8 and M9 (GRBL 1.1 wiki, "Supported
# G-codes"). A tool change becomes a pause with a message, or M6 where the board waits at it for the
# operator (grblHAL). Blocks that change offsets (G10, G43.1, G92) do not reach this module, because
# positions are machine coordinates.

LONGEST_DWELL = 3000.0
"""s. GRBL counts a dwell in steps of 50 ms by 16 bits, at most 3276 s (``delay_sec`` of
nuts_bolts.c).
"""
Command = tuple[str, LineEffect]


class CommandLines:
    """Writes the lines of blocks without motion, and keeps the state of spindle and coolant.

    Both are unknown at first: an entered line may have started them, and they stay on after it.

    Attributes:
        moved: Whether anything has moved yet.
    """

    def __init__(self, codes: frozenset[str] = frozenset()) -> None:
        """``codes``: M6 and M7, if the board has them; it waits for the operator at M6."""
        self._codes = codes
        self._spindle: str | None = None
        self._rpm = 0.0
        self._coolant: tuple[bool, bool] | None = None
        self.moved = False

    def lines(self, block: Block) -> Iterator[GcodeLine]:
        """Yield the lines of a block; GcodeError for a block that the board does not support."""
        if isinstance(block, BoardCommand):
            # The effect of a command of the board's own is not known.
            yield GcodeLine(self._board_command(block), block.line)
            return
        for text, effect in self._commands(block):
            yield GcodeLine(text, block.line, effect)

    def power(self, block: Block) -> str | None:
        """Return the S word of a command that changes a laser's power in motion.

        Returns:
            None for another block; "" where the power stays.
        """
        if not isinstance(block, Spindle) or not block.with_motion or block.state != self._spindle:
            return None
        changed, self._rpm = block.rpm != self._rpm, block.rpm
        return f"S{decimal_text(block.rpm, 3)}" if changed else ""

    def _commands(self, block: Block) -> Iterator[Command]:
        match block:
            case Message(text=text):
                yield from ((line, MODES) for line in message_lines(text))
            case Dwell(seconds=seconds):
                yield from _dwell(seconds)
            case Spindle():
                yield from self._spindle_commands(block)
            case Coolant():
                yield from self._coolant_commands(block)
            case Tool(change=True) | Stop() | End():
                yield from self._pause_commands(block)
            case SpindleSync(pitch=0.0) | Abort() | Tool() | Overrides() | PathMode() | Held():
                return
            case _:
                raise _unsupported(block)

    def _pause_commands(self, block: Tool | Stop | End) -> Iterator[Command]:
        if isinstance(block, End):
            self._spindle, self._coolant = "off", (False, False)
            yield "M2", REST
        elif isinstance(block, Tool):
            if self._spindle != "off":
                self._spindle = "off"
                yield "M5", REST
            command = f"T{block.number} M6" if "M6" in self._codes else "M0"
            yield f"{command} (MSG, put in tool {block.number}, then resume)", REST
        elif block.optional:
            yield "M1", REST
        else:
            yield "M0 (MSG, change the pallet, then resume)" if block.pallet else "M0", REST

    def _spindle_commands(self, block: Spindle) -> Iterator[Command]:
        if block.surface_speed:
            raise refused(
                block, "constant surface speed (G96)", "program the spindle speed with G97"
            )
        if block.state == "off":
            if self._spindle != "off":
                yield "M5", REST
        elif block.state != self._spindle:
            yield f"{'M3' if block.state == 'cw' else 'M4'} S{decimal_text(block.rpm, 3)}", REST
        elif block.rpm != self._rpm:
            # GRBL comes to rest for a new speed, and with an S that stands alone for a new power.
            yield f"S{decimal_text(block.rpm, 3)}", REST
        self._spindle, self._rpm = block.state, block.rpm

    def _coolant_commands(self, block: Coolant) -> Iterator[Command]:
        if block.mist and "M7" not in self._codes:
            raise refused(block, "mist (M7)", "use M8; GRBL has M7 only if it was built with it")
        wanted = (block.mist, block.flood)
        now = self._coolant
        if now is None:
            now = (False, False) if any(wanted) else (True, True)
        if any(has and not wants for wants, has in zip(wanted, now, strict=True)):
            yield "M9", REST
            now = (False, False)
        if block.mist and not now[0]:
            yield "M7", REST
        if block.flood and not now[1]:
            yield "M8", REST
        self._coolant = wanted

    def _board_command(self, block: BoardCommand) -> str:
        """Return the text of a command of the board's own; GcodeError if it may not be sent."""
        text = block.text
        command = text.replace(" ", "").upper()
        homes = command.startswith("$H")
        if command.startswith("$J") or (homes and self.moved):
            hint = (
                "home before the program starts, and move with G0"
                if homes
                else "move with G0 or G1"
            )
            message = f"{text} moves the board to a position that the program does not know"
            raise GcodeError(
                Diagnostic("board-command-moves", message, block.file, block.line, hint=hint)
            )
        if not text.isascii() or any(c in text for c in "?!~") or len(text) > LONGEST:
            message = (
                f"{text[:LONGEST]} can't be sent: a line has at most {LONGEST} ASCII characters, "
                "without ? ! ~"
            )
            raise GcodeError(Diagnostic("board-command", message, block.file, block.line))
        return text


def _dwell(seconds: float) -> Iterator[Command]:
    while seconds > LONGEST_DWELL:
        yield _dwell_line(LONGEST_DWELL)
        seconds -= LONGEST_DWELL
    yield _dwell_line(seconds)


def _dwell_line(seconds: float) -> Command:
    text = decimal_text(seconds, 3)
    return f"G4 P{text}", LineEffect(LineKind.DWELL, seconds=float(text))


def _unsupported(block: Block) -> GcodeError:
    match block:
        case SpindleSync():
            return refused(
                block,
                "motion that follows the spindle (G33, G76)",
                "use a board with a spindle encoder",
            )
        case Orient():
            return refused(block, "spindle orientation (M19)")
        case DigitalOutput() | AnalogOutput():
            return refused(
                block,
                "outputs (M62 to M68)",
                "use coolant (M8) or spindle speed (S) to switch the device",
            )
        case WaitInput():
            return refused(block, "inputs (M66)")
        case _:
            return refused(block, "command for this line")


def refused(block: Block, feature: str, hint: str = "") -> GcodeError:
    """Return the error for a block that GRBL does not support."""
    return GcodeError(
        Diagnostic(
            "not-on-board", f"a GRBL board has no {feature}", block.file, block.line, hint=hint
        )
    )


def probe_word(probe: Probe) -> str:
    """Return G38.2 to G38.5."""
    return f"G38.{(2 if probe.must else 3) if probe.towards else (4 if probe.must else 5)}"


PREAMBLE = "G21 G90 G94 G17 G54"
SHORT_REST = "G4 P0"
SAMPLING = 0.02
"""Part of the tolerance by which chords between the samples of a curve may deviate from it."""
FITTING = 0.96 - SAMPLING
"""Part of the tolerance by which lines and arcs may be off the samples. The rest is for rounded
numbers and for sums of 32-bit floats.
"""
ARC_TOLERANCE = 0.002
"""mm: GRBL's default for $12."""
JUNCTION_DEVIATION = 0.01
"""mm: GRBL's default for $11."""
SHORT_LINE = 17
"""Characters of a line with two axes."""
SAME_ANGLE = 1e-6
"""Degrees within which a rotary axis stays during a probing move."""
MIN_TOLERANCE = 1e-3
"""mm. The board computes with 32-bit floats, at 300 mm accurate to a hundredth of this."""


class Translator:
    """Translates the items of one path, in their order.

    Raises GcodeError ``not-on-board``, ``axis-not-on-board`` or ``board-command-moves`` at the line
    of a command that GRBL does not support.

    Args:
        machine: The machine file.
        tolerance: Largest distance of the lines from the program, mm; None for ``path.tolerance``
            of the machine. The path is that of :func:`~cnc.path.build.exact_path`.
        work_offset: See the head of this module; None for none.
        arc_tolerance: The board's $12, mm: largest distance of its chords from an arc.
        junction_deviation: The board's $11, mm.
        codes: M6 (the board waits then until the operator resumes) and M7, if it has them.
        margin: Distance of lines from the ends of the travel, mm
            (:mod:`cnc.grbl_lines.path_samples`).
        moving: For a program that may start anywhere: the axes that move in it. A
            traverse names each of them before the first feed move. None for a board that stands at
            the start of the path.
    """

    def __init__(
        self,
        machine: Machine,
        tolerance: float | None = None,
        *,
        work_offset: Sequence[float] | None = None,
        arc_tolerance: float = ARC_TOLERANCE,
        junction_deviation: float = JUNCTION_DEVIATION,
        codes: frozenset[str] = frozenset(),
        margin: float = 0.0,
        moving: str | None = None,
    ) -> None:
        axes = machine.axis_names
        self.tolerance = max(
            machine.path.tolerance if tolerance is None else tolerance, MIN_TOLERANCE
        )
        letters = board_letters(axes)
        named = "".join(letter for letter in letters if letter.lower() in axes)
        self._axes = axes
        self._letters = letters
        self._commands = CommandLines(codes)
        travel = TravelMargin.of(machine, margin)
        self._travel = travel
        self._limits = SpeedLimits.of(machine)
        self._fit = Fit(
            FITTING * self.tolerance,
            arc_tolerance,
            junction_deviation,
            line_time(SHORT_LINE, machine.board.baud),
            travel,
            self._limits,
        )
        self._sampler = PathSampler(
            axes, SAMPLING * self.tolerance, FITTING * self.tolerance, travel, self._limits
        )
        self._writer = LineWriter(
            work_offset or (0.0,) * len(letters),
            self.tolerance,
            machine.board.baud,
            letters,
            named,
            arc_tolerance,
        )
        self._to_name = "" if moving is None else moving.upper()
        self._pending: PathSamples | None = None
        self._begun = False
        self._rests = False
        self._probing: Probe | None = None
        self._assumed: Probe | None = None
        """A probe without an answer, as in a dry run."""
        self._position: Point | None = None
        self._before_probe: dict[str, float] = {}

    @property
    def lowered(self) -> LoweredFeeds:
        """Feeds that the lines so far lower."""
        return self._writer.lowered

    @property
    def position(self) -> dict[str, float] | None:
        """The end of the lines so far for each axis that they move (machine coordinates).

        None where it is not known: before the first move, and after a probe.
        """
        if self._position is None:
            return None
        position = dict(zip(self._letters.lower(), self._position, strict=True))
        return {letter: position[letter] for letter in self._axes if letter in position}

    def lines(self, item: PathChunk | Block) -> Iterator[GcodeLine]:
        """Yield the lines that the next item of the path makes certain.

        The others come with later items, or with :meth:`end`.
        """
        if isinstance(item, PathChunk):
            yield from self._chunk(item)
            return
        if not isinstance(item, Message):
            yield from self.end()
            yield from self._writer.power_alone(item.line)
            self._rests = False
            self._probing = None
        yield from self._begin(item.line)
        if isinstance(item, Probe):
            yield self._probe(item)
            return
        yield from self._commands.lines(item)
        if isinstance(item, BoardCommand):
            self._writer.position_lost()
        elif isinstance(item, End):
            self._writer.program_ended()

    def end(self) -> Iterator[GcodeLine]:
        """Yield the lines that are left."""
        yield from self._moves(whole=True)

    def _begin(self, line: int) -> Iterator[GcodeLine]:
        if not self._begun:
            self._begun = True
            yield GcodeLine(PREAMBLE, line, MODES)

    def _chunk(self, path: PathChunk) -> Iterator[GcodeLine]:
        samples = self._sampler.sample(path)
        if self._probing is not None:
            # The motion of the probe: a single line has been sent for it.
            if samples.rest[-1]:
                self._assumed = self._probing if self._probing.answer.values is None else None
                self._probing = None
            return
        self._pending = (
            samples if self._pending is None else PathSamples.joined(self._pending, samples)
        )
        yield from self._moves(whole=bool(samples.rest[-1]))

    def _moves(self, *, whole: bool) -> Iterator[GcodeLine]:
        """Yield the lines of the pending samples. ``whole``: no more of them will come."""
        samples, self._pending = self._pending, None
        if samples is None:
            return
        first = int(samples.line[0])
        yield from self._begin(first)
        if self._assumed is not None:
            message = (
                f"the probe of line {self._assumed.line} was not made: go on in a dry run only"
            )
            yield GcodeLine(f"M0 (MSG, {message})", first, REST)
            self._assumed = None
        if self._position is None or not self._writer.position_known:
            # The board stands here when nothing has moved; after a probe it may stand a little
            # farther.
            known = self._position is None and not self._commands.moved
            self._position = tuple(samples.points[0].tolist())
            if known:
                self._writer.stands_at(self._position)
        self._commands.moved = True
        moves = list(fit_moves(samples, self._fit))
        if moves and not whole:
            # later samples may continue this move
            self._pending = samples.from_interval(moves.pop().first)
        for plain, run in groupby(moves, self._is_plain):
            if plain and not self._rests and not self._to_name:
                run_moves = list(run)
                yield from self._writer.straights(run_moves)
                self._position = run_moves[-1].end
            else:
                for move in run:
                    yield from self._move(move)

    @staticmethod
    def _is_plain(move: Move) -> bool:
        """Return whether a move is straight, without a command or a rest."""
        return move.arc is None and not move.rests and not move.commands

    def _move(self, move: Move) -> Iterator[GcodeLine]:
        """Yield the lines of one move."""
        writer, arc = self._writer, move.arc
        for block in move.commands:
            power = self._commands.power(block)
            if power is None:
                yield from self._commands.lines(block)
            else:
                writer.set_power(power)
        if self._rests:
            yield GcodeLine(SHORT_REST, move.line, LineEffect(LineKind.DWELL))
        if self._to_name and not math.isnan(move.feed):
            missing, self._to_name = self._to_name, ""
            yield from writer.name_axes(missing, move)
        if arc is not None:
            if not writer.position_known and self._position is not None:
                yield from writer.move(move._replace(end=self._position, arc=None))
            most, length = self._arc_speed(arc, move.end)
            writer.lowered.lowered("small arcs", move.line, length, most, move.feed)
            move = move._replace(speed=min(move.speed, most))
        yield from writer.move(move)
        self._position, self._rests = move.end, move.rests

    def _arc_speed(self, arc: PlaneArc, end: Point) -> tuple[float, float]:
        """Return the highest speed along an arc from the present position, mm/s, and its length.

        A fitted arc may be bent more than the path that it replaces.
        """
        i, j, across = PLANE_COLUMNS[arc.plane]
        radius = math.dist((end[i], end[j]), arc.center)
        climb = 0.0 if self._position is None else end[across] - self._position[across]
        return self._limits.arc(arc, radius, climb)

    def _probe(self, probe: Probe) -> GcodeLine:
        before = self.position or self._before_probe
        for axis, end in zip(self._axes, probe.end.tolist(), strict=True):
            if axis.upper() not in LETTERS and abs(end - before.get(axis, 0.0)) > SAME_ANGLE:
                message = f"a GRBL board probes along X, Y and Z only, not along {axis.upper()}"
                raise GcodeError(Diagnostic("axis-not-on-board", message, probe.file, probe.line))
        ends = dict(zip(self._axes, probe.end.tolist(), strict=True))
        wanted = np.array([[ends.get(letter, 0.0) for letter in self._letters.lower()]])
        end = tuple(self._travel.inside(wanted)[0].tolist())
        self._probing = probe
        self._commands.moved = True
        self._before_probe, self._position = before, None
        return self._writer.probe(probe_word(probe), end, probe.feed, probe.line)


# A whole program as lines: to a file (``--lines``), and the time that they take.


@dataclass(slots=True)
class LineProgram:
    """A program that is translated for any machine of a kind.

    Attributes:
        machine: The machine file.
        start: Position of the machine before the program (axes,), mm.
        parameters: Parameters with which the program is read; lines are relative to their G54.
        extent: Lowest and highest coordinate of each axis in the program, mm.
        lowered: Feeds that the lines lower, once they have been made.
    """

    machine: Machine
    start: NDArray[np.float64]
    parameters: Mapping[int, float]
    extent: Mapping[str, tuple[float, float]]
    lowered: LoweredFeeds = field(default_factory=LoweredFeeds)

    def lines(self, blocks: Iterable[Block]) -> Iterator[GcodeLine]:
        """Yield the lines of a whole program."""
        machine = self.machine
        moving = "".join(
            letter
            for letter in self._letters
            if letter in self.extent and self.extent[letter][0] < self.extent[letter][1]
        )
        translator = Translator(machine, work_offset=self.work_offset, moving=moving)
        self.lowered = translator.lowered
        for item in exact_path(blocks, axes=machine.axis_names, start=self.start):
            yield from translator.lines(item)
        yield from translator.end()

    @property
    def work_offset(self) -> list[float]:
        """Origin of G54 for each axis of the board, mm."""
        return [
            self.parameters.get(G54_ORIGIN + AXIS_LETTERS.index(letter), 0.0)
            for letter in self._letters
        ]

    @property
    def _letters(self) -> tuple[AxisLetter, ...]:
        return board_axes(self.machine.axes)

    def write(self, blocks: Iterable[Block], write: Callable[[str], None] | None) -> BoardTime:
        """Write the lines and return their time.

        Args:
            blocks: The program.
            write: Takes text; None to compute the time only.
        """
        places = dict(zip(self.machine.axis_names, self.start.tolist(), strict=True))
        start = tuple(
            places.get(letter, 0.0) - offset
            for letter, offset in zip(self._letters, self.work_offset, strict=True)
        )
        clock = BoardTime(BoardLimits.of_machine(self.machine), start)
        for line in self.lines(blocks):
            clock.add(line)
            if write is not None:
                write(line.text + "\n")
        clock.end()
        return clock
