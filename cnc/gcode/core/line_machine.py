"""The modal state for compiled code (:mod:`cnc.gcode.kernels.line`), and its rows as blocks."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import repeat
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.gcode.core.coordinates import SYSTEM_CODES
from cnc.gcode.core.drilling import Series
from cnc.gcode.core.interpreter import Interpreter
from cnc.gcode.core.modal_groups import GROUP_OF_G, GROUP_OF_M, PLANES, SPINDLE_STATES, Feed
from cnc.gcode.kernels import rows as kernel
from cnc.gcode.reader.words import G, M, Word
from cnc.model.blocks import (
    PLANE_AXES,
    ROTARY_LETTERS,
    ArcFeed,
    Block,
    CallBoundary,
    Coolant,
    Dwell,
    PathMode,
    Plane,
    Spindle,
)
from cnc.model.parameter_numbers import CURRENT_SYSTEM

# Blocks of the rows of compiled code (:mod:`cnc.gcode.kernels.rows`).


class RowBlocks:
    """Conversion of rows that are no straight moves."""

    def __init__(self, rows: kernel.Rows, file: str, tolerance: float, *, laser: bool) -> None:
        """Begin a conversion.

        Args:
            rows: The rows.
            file: The program that they come from.
            tolerance: Tolerance of the blends of G64, mm.
            laser: Whether S is the power of a laser.
        """
        self._rows, self._file = rows, file
        self._tolerance, self._laser = tolerance, laser

    def of(self, numbers: NDArray[np.intp]) -> Iterator[Block]:
        """Return the blocks of some rows, given by their numbers. They are made when taken."""
        kinds = self._rows.kinds[numbers]
        different = set(kinds.tolist())
        if len(different) == 1:
            return self._of_kind(different.pop(), numbers)
        of_kind = {kind: self._of_kind(kind, numbers[kinds == kind]) for kind in different}
        # Each next block is the next one of the kind of its row.
        return map(next, map(of_kind.__getitem__, kinds.tolist()))

    def _of_kind(self, kind: int, numbers: NDArray[np.intp]) -> Iterator[Block]:
        """Return the blocks of rows of one kind. They have copies of the numbers."""
        rows, files = self._rows, repeat(self._file)
        lines, data = rows.lines[numbers].data, rows.data[numbers].T
        if kind == kernel.ARC:
            planes = map(_PLANES.__getitem__, data[4].astype(np.intp).tolist())
            x, y, radius, turns = (column.data for column in data[:4])
            centers, ends = zip(x, y, strict=True), rows.points[numbers]
            feeds = rows.feeds[numbers].data
            return map(ArcFeed, files, lines, planes, centers, ends, radius, turns, feeds)
        first, second = data[0].data, data[1].data
        if kind == kernel.SPINDLE:
            states = map(SPINDLE_STATES.__getitem__, data[0].astype(np.intp).tolist())
            in_motion = map(bool, data[2].tolist()) if self._laser else repeat(False)
            return map(Spindle, files, lines, states, second, repeat(0.0), in_motion)
        if kind == kernel.COOLANT:
            return map(Coolant, files, lines, map(bool, first), map(bool, second))
        if kind == kernel.BOUNDARY:
            # Calls of the main program are marked, whose file this is.
            return map(CallBoundary, files, lines, map(bool, first))
        if kind == kernel.PATH:
            return map(self._path_mode, lines, first)
        return map(Dwell, files, lines, first)

    def _path_mode(self, line: int, blends: float) -> PathMode:
        if blends:
            return PathMode(self._file, line, "blend", self._tolerance)
        return PathMode(self._file, line, "exact-path")


MOST_ROWS = 8192
"""Rows that are taken from compiled code at once; this limits the memory."""

_MOTIONS = (G.G0, G.G1, G.G2, G.G3)
_CYCLES = (G.G73, G.G81, G.G82, G.G83, G.G85, G.G89)
_LEVELS: tuple[bool | Literal["unclear"], ...] = (False, True, "unclear")
"""Ends of canned cycles, by the number in compiled code."""
_MODES = {None: kernel.NO_MOTION} | {code: code // 10 for code in (*_MOTIONS, *_CYCLES)}
_MOTION_OF = {mode: code for code, mode in _MODES.items()}
_PLANES = tuple(PLANES.values())
_ACROSS: dict[Plane, str] = {"XY": "Z", "ZX": "Y", "YZ": "X"}
_Numbers = NDArray[Any]
_SeriesState = tuple[int, int, int, list[float], list[float], list[int]]
_GROUPS = list(dict.fromkeys((*GROUP_OF_G.values(), *GROUP_OF_M.values())))
_ACTIONS = {
    **dict.fromkeys((*_MOTIONS, *_CYCLES), kernel.MOVE),
    G.G98: kernel.INITIAL_LEVEL,
    G.G99: kernel.R_LEVEL,
    G.G80: kernel.CANCEL,
    **dict.fromkeys(PLANES, kernel.PLANE),
    G.G90: kernel.ABSOLUTE,
    G.G91: kernel.INCREMENTAL,
    G.G4: kernel.DWELL,
}
_M_ACTIONS = {
    **dict.fromkeys((M.M3, M.M4, M.M5), kernel.TURN),
    **dict.fromkeys((M.M7, M.M8, M.M9), kernel.COOL),
}


class Job(NamedTuple):
    """The arguments of compiled code, which it brings up to date.

    Attributes:
        setup: Settings.
        state: Modal state.
        position: (axes,) machine position.
        rows: Space for rows.
        unused: Lines of the F and S words that nothing had used before; 0 for none.
    """

    setup: kernel.Setup
    state: NDArray[np.void]
    position: NDArray[np.float64]
    rows: kernel.Rows
    unused: tuple[int, int]


class LineMachine:
    """Gives the state of an interpreter to compiled code, and takes it back."""

    def __init__(self, interpreter: Interpreter) -> None:
        self._interpreter = interpreter
        dialect, axes, policy = interpreter.dialect, interpreter.motion.axes, interpreter.policy
        self._setup = setup = np.zeros(1, kernel.SETUP)[0]
        column = setup["column"]
        column[:] = kernel.OTHER_WORD
        column[[ord(letter) - ord("A") for letter in "NGMFSPIJKRQL"]] = kernel.TAKEN_WORD
        for index, axis in enumerate(axes):
            if axis.upper() in dialect.axes and not interpreter.motion.needs_interpreter(index):
                column[ord(axis.upper()) - ord("A")] = index
        setup["turns"][: len(axes)] = [float(axis in ROTARY_LETTERS) for axis in axes]
        setup["groups"][: len(axes)] = interpreter.motion.groups
        for row, plane in enumerate(_PLANES):
            letters = (*PLANE_AXES[plane], _ACROSS[plane].lower())
            setup["planes"][row] = [axes.index(axis) if axis in axes else -1 for axis in letters]
        for code, group in GROUP_OF_G.items():
            if code >= 0:
                setup["g_group"][code] = _GROUPS.index(group)
        for m, group in GROUP_OF_M.items():
            if m < len(setup["m_group"]):
                setup["m_group"][m] = _GROUPS.index(group)
        setup["m_action"] = kernel.STOP
        for m, action in _M_ACTIONS.items():
            if m in dialect.m and m not in policy.codes and ("M", m) not in dialect.noted:
                setup["m_action"][m] = action
        if dialect.spindle.stops_after_move:
            setup["m_action"][M.M5] = kernel.STOP
        setup["most_line_number"] = dialect.lines.most_number or math.inf
        cycles, dwell = dialect.cycles, dialect.dwell.units
        # The unit of a P with a decimal point is another one.
        if "P" not in dialect.dwell.point:
            setup["dwell"], setup["cycle_dwell"] = dwell.get("P", 0.0), dwell.get("P", 1.0)
        setup["idle_center"], setup["grbl_arcs"] = dialect.arcs.idle_center, dialect.arcs.as_grbl
        setup["dwell_needed"], setup["words_stay"] = cycles.dwell_needed, cycles.words_stay
        setup["repeats_k"], setup["clearance"] = "K" in cycles.repeats, cycles.clearance
        setup["out_to_retract"] = cycles.feed_out_to == "retract"
        self._actions: dict[frozenset[G], NDArray[np.uint8]] = {}
        self._state = np.zeros(1, kernel.STATE)
        self._kinds, self._data = np.empty(0, np.uint8), np.empty((0, 5))

    def leaves(self, letters: list[int], numbers: list[float]) -> bool:
        """Return whether a line has a letter or an M-code that compiled code never executes.

        Args:
            letters: Codes of the letters of its words.
            numbers: Their numbers.
        """
        column, action = self._setup["column"], self._setup["m_action"]
        return any(
            column[letter - ord("A")] == kernel.OTHER_WORD
            or (letter == ord("M") and not (0 <= number < 100 and action[int(number)]))
            for letter, number in zip(letters, numbers, strict=True)
        )

    def ready(self) -> bool:
        """Return whether compiled code supports the modes in effect; take answers of the board."""
        interpreter = self._interpreter
        if (
            not interpreter.plain
            or interpreter.modal.motion not in _MODES
            or interpreter.motion.compensation.active
        ):
            return False
        if interpreter.out.unanswered:
            interpreter.out.take_answers()
        return True

    def begin(self, rows: int) -> Job:
        """Return the state and space for a number of rows."""
        motion = self._interpreter.motion
        unused = self._load()
        self._update_setup()
        return Job(
            self._setup,
            self._state,
            np.array(motion.position),
            self._space(rows + kernel.MOST_ROWS, len(motion.axes)),
            unused,
        )

    def finish(self, job: Job) -> None:
        """Take the state and the rows."""
        self._interpreter.motion.position = job.position.tolist()
        self._give_out(job.rows)
        self._store(job.unused)

    def _space(self, count: int, axes: int) -> kernel.Rows:
        """Return space for rows. Polylines keep the arrays of moves; the others are used again."""
        if len(self._kinds) < count:
            self._kinds, self._data = np.empty(count, np.uint8), np.empty((count, 5))
        return kernel.Rows(
            np.empty((count, axes)),
            np.empty(count),
            np.empty(count, np.int32),
            self._kinds[:count],
            self._data[:count],
        )

    # State

    def _update_setup(self) -> None:
        """Bring the settings up to date that codes can change."""
        interpreter, setup = self._interpreter, self._setup
        modal, motion, dialect = interpreter.modal, interpreter.motion, interpreter.dialect
        arc = dialect.arcs.mm if modal.scale == 1.0 else dialect.arcs.inch
        count = len(motion.axes)
        setup["scale"][:count] = motion.scales
        setup["zero"][:count] = motion.coordinates.zero
        setup["unit"] = modal.scale
        setup["slack"], setup["relative"] = arc.slack, arc.relative
        setup["limit"], setup["reach"] = arc.limit, arc.reach
        setup["arc_absolute"] = modal.arc_absolute
        setup["timed"] = modal.feed_mode == "inverse-time"
        # Compiled code has no limits of the speed: it leaves S to the interpreter under them, too.
        limited = modal.most_rpm > 0.0 or modal.rpm_range != (0.0, math.inf)
        setup["surface_speed"] = modal.constant_surface or limited
        setup["notes"] = interpreter.unused_words.enabled
        setup["restored"] = motion.assumed.restored
        setup["blends"] = modal.path == "blend"
        setup["g_action"] = self._action_of_codes()

    def _action_of_codes(self) -> NDArray[np.uint8]:
        """Return the actions of all G-codes; codes that are in effect already change nothing."""
        interpreter = self._interpreter
        modal, coordinates = interpreter.modal, interpreter.motion.coordinates
        idle = {
            G.G21 if modal.scale == 1.0 else G.G20,
            G.G93 if modal.feed_mode == "inverse-time" else G.G94,
            G.G90_1 if modal.arc_absolute else G.G91_1,
            G.G40,
        }
        current = coordinates.parameters.values.get(CURRENT_SYSTEM)
        if coordinates.system < len(SYSTEM_CODES) and current == coordinates.system + 1.0:
            idle.add(SYSTEM_CODES[coordinates.system])
        if not any(coordinates.tool_offset):
            idle.add(G.G49)
        key = frozenset(idle)
        found = self._actions.get(key)
        if found is None:
            found = self._actions[key] = np.full(1000, kernel.STOP, np.uint8)
            dialect = interpreter.dialect
            actions = {**_ACTIONS, **dict.fromkeys(idle, kernel.IDLE)}
            for code, action in actions.items():
                meant = (
                    code.code in dialect.aliases
                    or code.code in dialect.spelled
                    or ("G", code.code) in dialect.noted
                )
                if code in dialect.g and not meant:
                    found[code] = action
        return found

    def _load(self) -> tuple[int, int]:
        """Copy the modal state for the compiled code; return the lines of unused F and S words."""
        interpreter = self._interpreter
        modal, words = interpreter.modal, interpreter.unused_words.words
        feed, speed = words.get("F"), words.get("S")
        lines = (feed.line if feed else 0, speed.line if speed else 0)
        turning, rpm, surface, _ = interpreter.out.in_effect.get(
            ("spindle", 0), ("", 0.0, 0.0, 0.0)
        )
        resting = interpreter.motion.assumed.resting
        misting, flooding = interpreter.out.in_effect.get(("coolant", 0), (-1, -1))
        self._state[0] = (
            _MODES[modal.motion],
            _MODES[modal.motion if modal.motion in _MOTIONS else resting],
            _PLANES.index(modal.plane),
            modal.absolute,
            _LEVELS.index(modal.initial_level),
            math.nan if modal.feed is None else modal.feed.linear,
            math.nan if modal.feed is None else modal.feed.rotary,
            SPINDLE_STATES.index(modal.spindle),
            math.nan if modal.speed is None else modal.speed,
            modal.mist,
            modal.flood,
            feed.word.number if feed else math.nan,
            lines[0],
            speed.word.number if speed else math.nan,
            lines[1],
            SPINDLE_STATES.index(turning) if turning in SPINDLE_STATES and not surface else -1,
            rpm,
            misting,
            flooding,
            *self._series(),
            0,
        )
        return lines

    def _store(self, before: tuple[int, int]) -> None:
        """Bring modal state and unused words up to date. ``before`` is the result of `_load`."""
        modal = self._interpreter.modal
        (
            mode, resting, plane, absolute, initial, linear, rotary, spindle, speed, mist, flood,
            feed_word, feed_line, speed_word, speed_line, turning, rpm, misting, flooding,
            *series, _,
        ) = self._state[0].item()  # fmt: skip
        modal.motion, assumed = _MOTION_OF.get(mode), self._interpreter.motion.assumed
        assumed.resting = _MOTION_OF[resting]
        if mode == kernel.CANCELLED:
            assumed.cancelled()
        elif modal.motion is not None:
            assumed.end()
        modal.initial_level = _LEVELS[initial]
        modal.plane = _PLANES[plane]
        modal.absolute = bool(absolute)
        if linear == linear:
            modal.feed = Feed(linear, rotary)
        modal.spindle = SPINDLE_STATES[spindle]
        if speed == speed:
            modal.speed = speed
        modal.mist, modal.flood = bool(mist), bool(flood)
        in_effect = self._interpreter.out.in_effect
        if turning >= 0:
            in_effect["spindle", 0] = SPINDLE_STATES[turning], rpm, 0.0, 0.0
        if misting >= 0:
            in_effect["coolant", 0] = bool(misting), bool(flooding)
        self._store_series(*series)
        if self._interpreter.unused_words.enabled:
            self._note("F", feed_word, feed_line, before[0])
            self._note("S", speed_word, speed_line, before[1])

    def _series(self) -> _SeriesState:
        """Return the series: cycle, plane, distance mode, start, words, and lines of words.

        The distance mode is that of the words of its heights, plus 1; 0 where they differ. The
        lines are 0: only those of words that compiled code reads are known.
        """
        start, words = [0.0] * kernel.MOST_AXES, [math.nan] * 4
        series = self._interpreter.drilling_cycles.series
        if series is None:
            return 0, 0, 0, start, words, [0] * len(words)
        start[: len(series.start)] = series.start
        for place, letter in enumerate(_letters(series.plane)):
            if word := series.words.get(letter):
                words[place] = word.number
        modes = {series.absolute[letter] for letter in series.absolute if letter in "XYZR"}
        distance = 1 + modes.pop() if len(modes) == 1 else 0
        plane = _PLANES.index(series.plane)
        return series.cycle // 10, plane, distance, start, words, [0] * len(words)

    def _store_series(
        self, cycle: int, plane: int, distance: int, start: _Numbers, words: _Numbers,
        lines: _Numbers,
    ) -> None:  # fmt: skip
        """Take the series of canned cycles, if compiled code has executed a line of it."""
        interpreter = self._interpreter
        cycles, here = interpreter.drilling_cycles, interpreter.here
        if not cycle or not lines.any():
            return
        before = cycles.series.words if cycles.series else {}
        kept: dict[str, Word] = {}
        for letter, number, line in zip(
            _letters(_PLANES[plane]), words.tolist(), lines.tolist(), strict=True
        ):
            if line:
                found = next(word for word in here.words_of(line) if word.letter == letter)
                kept[letter] = replace(found, number=number)
            elif number == number:
                kept[letter] = before[letter]
        place = start[: len(interpreter.motion.axes)].tolist()
        absolute = dict.fromkeys(kept, distance == 1 + True)
        cycles.series = Series(G(10 * cycle), _PLANES[plane], place, kept, absolute)

    def _note(self, letter: str, number: float, line: int, before: int) -> None:
        """Record the F or S word that nothing has used yet; NaN for none."""
        interpreter = self._interpreter
        if number == number and line == before:
            return
        interpreter.unused_words.mark_used(letter)
        if number == number:
            here = interpreter.here
            word = next(word for word in here.words_of(line) if word.letter == letter)
            word = replace(word, number=number)
            interpreter.unused_words.note(word, line, here.text_of(line))

    def _give_out(self, rows: kernel.Rows) -> None:
        """Put the rows into the buffer of blocks."""
        interpreter, count = self._interpreter, int(self._state[0]["rows"])
        out, laser = interpreter.out, interpreter.policy.laser
        points, feeds, lines = rows.points[:count], rows.feeds[:count], rows.lines[:count]
        others = np.flatnonzero(rows.kinds[:count])
        if not len(others):
            if count:
                out.moves(points, feeds, lines)
            return
        kinds = rows.kinds[others]
        if kernel.PATH in kinds:
            out.in_effect["path", 0] = "blend", interpreter.modal.tolerance
        blocks = RowBlocks(rows, interpreter.here.file, interpreter.modal.tolerance, laser=laser)
        out.mixed(points, feeds, lines, others, blocks.of, kinds == kernel.SPINDLE)


def _letters(plane: Plane) -> str:
    """Return the letters of the words of a series: depth, R, P and Q."""
    return f"{_ACROSS[plane]}RPQ"
