"""The modal state for compiled code (:mod:`cnc.kernels.gcode.line`), and its rows as blocks."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.gcode.codes.axis_words import MIN_FEED
from cnc.gcode.codes.machine_codes import LONG_DWELL
from cnc.gcode.program.interpreter import Interpreter
from cnc.gcode.state.coordinates import SYSTEM_CODES
from cnc.gcode.state.modal_groups import GROUP_OF_G, PLANES, Feed
from cnc.gcode.syntax.code_numbers import G, M
from cnc.kernels.gcode import line as kernel
from cnc.kernels.gcode.arcs import Tolerance
from cnc.model.blocks import (
    PLANE_AXES,
    ROTARY_LETTERS,
    ArcFeed,
    Block,
    CallBoundary,
    Coolant,
    Dwell,
    Spindle,
)
from cnc.model.parameter_numbers import CURRENT_SYSTEM

MOST_ROWS = 8192
"""Rows that are taken from compiled code at once; this limits the memory."""

_MOTIONS = (G.G0, G.G1, G.G2, G.G3)
_PLANES = tuple(PLANES.values())
_SPINDLE: tuple[Literal["off", "cw", "ccw"], ...] = ("off", "cw", "ccw")
_GROUPS = {group: index for index, group in enumerate(dict.fromkeys(GROUP_OF_G.values()))}
_ACTIONS = {
    **dict.fromkeys(_MOTIONS, kernel.MOVE),
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
        self._column = np.full(26, kernel.OTHER_WORD, np.int64)
        self._column[[ord(letter) - ord("A") for letter in "NGMFSPIJKR"]] = kernel.TAKEN_WORD
        for index, axis in enumerate(axes):
            if axis.upper() in dialect.axes:
                self._column[ord(axis.upper()) - ord("A")] = index
        self._turns = np.array([float(axis in ROTARY_LETTERS) for axis in axes])
        self._planes = np.array(
            [
                [axes.index(axis) if axis in axes else -1 for axis in PLANE_AXES[plane]]
                for plane in _PLANES
            ]
        )
        self._group = np.zeros(1000, np.uint8)
        for code, group in GROUP_OF_G.items():
            if code in dialect.g and code >= 0:
                self._group[code] = _GROUPS[group]
        self._m_action = np.full(100, kernel.STOP, np.uint8)
        for m, action in _M_ACTIONS.items():
            if m in dialect.m and m not in policy.codes and ("M", m) not in dialect.noted:
                self._m_action[m] = action
        self._actions: dict[frozenset[G], NDArray[np.uint8]] = {}
        self._state = np.zeros(1, kernel.STATE)

    def ready(self) -> bool:
        """Return whether compiled code supports the modes in effect; take answers of the board."""
        interpreter = self._interpreter
        if not interpreter.plain or interpreter.motion.compensation.active:
            return False
        if interpreter.out.unanswered:
            interpreter.out.take_answers()
        return True

    def begin(self, rows: int) -> Job:
        """Return the state and space for a number of rows."""
        motion = self._interpreter.motion
        unused = self._load()
        return Job(
            self._setup(),
            self._state,
            np.array(motion.position),
            _rows(rows + kernel.MOST_ROWS, len(motion.axes)),
            unused,
        )

    def finish(self, job: Job) -> None:
        """Take the state and the rows."""
        self._interpreter.motion.position = job.position.tolist()
        self._give_out(job.rows)
        self._store(job.unused)

    # State

    def _setup(self) -> kernel.Setup:
        interpreter = self._interpreter
        modal, motion, dialect = interpreter.modal, interpreter.motion, interpreter.dialect
        arc = dialect.arc_mm if modal.scale == 1.0 else dialect.arc_inch
        return kernel.Setup(
            self._column,
            np.array(motion.scales),
            np.array(motion.coordinates.zero),
            self._turns,
            self._planes,
            self._action_of_codes(),
            self._group,
            self._m_action,
            Tolerance(arc.slack, arc.relative, arc.limit, arc.reach),
            kernel.Rules(
                unit=modal.scale,
                min_feed=MIN_FEED,
                arc_absolute=modal.arc_absolute,
                idle_center=dialect.arc_idle_center,
                surface_speed=modal.constant_surface,
                notes=interpreter.unused_words.enabled,
                dwell=0.0 if "P" in dialect.dwell_point else dialect.dwell.get("P", 0.0),
                longest_dwell=LONG_DWELL,
            ),
        )

    def _action_of_codes(self) -> NDArray[np.uint8]:
        """Return the actions of all G-codes; codes that are in effect already change nothing."""
        interpreter = self._interpreter
        modal, coordinates = interpreter.modal, interpreter.motion.coordinates
        idle = {
            G.G21 if modal.scale == 1.0 else G.G20,
            G.G94,
            G.G90_1 if modal.arc_absolute else G.G91_1,
            G.G98 if modal.initial_level else G.G99,
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
            for code, action in {**_ACTIONS, **dict.fromkeys(idle, kernel.IDLE)}.items():
                meant = code.code in dialect.aliases or ("G", code.code) in dialect.noted
                if code in dialect.g and not meant:
                    found[code] = action
            if dialect.after_g80 != "none":
                found[G.G80] = kernel.STOP
        return found

    def _load(self) -> tuple[int, int]:
        """Copy the modal state for the compiled code; return the lines of unused F and S words."""
        modal, words = self._interpreter.modal, self._interpreter.unused_words.words
        feed, speed = words.get("F"), words.get("S")
        lines = (feed.line if feed else 0, speed.line if speed else 0)
        self._state[0] = (
            kernel.NO_MOTION if modal.motion is None else _MOTIONS.index(modal.motion),
            _PLANES.index(modal.plane),
            modal.absolute,
            math.nan if modal.feed is None else modal.feed.linear,
            math.nan if modal.feed is None else modal.feed.rotary,
            _SPINDLE.index(modal.spindle),
            math.nan if modal.speed is None else modal.speed,
            modal.mist,
            modal.flood,
            feed.word.number if feed else math.nan,
            lines[0],
            speed.word.number if speed else math.nan,
            lines[1],
            0,
            0,
        )
        return lines

    def _store(self, before: tuple[int, int]) -> None:
        """Bring modal state and unused words up to date. ``before`` is the result of `_load`."""
        modal = self._interpreter.modal
        (
            mode, plane, absolute, linear, rotary, spindle, speed, mist, flood,
            feed_word, feed_line, speed_word, speed_line, _, _,
        ) = self._state[0].item()  # fmt: skip
        modal.motion = None if mode == kernel.NO_MOTION else _MOTIONS[mode]
        modal.plane = _PLANES[plane]
        modal.absolute = bool(absolute)
        if linear == linear:
            modal.feed = Feed(linear, rotary)
        modal.spindle = _SPINDLE[spindle]
        if speed == speed:
            modal.speed = speed
        modal.mist, modal.flood = bool(mist), bool(flood)
        if self._interpreter.unused_words.enabled:
            self._note("F", feed_word, feed_line, before[0])
            self._note("S", speed_word, speed_line, before[1])

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

    # Blocks

    def _give_out(self, rows: kernel.Rows) -> None:
        """Put the rows into the buffer of blocks."""
        interpreter, count = self._interpreter, int(self._state[0]["rows"])
        out = interpreter.out
        begin = 0
        others = np.flatnonzero(rows.kinds[:count])
        for row, block in zip(others.tolist(), self._blocks(rows, others), strict=True):
            if row > begin:
                out.moves(rows.points[begin:row], rows.feeds[begin:row], rows.lines[begin:row])
            if block.__class__ is ArcFeed:
                out.flush()
                out.ready.append(block)
            else:
                out.add(block)
            begin = row + 1
        if count > begin:
            out.moves(rows.points[begin:count], rows.feeds[begin:count], rows.lines[begin:count])

    def _blocks(self, rows: kernel.Rows, numbers: NDArray[np.intp]) -> Iterator[Block]:
        """Yield the blocks of rows that are no straight moves."""
        file, laser = self._interpreter.here.file, self._interpreter.policy.laser
        for kind, line, data, end, feed in zip(
            rows.kinds[numbers].tolist(),
            rows.lines[numbers].tolist(),
            rows.data[numbers].tolist(),
            rows.points[numbers],
            rows.feeds[numbers].tolist(),
            strict=True,
        ):
            first, second, radius, turns, plane = data
            if kind == kernel.ARC:
                yield ArcFeed(
                    file, line, _PLANES[int(plane)], (first, second), end, radius, turns, feed
                )
            elif kind == kernel.SPINDLE:
                speed = (second or 0.0) if first else 0.0
                with_motion = laser and bool(radius)
                yield Spindle(file, line, _SPINDLE[int(first)], speed, with_motion=with_motion)
            elif kind == kernel.COOLANT:
                yield Coolant(file, line, bool(first), bool(second))
            elif kind == kernel.BOUNDARY:
                # Calls of the main program are marked, whose file this is.
                yield CallBoundary(file, line, bool(first))
            else:
                yield Dwell(file, line, first)


def _rows(count: int, axes: int) -> kernel.Rows:
    """Return space for rows."""
    space: Any = np.empty
    return kernel.Rows(
        space((count, axes)),
        space(count),
        space(count, np.int32),
        space(count, np.uint8),
        space((count, 5)),
    )
