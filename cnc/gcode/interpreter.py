"""Words and modal state to canonical blocks.

A line is executed in the order of RS274/NGC, whatever order its words stand in: messages, feed mode, F, S, T, tool change, spindle,
coolant, dwell, plane, units, compensation and length, coordinate system, path control, distance modes, G10 and G92, motion, stop. Every
word must find a user: what is left over is an error, so nothing is ignored. Source: LinuxCNC, "G-code overview", order of execution.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from cnc.canon import Block, Coolant, Dwell, End, Message, PathMode, Spindle, Stop, Tool
from cnc.errors import CncError, Diagnostic, GcodeError
from cnc.gcode import dialects
from cnc.gcode.modal import PLANES, SYSTEMS, Code, Feed, Modal, codes_of
from cnc.gcode.motion import MIN_FEED, Motion
from cnc.gcode.output import Output
from cnc.gcode.parser import MAX_LINE, parse_line
from cnc.gcode.statement import Statement
from cnc.gcode.unused import unused
from cnc.gcode.words import LineWords, Word, fault, not_negative, whole
from cnc.units import MM_PER_INCH, per_second

Warn = Callable[[Diagnostic], None]

MAX_DWELL = 1e6
"""s. What is longer is a slip: it is more than eleven days."""
MAX_TOOL = 99_999


def interpret(
    lines: Iterable[str],
    *,
    file: str,
    axes: tuple[str, ...] = ("x", "y", "z"),
    dialect: str = "auto",
    start: NDArray[np.float64] | None = None,
    block_delete: bool = False,
    warn: Warn | None = None,
) -> Iterator[Block]:
    """The canonical blocks of a program, as its lines are read.

    ``file`` names the program in blocks and errors. ``axes`` are the machine's, in the order of the columns of every position; ``start`` is
    the machine position (axes,) at the start, zeros by default. With ``block_delete`` lines that begin with ``/`` are skipped unread.
    ``warn`` is given what is legal but odd.

    Reading stops at M2, M30 or a second ``%``. Raises GcodeError at the first fault, with file, line, column, source text and hint;
    blocks of the lines before may have been handed on by then. Raises UsageError ``unknown-dialect``.
    """
    position = [0.0] * len(axes) if start is None else [float(value) for value in start]
    program = Interpreter(file, axes, dialects.load(dialect), position, warn)
    ready = program.out.ready
    for number, raw in enumerate(lines, start=1):
        text = raw.removesuffix("\n").removesuffix("\r")
        if block_delete and text.lstrip(" \t").startswith("/"):
            continue
        try:
            program.line(parse_line(text), number, text)
        except GcodeError as error:
            raise _placed(error, file, number, text) from None
        if ready:
            yield from ready
            ready.clear()
        if program.ended:
            return
    try:
        program.end_of_file()
    except GcodeError as error:
        raise error.at(file=file) from None
    yield from ready


def _placed(error: GcodeError, file: str, line: int, text: str) -> CncError:
    """The error with file, line and text, unless it points at an earlier line already."""
    if error.diagnostic.line:
        return error.at(file=file)
    return error.at(file=file, line=line, text=text if len(text) <= MAX_LINE else None)


class Interpreter:
    """A program being read. ``line`` executes one line into ``out``; ``ended`` tells that nothing more is to be read."""

    def __init__(self, file: str, axes: tuple[str, ...], dialect: dialects.Dialect, position: list[float], warn: Warn | None) -> None:
        self.ended = False
        self.out = Output(file, len(axes))
        self.modal = Modal(motion=dialect.motion)
        self.motion = Motion(file, axes, dialect, self.modal, position, self.out)
        self._file = file
        self._dialect = dialect
        self._warn = warn
        self._begun = False
        self._percent = False
        self._at = 0
        self._text = ""

    def line(self, line: Statement, number: int, text: str) -> None:
        """Execute a parsed line; ``text`` is its source."""
        self._at, self._text = number, text
        for remark in line.remarks:
            if remark.kind == "msg":
                self.out.add(Message(self._file, number, remark.text))
        if line.percent:
            self._percent_line()
        elif line.words:
            self._execute(LineWords.of(line))
            self._begun = True

    def end_of_file(self) -> None:
        """The program ends without M2, M30 or ``%``; an error inside a NURBS."""
        if self.motion.nurbs:
            raise self.motion.nurbs.end("the program ends before the curve is complete")
        self.out.flush()

    def _percent_line(self) -> None:
        """A first ``%`` before any word opens the program, any other ends it."""
        if not self._begun and not self._percent:
            self._percent = True
            return
        self.end_of_file()
        self.ended = True

    def _execute(self, words: LineWords) -> None:
        if self.motion.nurbs:
            self.motion.nurbs_line(words, self._at, self._text)
        elif words.g or words.m:
            self._in_order(words, codes_of(words.g, words.m, self._dialect))
        elif not self._is_program_number(words):
            self._in_order(words, {})
        if words.rest:
            raise unused(words, self.modal)

    def _is_program_number(self, words: LineWords) -> bool:
        if self._begun or not self._dialect.program_number or words.rest.keys() != {"O"}:
            return False
        whole(words.rest.pop("O"), "a program number", 0)
        return True

    def _in_order(self, words: LineWords, codes: dict[str, Code]) -> None:
        """The standard order of execution."""
        state = self.modal
        moving = self.motion.check(words, codes)
        if not codes:
            self._feed(words, codes)
            self._speed_and_tool(words, codes)
            self.motion.move(words, moving, self._at, self._text)
            return
        if code := codes.get("feed-mode"):
            inverse = code.number == 930
            if inverse != state.inverse_time:
                state.inverse_time, state.feed = inverse, None
        if self._dialect.units_before_feed:
            self._units(codes)
        self._feed(words, codes)
        self._speed_and_tool(words, codes)
        self._machine_functions(words, codes)
        if code := codes.get("plane"):
            state.plane = PLANES[code.number]
        self._units(codes)
        if "compensation" in codes:
            state.compensation = False
        if code := codes.get("system"):
            self.motion.use_system(SYSTEMS[code.number])
        if code := codes.get("path"):
            self._path_control(words, code)
        if code := codes.get("distance"):
            state.absolute = code.number == 900
        if code := codes.get("arc-distance"):
            state.arc_absolute = code.number == 901
        if (code := codes.get("non-modal")) and code.number != 40:
            self.motion.offsets_code(words, code)
        self.motion.move(words, moving, self._at, self._text, codes.get("motion"))
        if code := codes.get("stop"):
            self._stop(code)

    def _feed(self, words: LineWords, codes: dict[str, Code]) -> None:
        """F. In inverse time it belongs to the move of its line, which takes it."""
        if "F" not in words.rest or self.modal.inverse_time:
            return
        word = words.rest.pop("F")
        scale = self.modal.scale
        if (code := codes.get("units")) and scale != _scale(code) and not self._dialect.units_before_feed:
            self._caution("feed-before-units", f"F is read before {code.word.written} takes effect", word, "write F on the next line")
        if word.number <= 0:
            raise fault("feed-not-positive", f"{word.written}: the feed must be more than 0", word)
        feed = Feed(per_second(word.number * scale), per_second(word.number))
        if feed.rotary < MIN_FEED:
            raise fault("feed-too-slow", f"{word.written}: the feed is next to nothing", word)
        self.modal.feed = feed

    def _units(self, codes: dict[str, Code]) -> None:
        if code := codes.get("units"):
            self.modal.scale = _scale(code)

    def _speed_and_tool(self, words: LineWords, codes: dict[str, Code]) -> None:
        state = self.modal
        if word := words.take("S", "S"):
            state.speed = not_negative(word, "the spindle speed")
            if state.spindle != "off" and "spindle" not in codes and "tool-change" not in codes:
                self.out.add(Spindle(self._file, self._at, state.spindle, state.speed))
        if word := words.take("T", "T"):
            state.tool = whole(word, "the tool number", 0, MAX_TOOL)

    def _machine_functions(self, words: LineWords, codes: dict[str, Code]) -> None:
        """Tool change, spindle, coolant, dwell."""
        state, file, at = self.modal, self._file, self._at
        if code := codes.get("tool-change"):
            if state.tool is None:
                raise fault("tool-not-chosen", "M6 without a tool chosen by a T word", code.word, "give T and the tool's number")
            self._spindle_off()
            self.out.add(Tool(file, at, state.tool))
        if code := codes.get("spindle"):
            if code.number == 5:
                state.spindle = "off"
                self.out.add(Spindle(file, at, "off", 0.0))
            else:
                if state.speed is None:
                    message = f"{code.word.written} without a speed ever given: the spindle stands"
                    self._caution("spindle-speed-missing", message, code.word, "give S")
                state.spindle = "cw" if code.number == 3 else "ccw"
                self.out.add(Spindle(file, at, state.spindle, state.speed or 0.0))
        if code := codes.get("coolant"):
            state.mist = code.number == 7 or (state.mist and code.number == 8)
            state.flood = code.number == 8 or (state.flood and code.number == 7)
            self.out.add(Coolant(file, at, state.mist, state.flood))
        if (code := codes.get("non-modal")) and code.number == 40:
            self.out.add(Dwell(file, at, self._dwell(words, code.word)))

    def _dwell(self, words: LineWords, word: Word) -> float:
        letters = self._dialect.dwell
        times = [(letter, time) for letter in letters if (time := words.take(letter, "G4"))]
        if not times:
            raise fault("dwell-time-missing", f"{word.written} needs a time", word, f"give {' or '.join(letters)}")
        if len(times) > 1:
            raise fault("word-wanted-twice", f"{word.written} takes one time only", times[1][1])
        letter, time = times[0]
        seconds = not_negative(time, "the time") * letters[letter]
        if seconds > MAX_DWELL:
            raise fault("value-out-of-range", f"{time.written}: a dwell of {seconds:g} s is more than eleven days", time)
        return seconds

    def _path_control(self, words: LineWords, code: Code) -> None:
        """G61, G61.1, G64. Q of G64 allows straight moves to be merged within a tolerance: leave that needs not be taken."""
        if code.number != 640:
            control = "exact-stop" if code.number == 611 else self._dialect.path_stop
            self.out.add(PathMode(self._file, self._at, control))
            return
        tolerance = 0.0
        for letter in sorted(self._dialect.path_words):
            if word := words.take(letter, "G64"):
                value = not_negative(word, "the tolerance") * self.modal.scale
                tolerance = value if letter == "P" else tolerance
        self.out.add(PathMode(self._file, self._at, "blend", tolerance))

    def _stop(self, code: Code) -> None:
        """M0, M1, M2, M30; the last two also stop spindle and coolant."""
        file, at, state = self._file, self._at, self.modal
        if self.motion.nurbs:
            raise fault("nurbs-foreign-word", f"{code.word.written} can't stand in the line of G6.2", code.word)
        if code.number in (0, 1):
            self.out.add(Stop(file, at, optional=code.number == 1))
            return
        self._spindle_off()
        if state.mist or state.flood:
            self.out.add(Coolant(file, at, mist=False, flood=False))
        self.out.add(End(file, at))
        self.ended = True

    def _spindle_off(self) -> None:
        if self.modal.spindle != "off":
            self.modal.spindle = "off"
            self.out.add(Spindle(self._file, self._at, "off", 0.0))

    def _caution(self, code: str, message: str, word: Word, hint: str) -> None:
        if self._warn:
            self._warn(Diagnostic(code, message, self._file, self._at, word.column, word.length, self._text, hint, severity="warning"))


def _scale(code: Code) -> float:
    """Millimetres a program unit under G20 or G21."""
    return MM_PER_INCH if code.number == 200 else 1.0
