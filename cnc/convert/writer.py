"""Executed lines of a program as lines of another control: kept, or written from their blocks.

A line is kept where each of its words means the same, and the state behind it is the one that the
program has. Else its moves and actions are written from its blocks, in program coordinates of the
coordinate system in use.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import IO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.convert.curves import Curve, FitTo, Spline, curves_of, splines_of
from cnc.convert.elements import Elements, Straights, size
from cnc.convert.output import PLANE_CODES, UNKNOWN, Output
from cnc.convert.target import Target, comments, number, without_comments
from cnc.gcode.core.coordinates import EXTERNAL
from cnc.gcode.core.line_trace import ExecutedLines, Offsets
from cnc.gcode.core.modal_groups import PLAIN_MOTIONS, ModalState
from cnc.gcode.reader.source_text import Window
from cnc.gcode.reader.statements import Statement
from cnc.gcode.reader.words import AXES, G, Word
from cnc.model import parameter_numbers as numbers
from cnc.model.blocks import (
    PLANE_AXES,
    Abort,
    ArcFeed,
    Block,
    BoardCommand,
    Coolant,
    Dwell,
    End,
    Message,
    NurbsFeed,
    Overrides,
    PathMode,
    Probe,
    Spindle,
    SpindleSync,
    Stop,
    Tool,
)
from cnc.model.units import decimal_text

SHORTEST_RUN = 3
"""Straight moves. Fewer are written as they are."""
_FEED_CODES = {"inverse-time": "G93", "per-minute": "G94", "per-revolution": "G95"}
_PLACES = AXES | set("IJKR")
_STORED = frozenset((G.G28_1, G.G30_1))
_TAPPING = frozenset((G.G74, G.G84))
_TAPPING_ON_LATHES = frozenset((G.G84, G.G88))
_RETURNS = frozenset((G.G28, G.G30, G.G53))
_STATED = {
    "scale": "units", "absolute": "distance", "plane": "plane", "feed_mode": "feed-mode",
    "initial_level": "retract",
}  # fmt: skip
"""Modal group of each state that a line gives."""
_DELETED, _REMARK = re.compile(rb"^[ \t]*/", re.MULTILINE), re.compile(rb"[(;]")


class Region(NamedTuple):
    """Lines that stand for curves of the program within a tolerance.

    Attributes:
        first: Number of the first curve, from 0.
        last: Number behind the last one.
        begin: First line that was written for them.
        end: Last one.
    """

    first: int
    last: int
    begin: int
    end: int


class Written(NamedTuple):
    """Lines that were written for lines of the program.

    Attributes:
        begin: First line that was written.
        file: The file of the program's lines.
        line: The first line there.
        form: Form of a line that was kept; empty for many lines; None for one written anew.
        is_open: Whether it was kept under cutter compensation.
    """

    begin: int
    file: str
    line: int
    form: tuple[str, ...] | None
    is_open: bool


@dataclass
class Notes:
    """Remarks about a conversion: lines by the text of the remark, with its kind."""

    kept: int = 0
    expanded: int = 0
    remarks: dict[tuple[str, str], list[int]] = field(default_factory=dict)

    def add(self, kind: str, text: str, line: int) -> None:
        """Add a remark about a line."""
        self.remarks.setdefault((kind, text), []).append(line)


class Writer:
    """Writes the lines.

    Args:
        target: The control.
        axes: Letters of the machine's axes.
        start: Position before the program (axes,), mm.
        fit: How curves are written.
        file: Receives the lines.
        sought: A line of the result; 0 for none.

    Attributes:
        notes: Remarks.
        regions: Curves that were written within the tolerance.
        at_sought: The lines with the sought one.
        kept_before: The last line up to the sought one that was kept on its own.
        systems: Coordinate system of each system of the program, by index.
        executed: First and last line of lines of the program that were executed.
    """

    def __init__(
        self,
        target: Target,
        axes: tuple[str, ...],
        start: NDArray[np.float64],
        fit: FitTo,
        file: IO[bytes],
        sought: int = 0,
    ) -> None:
        self.target, self.axes, self.fit = target, axes, fit
        self.notes = Notes()
        self.regions: list[Region] = []
        self.at_sought: Written | None = None
        self.kept_before: Written | None = None
        self._sought = sought
        self.systems: dict[int, int] = {}
        self.executed: list[tuple[int, int]] = []
        self._file = ""
        self._out = Output(target, axes, start, file)
        self._elements = Elements(start)
        self._curves = 0
        self._origins: dict[int, tuple[float, ...]] = {}
        self._before: ExecutedLines | None = None
        self._open_kept = False
        self._probed = 0
        self._ended = False
        self._mist = self._flood = False
        self._run: list[Straights] = []
        self._run_mark: ExecutedLines | None = None
        self._masks: tuple[Window | None, NDArray[np.bool_]] = (None, np.empty(0, np.bool_))

    # The stream of executed lines

    def take(self, blocks: Iterable[Block]) -> None:
        """Write the lines of a program.

        Raises:
            GcodeError: ``convert-cannot``.
        """
        if self.target.rules.flavour == "macro-b":
            self._out.put("%")
        pending: list[Block] = []
        for block in blocks:
            if not isinstance(block, ExecutedLines):
                pending.append(block)
                continue
            self._executed(block, list(self._elements.of(pending)))
            pending.clear()
        self._write_run()
        if pending and self._before is not None:
            self._write_elements(self._before, list(self._elements.of(pending)))
        if not self._ended and (end := self.target.ends()):
            self._out.put(end)
            self.notes.add("added", f"{end} at the end", self._out.line - 1)
        if self.target.rules.flavour == "macro-b":
            self._out.put("%")

    def _executed(self, mark: ExecutedLines, elements: list[Block]) -> None:
        before, self._before = self._before, mark
        self._origins.setdefault(mark.offsets.system, mark.offsets.origin)
        if before is None:
            self._file = mark.file
            return
        if mark.file == self._file:
            self._note_executed(mark.line, mark.last)
        count = mark.last - mark.line + 1
        is_run = count > 1
        if self.fit.curves != "lines":
            if is_run or self._only_moves(before, mark, elements):
                self._gather(mark, elements)
                return
            self._write_run()
        first = self._out.line
        if is_run or self._keeps(before, mark, elements):
            if is_run:
                self._keep_run(before, mark)
            else:
                self._keep_line(before, mark, elements)
            self._curves += sum(map(size, elements))
            self._out.position = self._elements.position
            self._note_events(elements)
            self.notes.kept += count
            form = () if mark.statement is None else self.target.form(mark.statement)
            is_open = before.is_open or mark.is_open
            self._note_written(Written(first, mark.file, mark.line, form, is_open))
            return
        self._note_written(Written(first, mark.file, mark.line, None, False))
        self._expand(before, mark, elements)

    def _note_executed(self, first: int, last: int) -> None:
        """Note lines that were executed, together with those that they follow."""
        if self.executed and self.executed[-1][0] <= first <= self.executed[-1][1] + 1:
            begin, end = self.executed.pop()
            first, last = begin, max(end, last)
        self.executed.append((first, last))

    def _note_written(self, written: Written) -> None:
        """Note lines of the result, if they are not behind the sought one."""
        if written.begin <= self._sought:
            self.at_sought = written
            if written.form:
                self.kept_before = written

    # Lines that are kept

    def bulk(self, window: Window, index: int, end: int) -> int:
        """Return how many lines of a window can be kept together."""
        before = self._before
        if before is None or not self.target.takes_runs:
            return 0
        if self.fit.curves != "lines" and before.modal.motion != G.G1:
            return 0
        modal, state = before.modal, self._out.state
        if (
            before.is_open
            or not before.is_plain
            or modal.feed_mode != "per-minute"
            or modal.arc_absolute
            or modal.motion not in (None, *PLAIN_MOTIONS)
            or (modal.motion != state.motion and modal.motion in PLAIN_MOTIONS[2:])
            or not self._same_zero(before.offsets)
        ):
            return 0
        mask = self._mask(window)[index:end]
        return end - index if mask.all() else int(mask.argmin())

    def _mask(self, window: Window) -> NDArray[np.bool_]:
        """Return for each line of a window whether all of its words can be kept (lines,)."""
        if self._masks[0] is window:
            return self._masks[1]
        lines, words = window.sorted.lines, window.sorted.words
        only_moves = self.fit.curves != "lines"
        others = "NF" if only_moves else "NFSIJKR"
        letters = np.zeros(256, np.bool_)
        letters[[ord(letter) for letter in set(others) | self.target.rules.axes]] = True
        g, m = (
            (frozenset((10,)), frozenset())
            if only_moves
            else (self.target.bulk_g, self.target.bulk_m)
        )
        good = letters[words.letter]
        for name, codes in (("G", g), ("M", frozenset(10 * code for code in m))):
            own = np.flatnonzero(words.letter == ord(name))
            good[own] = np.isin(np.round(words.number[own] * 10.0), list(codes))
        mask = np.ones(window.count, np.bool_)
        mask[np.searchsorted(lines.first, np.flatnonzero(~good), side="right") - 1] = False
        begins = window.places[0]
        patterns = [_DELETED] if b"/" in window.data else []
        for pattern in (*patterns, _REMARK) if only_moves else patterns:
            for at in pattern.finditer(window.data):
                mask[int(np.searchsorted(begins, at.start(), side="right")) - 1] = False
        self._masks = window, mask
        return mask

    def _keep_run(self, before: ExecutedLines, mark: ExecutedLines) -> None:
        words = self._missing(before.modal, (), before.offsets)
        modal = before.modal
        if modal.motion is not None and modal.motion != self._out.state.motion:
            words.append(f"G{modal.motion.code:g}")
        if modal.feed is not None and modal.feed != self._out.state.feed:
            words.append(f"F{number(self._feed_number(modal), 6)}")
        if words:
            self._out.put(" ".join(words))
        self._out.put_lines(self.target.spelled(mark.text), mark.last - mark.line + 1)
        self._adopt(mark)

    def _same_zero(self, offsets: Offsets) -> bool:
        """Whether positions are written here with the same numbers as in the program."""
        if offsets.turned or any(offsets.local) or any(offsets.external):
            return False
        known = self._out.state.system
        if known is not UNKNOWN and known != self._system(offsets.system):
            return False
        return offsets.shift == self._out.shift and offsets.tool == self._out.tool

    def _system(self, system: int) -> int | None:
        """Return the coordinate system for one of the program; None where there is none."""
        plain = 0 <= system < min(self.target.source.systems, self.target.systems)
        return system if plain else self.systems.get(system)

    def _keeps(self, before: ExecutedLines, mark: ExecutedLines, elements: list[Block]) -> bool:
        """Return whether a single line can be kept."""
        statement, modal = mark.statement, mark.modal
        if statement is None or not self.target.can_keep(statement):
            return False
        if not statement.words:
            text = mark.text.decode(errors="replace")
            return not elements and not without_comments(text).strip()
        if modal.diameter or not self._is_written_alike(before, mark):
            return False
        cycle = modal.motion not in (None, *PLAIN_MOTIONS)
        has_code = self.target.in_group(statement.words, "motion")
        if cycle and not has_code and self._out.state.motion != modal.motion:
            return False
        if cycle and modal.motion is not None and modal.motion.value not in self.target.g:
            return False
        if mark.is_open and not before.is_open:
            self._open_kept = self.target.compensates
        return self._open_kept if mark.is_open or before.is_open else True

    def _is_written_alike(self, before: ExecutedLines, mark: ExecutedLines) -> bool:
        """Whether the zero before and behind a line is the one that the control would have."""
        words = mark.statement.words if mark.statement else ()
        old, new = before.offsets, mark.offsets
        if old.turned or new.turned or any(new.local) or any(new.external) or any(old.local):
            return False
        if self._system(new.system) is None or self._system(new.system) != new.system:
            return False
        sets_tool = self.target.in_group(words, "tool-length")
        sets_shift = any(
            word.letter == "G" and word.tenths in (920, 921, 922, 923) for word in words
        )
        if old.tool != self._out.tool and not sets_tool:
            return False
        if old.shift != self._out.shift and not (sets_shift and old.shift == new.shift):
            return False
        if new.tool != old.tool and not sets_tool:
            return False
        return new.shift == old.shift or sets_shift

    def _keep_line(self, before: ExecutedLines, mark: ExecutedLines, elements: list[Block]) -> None:
        statement = mark.statement
        assert statement is not None
        text = self.target.spelled(mark.text)
        words = statement.words
        if not all(word.letter == "N" for word in words):
            modal = before.modal
            letters = {word.letter for word in words}
            is_cycle = mark.modal.motion not in (None, *PLAIN_MOTIONS)
            missing = (
                self._missing(modal, words, before.offsets, is_cycle=is_cycle)
                if letters & _PLACES
                else []
            )
            at_feed = any(
                isinstance(element, ArcFeed | NurbsFeed)
                or (isinstance(element, Straights) and not np.isnan(element.feeds).all())
                for element in elements
            )
            if at_feed and "F" not in letters and mark.modal.feed != self._out.state.feed:
                missing.append(f"F{number(self._feed_number(mark.modal), 6)}")
            for group, letter, value, there in (
                ("spindle", "S", modal.speed, self._out.state.speed),
                ("tool-change", "T", modal.tool, self._out.state.tool),
            ):
                given = letter in letters or not self.target.in_group(words, group)
                if not given and value is not None and value != there:
                    missing.append(letter + decimal_text(value, 3))
            if missing:
                self._out.put(" ".join(missing))
            needs_code = not self.target.in_group(words, "motion") and letters & AXES
            if needs_code and modal.motion is not None and modal.motion != self._out.state.motion:
                code = f"G{modal.motion.code:g} ".encode()
                head = re.match(rb"[ \t]*(?:/[0-9]?[ \t]*)?(?:[Nn][ \t]*[0-9.]+[ \t]*)?", text)
                at = head.end() if head else 0
                text = text[:at] + code + text[at:]
        self._out.put_bytes(text)
        if self.target.is_lathe:  # only lines without code are kept
            return
        self._adopt(mark, words)
        if any(word.letter == "G" and word.tenths == 800 for word in words):
            self._out.state.motion = UNKNOWN
        if any(word.letter == "G" and word.tenths == 100 for word in words):
            self._origins[mark.offsets.system] = mark.offsets.origin

    def _adopt(self, mark: ExecutedLines, words: tuple[Word, ...] | None = None) -> None:
        """Take the state behind a line with these words that was kept; None for many lines.

        What neither the line nor an earlier one states, depends on the control.
        """
        modal, state = mark.modal, self._out.state
        for name, group in _STATED.items():
            if (
                words is None
                or getattr(state, name) is not UNKNOWN
                or self.target.in_group(words, group)
            ):
                setattr(state, name, getattr(modal, name))
        for name in ("motion", "arc_absolute", "feed", "speed", "tool"):
            setattr(state, name, getattr(modal, name))
        if words is None or state.system is not UNKNOWN or self.target.in_group(words, "system"):
            state.system = self._system(mark.offsets.system)
        self._out.shift, self._out.tool = mark.offsets.shift, mark.offsets.tool

    def _missing(
        self,
        modal: ModalState,
        words: tuple[Word, ...],
        offsets: Offsets,
        *,
        is_cycle: bool = False,
    ) -> list[str]:
        """Return codes of the state that a line counts on and the control does not have.

        They are taken for written.

        Args:
            modal: The state before the line.
            words: Its words.
            offsets: The offsets.
            is_cycle: Whether it is a canned cycle.
        """
        state, codes = self._out.state, self.target.rules.g
        system = self._system(offsets.system)
        wanted: list[tuple[str, str, object, str]] = [
            ("scale", "units", modal.scale, self.target.units(modal.scale)),
            ("absolute", "distance", modal.absolute, "G90" if modal.absolute else "G91"),
            ("plane", "plane", modal.plane, f"G{PLANE_CODES[modal.plane].code:g}"),
            (
                "arc_absolute",
                "arc-distance",
                modal.arc_absolute,
                "G90.1" if modal.arc_absolute else "G91.1",
            ),
            ("feed_mode", "feed-mode", modal.feed_mode, _FEED_CODES[modal.feed_mode]),
        ]
        if system is not None:
            wanted.append(("system", "system", system, numbers.SYSTEMS[system]))
        if is_cycle:
            level = modal.initial_level
            wanted.append(("initial_level", "retract", level, "G98" if level else "G99"))
        missing = []
        for name, group, value, code in wanted:
            if value != getattr(state, name) and not self.target.in_group(words, group):
                setattr(state, name, value)
                if code and (name == "scale" or G(round(10 * float(code[1:]))) in codes):
                    missing.append(code)
        return missing

    @staticmethod
    def _feed_number(modal: ModalState) -> float:
        assert modal.feed is not None
        minutes = 60.0 if modal.feed_mode == "per-minute" else 1.0
        return modal.feed.linear * minutes / modal.scale

    # Lines that are written anew

    def _expand(self, before: ExecutedLines, mark: ExecutedLines, elements: list[Block]) -> None:
        statement = mark.statement
        text = mark.text.decode(errors="replace")
        code = without_comments(text).strip() if self.target.source.flavour != "klartext" else text
        if statement is not None:
            self._check(statement, mark)
            if self._probed and (statement.computed or statement.control or statement.assignments):
                raise self._out.cannot(
                    mark,
                    f"the answer of the probe in line {self._probed} decides about this line",
                    "measure on the machine, and write the result into the program",
                )
        if not text.strip():
            self._out.put("")
            return
        remarks = comments(text)
        if code.startswith(("O", ":")) and not elements:
            remarks = [" ".join((code, *remarks))]
        if not any(isinstance(element, Message) for element in elements):
            for remark in remarks:
                self._out.put(self.target.comment(remark))
        if code and code != "%":
            self.notes.expanded += 1
        if len(elements) > 1 and statement is not None and not statement.control:
            self._out.put(self.target.comment(code))
        if mark.is_open and self.target.is_lathe and mark.modal.compensation != G.G40:
            text = "nose radius compensation is that of the radii in the tool table"
            self.notes.add("assumed", text, mark.line)
        if statement is not None and statement.words and statement.words[0].letter == "N":
            self._out.label = statement.words[0].written.encode() + b" "
        self._write_elements(mark, elements)
        self._out.label = b""
        self._open_kept = self._open_kept and mark.is_open

    def _check(self, statement: Statement, mark: ExecutedLines) -> None:
        """Refuse what no block shows, and note codes that are left out."""
        source = self.target.source
        for word in statement.words:
            note = source.noted.get((word.letter, word.number))
            if note is not None and (
                not note.needs or any(other.letter in note.needs for other in statement.words)
            ):
                if note.unchecked:
                    hint = "remove it, or write what the other control has for it"
                    raise self._out.cannot(mark, f"{word.written} is {note.name}", hint)
                self.notes.add("left out", f"{word.written} ({note.name})", mark.line)
            if word.letter == "G" and word.tenths in _STORED:
                raise self._out.cannot(mark, f"{word.written} stores a position of the machine", "")
        if statement.deletable:
            self.notes.add("assumed", "block delete is off: the line is always executed", mark.line)
        if self.target.is_lathe and mark.modal.motion in _TAPPING_ON_LATHES:
            text = "tapping becomes feeds and a spindle that turns back: the holder must give way"
            self.notes.add("assumed", text, mark.line)
        if mark.modal.motion in _TAPPING and self.target.rules.name in ("grbl", "marlin"):
            hint = "tap by hand, or mill the thread"
            raise self._out.cannot(mark, "the spindle does not follow the feed: no tapping", hint)

    def _write_elements(self, mark: ExecutedLines, elements: list[Block]) -> None:
        moves = [k for k, element in enumerate(elements) if isinstance(element, Straights)]
        last = moves[-1] if moves else -1
        for place, element in enumerate(elements):
            if isinstance(element, Straights):
                self._write_moves(mark, element, is_last=place == last)
            elif isinstance(element, ArcFeed):
                self._sync(mark)
                self._write_arc(mark, element)
            elif isinstance(element, NurbsFeed):
                self._write_curve(mark, element)
            else:
                self._write_event(mark, element)
            self._curves += size(element)

    def _sync(self, mark: ExecutedLines) -> None:
        """Bring about G90, the units and the offsets for moves that are written."""
        state, offsets, has = self._out.state, mark.offsets, self.target.rules.g
        scale = mark.modal.scale
        is_lathe = self.target.is_lathe
        words = self._turning_words(mark) if is_lathe else []
        absolute = self.target.lathe.absolute if is_lathe else "G90"
        feed_mode = self._feed_mode(mark)
        if state.scale != scale and (units := self.target.units(scale)):
            words.append(units)
        if state.absolute is not True and absolute:
            words.append(absolute)
        if state.feed_mode != feed_mode and G.G94 in has:
            turns = feed_mode == "per-revolution"
            words.append(self.target.lathe.feeds[turns] if is_lathe else _FEED_CODES[feed_mode])
            state.feed = UNKNOWN
        system = self._system_for(mark)
        if system != state.system and self.target.systems > 1:
            words.append(numbers.SYSTEMS[system])
        state.scale, state.absolute, state.feed_mode = scale, True, feed_mode
        state.system = system
        if words:
            self._out.put(" ".join(words))
        if offsets.origin != self._origins[offsets.system]:
            self._write_origin(mark)
        if is_lathe:
            self._write_turret_offset(mark)
        elif offsets.tool != self._out.tool and G.G43_1 in has:
            self._write_tool_length(mark)

    def _turning_words(self, mark: ExecutedLines) -> list[str]:
        """Return the code of diameters or radii where the control does not have it."""
        turning, codes = self._out.turning, self.target.lathe
        diameter = mark.modal.diameter or not codes.radii
        if turning.diameter == diameter:
            return []
        if codes.assumed:
            self.notes.add("assumed", codes.assumed, mark.line)
        turning.diameter = diameter
        code = codes.diameters if diameter else codes.radii
        return [code] if code else []

    def _feed_mode(self, mark: ExecutedLines) -> str:
        """Return the feed of written moves: per revolution if a lathe's spindle turns."""
        turns = self.target.is_lathe and self._out.turning.spindle is not None
        per_turn = turns and mark.modal.feed_mode == "per-revolution"
        return "per-revolution" if per_turn else "per-minute"

    def _write_turret_offset(self, mark: ExecutedLines) -> None:
        """Write the offset of the tool that the program has in effect."""
        turning, number = self._out.turning, mark.offsets.number
        if number < 0:
            hint = "enter the offset in the tool table, and choose it by its number"
            raise self._out.cannot(mark, "the offset of the tool has no number", hint)
        if turning.offset != number:
            words = self.target.lathe.tool_offset(turning.tool, number)
            self._put_offset(mark, words, number)
        self._out.tool = mark.offsets.tool

    def _put_offset(self, mark: ExecutedLines, words: str, number: int) -> None:
        """Write words that put the offset of a tool into effect, or refuse an empty text."""
        turning = self._out.turning
        if not words:
            message = f"tool {turning.tool} with the offset {number} has no words here"
            hint = "give the tool and its offset one number of two digits"
            raise self._out.cannot(mark, message, hint)
        self._out.put(words)
        turning.offset = number
        text = "the offsets of tools are those in the control's own memory"
        self.notes.add("assumed", text, mark.line)

    def _system_for(self, mark: ExecutedLines) -> int:
        """Return the coordinate system for that of the program."""
        index = mark.offsets.system
        system = self._system(index)
        if system is not None:
            if system in self.systems.values() and index not in self.systems:
                message = f"{numbers.SYSTEMS[system]} already stands for another system"
                raise self._out.cannot(mark, message, "number the work offsets anew")
            return system
        used = set(self.systems.values()) | (set(self._origins) - {index})
        free = [place for place in range(self.target.systems) if place not in used]
        if not free:
            raise self._out.cannot(
                mark, "the control has no more work offsets", "use fewer of them"
            )
        self.systems[index] = free[-1]
        source = self.target.source.systems
        name = f"G54.1 P{index - source + 1}" if index >= source else numbers.SYSTEMS[index]
        there = numbers.SYSTEMS[free[-1]] if self.target.systems > 1 else "the zero of the machine"
        text = f"{name} becomes {there}: enter its offset there"
        if index == EXTERNAL:
            text = f"the basic system (G500) becomes {there}: its offset must be 0"
        self.notes.add("assumed", text, mark.line)
        return free[-1]

    def _write_origin(self, mark: ExecutedLines) -> None:
        """Write the origin of the coordinate system that the program has changed."""
        offsets = mark.offsets
        if 2 not in self.target.rules.offsets.written or G.G10 not in self.target.rules.g:
            raise self._out.cannot(mark, "the program sets a work offset by a computed value", "")
        assert self._out.state.system is not None
        words = [f"G10 L2 P{self._out.state.system + 1}"]
        words += [
            f"{axis.upper()}{self._out.number(axis, value)}"
            for axis, value in zip(self.axes, offsets.origin, strict=True)
            if axis.upper() in self.target.rules.axes
        ]
        self._out.put(" ".join(words))
        self._origins[offsets.system] = offsets.origin

    def _write_tool_length(self, mark: ExecutedLines) -> None:
        tool = mark.offsets.tool
        if not any(tool):
            self._out.put("G49")
        elif "z" in self.axes and not any(
            value for axis, value in zip(self.axes, tool, strict=True) if axis != "z"
        ):
            value = tool[self.axes.index("z")]
            self._out.put(f"G43.1 Z{self._out.number('z', value)}")
            self.notes.add("assumed", "lengths of tools are those of the tool table", mark.line)
        else:
            return
        self._out.tool = tool

    def _write_moves(self, mark: ExecutedLines, moves: Straights, *, is_last: bool) -> None:
        """Write straight moves."""
        self._sync(mark)
        returns = self._returns(mark)
        for place, (end, feed) in enumerate(zip(moves.points, moves.feeds.tolist(), strict=True)):
            in_machine = returns and is_last and place == len(moves.feeds) - 1
            self._out.straight(mark, end, feed, in_machine=in_machine)

    # Short moves that are gathered to be written as curves

    def _only_moves(
        self, before: ExecutedLines, mark: ExecutedLines, elements: list[Block]
    ) -> bool:
        """Return whether a line has straight moves at feed and nothing else."""
        statement = mark.statement
        return (
            statement is not None
            and bool(elements)
            and all(isinstance(element, Straights) for element in elements)
            and self._keeps(before, mark, elements)
            and not comments(mark.text.decode(errors="replace"))
            and mark.modal.motion == G.G1
            and mark.is_plain
            and all(
                word.letter in "NF" or word.letter in AXES or word.written in ("G1", "G01")
                for word in statement.words
            )
        )

    def _gather(self, mark: ExecutedLines, elements: list[Block]) -> None:
        if not self._run:
            self._note_written(Written(self._out.line, mark.file, mark.line, None, False))
        self._run += [element for element in elements if isinstance(element, Straights)]
        self._run_mark = mark
        self.notes.expanded += mark.last - mark.line + 1

    def _write_run(self) -> None:
        """Write the moves that were gathered."""
        mark, run = self._run_mark, self._run
        if mark is None or not run:
            return
        self._run = []
        self._sync(mark)
        points = np.concatenate([moves.points for moves in run])
        feeds = np.concatenate([moves.feeds for moves in run])
        edges = (np.flatnonzero(feeds[1:] != feeds[:-1]) + 1).tolist()
        for begin, end in pairwise([0, *edges, len(feeds)]):
            feed = float(feeds[begin])
            if end - begin < SHORTEST_RUN:
                for point in points[begin:end]:
                    self._out.straight(mark, point, feed)
                self._curves += end - begin
                continue
            places = np.concatenate((self._out.position[None], points[begin:end]))
            for curve in self._curves_of(places):
                first, line = self._curves, self._out.line
                if isinstance(curve, Spline):
                    self._out.spline(mark, curve, feed)
                else:
                    self._out.turn(mark, curve, feed)
                self._curves += curve.moves
                if isinstance(curve, Spline) or curve.moves > 1 or curve.plane is not None:
                    self.regions.append(Region(first, self._curves, line, self._out.line - 1))

    def _curves_of(self, points: NDArray[np.float64]) -> Iterator[Curve | Spline]:
        """Yield the curves for moves through points (n, axes)."""
        if self.fit.curves == "nurbs":
            planar = self.target.spline == "G5.2"
            return splines_of(points, self.axes, self.fit, planar=planar)
        return curves_of(points, self.axes, self.fit)

    def _returns(self, mark: ExecutedLines) -> bool:
        """Whether the last move of a line goes to a place in machine coordinates."""
        words = mark.statement.words if mark.statement else ()
        for word in words:
            if word.letter == "G" and word.number == word.number:
                alias = self.target.source.aliases.get(word.number)
                code = round(10 * (word.number if alias is None else alias.code))
                if code in _RETURNS:
                    if code != G.G53:
                        text = f"the place of G{code / 10:g} stays where the machine has it (G53)"
                        self.notes.add("assumed", text, mark.line)
                    return True
        return False

    def _write_arc(self, mark: ExecutedLines, arc: ArcFeed) -> None:
        """Write an arc; one of several turns in turns."""
        count = max(1, math.ceil(abs(arc.turns) - 1e-9))
        first, begin, start = self._curves, self._out.line, self._out.position
        for part in range(1, count + 1):
            share = min(part / abs(arc.turns), 1.0) if count > 1 else 1.0
            end = arc.end if part == count else self._on_arc(arc, start, share)
            self._out.turn(mark, Curve(end, arc.plane, arc.center, arc.turns > 0.0), arc.feed)
        if count > 1:
            self.regions.append(Region(first, first + 1, begin, self._out.line - 1))

    def _on_arc(
        self, arc: ArcFeed, start: NDArray[np.float64], share: float
    ) -> NDArray[np.float64]:
        """Return a point after whole turns: that of the start in the plane, a share elsewhere."""
        end: NDArray[np.float64] = start + share * (arc.end - start)
        for axis in PLANE_AXES[arc.plane]:
            column = self.axes.index(axis)
            end[column] = start[column]
        return end

    def _write_curve(self, mark: ExecutedLines, curve: NurbsFeed) -> None:
        """Write a spline as arcs and lines within the tolerance."""
        self._sync(mark)
        first, begin = self._curves, self._out.line
        points = self.fit.points_on(curve, self.axes)
        for piece in self._curves_of(points):
            if isinstance(piece, Spline):
                self._out.spline(mark, piece, curve.feed)
            else:
                self._out.turn(mark, piece, curve.feed)
        self.regions.append(Region(first, first + 1, begin, self._out.line - 1))
        self.notes.add("within the tolerance", "splines as other curves", mark.line)

    # Actions

    def _note_events(self, elements: list[Block]) -> None:
        """Follow the actions of lines that were kept."""
        for element in elements:
            if isinstance(element, Coolant):
                self._mist, self._flood = element.mist, element.flood
            elif isinstance(element, End):
                self._ended = True
            elif isinstance(element, Probe):
                self._probed = element.line
            elif isinstance(element, PathMode) and not self.target.path_code(element.control):
                self._path_mode(element)

    def _path_mode(self, block: PathMode) -> None:
        text = f"the control passes corners in its own way ({block.control} in the program)"
        self.notes.add("assumed", text, block.line)

    def _write_event(self, mark: ExecutedLines, block: Block) -> None:
        """Write an action."""
        rules = self.target.rules
        if self.target.is_lathe and self._write_turning_event(mark, block):
            return
        match block:
            case Dwell(seconds=seconds):
                self._out.put(self.target.rules.dwell.line(seconds))
            case Spindle(state="off"):
                self._out.put("M5")
                self._out.turning.spindle = None
            case Spindle(surface_speed=0.0):
                self._out.put(f"M{3 if block.state == 'cw' else 4} S{number(block.rpm, 3)}")
                self._out.state.speed = block.rpm
            case Coolant():
                self._write_coolant(block)
            case Tool(change=True):
                self._write_tool(mark, block)
            case Stop(pallet=False):
                self._out.put("M1" if block.optional and 1 in rules.m else "M0")
            case End():
                if end := self.target.ends():
                    self._out.put(end)
                self._ended = True
            case Message(text=text):
                is_active = rules.name in ("linuxcnc", "mach3", "grbl")
                self._out.put(f"(MSG, {text})" if is_active else self.target.comment(text))
            case PathMode():
                self._write_path_mode(mark, block)
            case Overrides():
                text = "the operator may use the overrides"
                self.notes.add("assumed", text, block.line)
            case Probe():
                self._write_probe(mark, block)
            case BoardCommand(text=text) if rules.lines.dollar:
                self._out.put(text)
            case _:
                raise self._out.cannot(mark, _NAMES.get(type(block), type(block).__name__), "")

    def _write_turning_event(self, mark: ExecutedLines, block: Block) -> bool:
        """Write an action that a lathe has in its own way, or return False."""
        match block:
            case Spindle() if self._out.turning.pitch:
                text = "the spindle turns back within a move that follows it (tapping)"
                hint = "write the tapping cycle of the control in its place"
                raise self._out.cannot(mark, text, hint)
            case Spindle(with_motion=False) if block.state != "off":
                self._write_spindle(mark, block)
            case SpindleSync(pitch=pitch, angle=angle):
                if angle and not self.target.lathe.start_angle[0]:
                    text = "a thread begins at the index of the spindle"
                    hint = "begin it farther back by this share of the lead"
                    raise self._out.cannot(mark, text, hint)
                turning = self._out.turning
                turning.pitch, turning.angle, turning.is_cut = pitch, angle, False
            case Tool(change=True) if not self.target.lathe.tool_change:
                self._turn_turret(mark, block)
            case Overrides(feed=feed, spindle=spindle) if self.target.has_overrides(feed, spindle):
                if feed == spindle:
                    self._out.put("M48" if feed else "M49")
                else:
                    self._out.put(f"M50 P{feed:d}")
                    self._out.put(f"M51 P{spindle:d}")
            case _:
                return False
        return True

    def _turn_turret(self, mark: ExecutedLines, block: Tool) -> None:
        """Write the T word of a tool, with the offset that is most likely the next one."""
        turning, number = self._out.turning, max(mark.offsets.number, 0)
        turning.tool = self._out.state.tool = block.number
        offset = number if number != turning.offset else block.number
        words = self.target.lathe.tool(block.number, offset)
        if not words:
            words, offset = self.target.lathe.tool(block.number, 0), 0
        self._put_offset(mark, words, offset)

    def _write_spindle(self, mark: ExecutedLines, block: Spindle) -> None:
        """Write the start of a lathe's spindle, a surface speed in m/min or feet/min."""
        scale = mark.modal.scale
        if block.least_rpm:
            hint = "remove G25 S, or write G97 in place of G96"
            raise self._out.cannot(mark, "G96 has a lowest speed here", hint)
        if block.surface_speed and self._out.state.scale != scale:
            self._out.put(self.target.units(scale))
            self._out.state.scale = scale
        turning, codes = self._out.turning, self.target.lathe
        if turning.limit and block.surface_speed and not block.rpm:
            hint = "give each G96 its highest speed"
            raise self._out.cannot(mark, "the highest speed of an earlier line stays", hint)
        for line in codes.spindle(block, turning.limit, scale):
            self._out.put(line)
        turning.spindle, turning.limit = block, codes.limit_after(block, turning.limit)

    def _write_coolant(self, block: Coolant) -> None:
        if (
            (self._mist and not block.mist)
            or (self._flood and not block.flood)
            or not (block.mist or block.flood)
        ):
            self._out.put("M9")
            self._mist = self._flood = False
        if block.mist and not self._mist:
            self._out.put("M7")
        if block.flood and not self._flood:
            self._out.put("M8")
        self._mist, self._flood = block.mist, block.flood

    def _write_tool(self, mark: ExecutedLines, block: Tool) -> None:
        if self.target.tool_change:
            self._out.put(f"T{block.number} M6")
            self._out.turning.tool = block.number
            if self._out.turning.spindle is not None:
                # M6 stops the spindle, which goes on turning behind a turret.
                self._write_spindle(mark, self._out.turning.spindle)
        else:
            self._out.put(self.target.comment(f"TOOL {block.number}"))
            self._out.put("M0")
            text = "tools are changed by hand at M0; lengths are those of the tool table, or 0"
            self.notes.add("assumed", text, block.line)
        self._out.state.tool = block.number

    def _write_path_mode(self, mark: ExecutedLines, block: PathMode) -> None:
        code = self.target.path_code(block.control)
        if not code:
            self._path_mode(block)
            return
        if block.control == "blend" and block.tolerance:
            if "P" in self.target.rules.motion.path_words:
                code += f" P{number(block.tolerance / mark.modal.scale, 5)}"
            else:
                self.notes.add("assumed", "G64 has the control's own tolerance", block.line)
        self._out.put(code)

    def _write_probe(self, mark: ExecutedLines, probe: Probe) -> None:
        kind = (2 if probe.must else 3) + (0 if probe.towards else 2)
        has = self.target.rules.g
        if G(380 + kind) in has:
            words = [f"G38.{kind}"]
        elif kind == 3 and G.G31 in has:
            words = ["G31"]
        else:
            hint = "measure on the machine"
            raise self._out.cannot(mark, "the control has no such probing move", hint)
        self._sync(mark)
        zero = self._out.zero(mark)
        for column in np.flatnonzero(np.abs(probe.end - self._out.position) > 1e-9).tolist():
            axis = self.axes[column]
            words.append(
                axis.upper() + self._out.number(axis, float(probe.end[column] - zero[column]))
            )
        words += self._out.feed_words(probe.feed)
        self._out.state.motion = UNKNOWN
        self._out.put(" ".join(words))
        self._out.position, self._probed = probe.end, probe.line

    # Lines


_NAMES: dict[type[Block], str] = {
    Abort: "the program stops itself with an alarm",
    Spindle: "constant surface speed (G96)",
    Tool: "M61 tells the number of the tool in the spindle",
    Stop: "a change of the pallet (M60)",
    BoardCommand: "a command of a GRBL board",
}
