"""Start in the middle of a program (``--from-line N``), with its state restored at a safe height.

The program is read from its first line, so units, plane, distance mode, offsets, feed and
parameters are correct. Motion before line N is skipped. These moves replace it:

        2 ─────────────► 3         1  lift from the present position
        │                │         2  traverse at the safe height
        1                4         3  restore tool, path control, outputs, spindle and coolant;
        │                │            wait for the spindle
        o                x ──► N   4  plunge at the last plunge feed, then continue with line N

The safe height is the highest position of the skipped motion, or the present one if it is higher.
On a machine with limit switches it stays below the switch of Z.

Line N belongs to the main program, and its first execution counts, as in a loop. A call belongs to
its line. A run cannot begin at a line of a subprogram: it would be unclear which call is meant.

A run can also go on after a pause (M0, M6) at which the operator has moved the machine, set a zero
or measured a tool. The same moves lead back to the place of the pause. The pause is the n-th one of
the program, so it may lie in a loop or a subprogram, and the program is read from the position that
it began with.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from cnc.model.blocks import (
    AnalogOutput,
    ArcFeed,
    Block,
    BoardCommand,
    CallBoundary,
    Coolant,
    DigitalOutput,
    Dwell,
    End,
    NurbsFeed,
    Overrides,
    PathMode,
    Polyline,
    Probe,
    Spindle,
    SpindleSync,
    TipControl,
    Tool,
    WaitInput,
    pause_reason,
)
from cnc.model.diagnostics import CncError, Diagnostic, GcodeError, UsageError
from cnc.model.motion_commands import apart
from cnc.model.units import per_minute

# Lines of subprograms, the lines of the main program that call them, and unanswered lines.


def line_of_call(blocks: Iterable[Block], file: str, line: int) -> int:
    """Return the line that first calls the subprogram which a line lies in.

    Args:
        blocks: Blocks of the program, with marks at its calls.
        file: The program.
        line: The line.

    Returns:
        The line of the call, 0 for a line of the main program.
    """
    call, low, high, calling = 0, 0, 0, 0
    for block in apart(blocks):
        if isinstance(block, CallBoundary):
            call, low, high = block.line if block.inside else 0, 0, 0
        elif block.file == file:
            lines = block.lines if isinstance(block, Polyline) else np.array([block.line])
            if not call:
                if (lines == line).any():
                    return 0
                continue
            low, high = min(low or int(lines.min()), int(lines.min())), max(high, int(lines.max()))
            calling = calling or (call if low <= line <= high else 0)
    return calling


def unanswered_line(blocks: Iterable[Block], file: str, line: int) -> int:
    """Return the first line at which a probe or an input decides how the program continues.

    Args:
        blocks: Blocks of the program, with marks at its calls.
        file: The program.
        line: The line up to which to look.

    Returns:
        The line in the main program, 0 for none before ``line``.
    """
    call = 0
    for block in apart(blocks):
        if isinstance(block, CallBoundary):
            call = block.line if block.inside else 0
            continue
        last = int(block.lines.max()) if isinstance(block, Polyline) else block.line
        here = call or (last if block.file == file else 0)
        if here >= line:
            return 0
        if here and isinstance(block, Probe | WaitInput):
            return here
    return 0


Floats = NDArray[np.float64]

SPIN_UP = 4.0
"""Time for the spindle to reach its speed before the plunge, s."""
SHIFT = 1.0
"""Shift of the start position, mm, that shows whether the program depends on it."""
SAME = 1e-6
"""Positions that differ by less are equal, mm."""


@dataclass(frozen=True, slots=True)
class PausePlace:
    """A pause of a program at which a run has ended and another one goes on.

    Attributes:
        number: Pauses of the program up to this one, which is included.
        file: The file of its line.
        line: Its line.
        start: Position before the program (axes,), by which it is read, mm.
        height: Height from which X and Y move freely, mm; None without a move of Z before.
        sets_zeros: Whether the program itself has set zeros or tool data before.
        sha256: Hash of the text of the program.
    """

    number: int
    file: str
    line: int
    start: Floats
    height: float | None
    sets_zeros: bool
    sha256: str


@dataclass(slots=True)
class SkippedState:
    """State after the lines that are skipped.

    Attributes:
        position: End position (axes,), mm.
        touched: Whether each axis has moved (axes,).
        highest: Highest position of each axis (axes,), mm.
        z: Column of the Z axis, None without one.
        plunge: Feed of the last feed move that went down, mm/s; NaN for none.
        feed: The last feed, mm/s; NaN for none.
        tool: Number of the tool.
        spindle: The last spindle block.
        coolant: The last coolant block.
        pauses: Number of pauses for the operator.
        settings: Other blocks in effect, by kind and number.
    """

    position: Floats
    touched: NDArray[np.bool_]
    highest: Floats
    z: int | None
    plunge: float = math.nan
    feed: float = math.nan
    tool: int | None = None
    spindle: Spindle | None = None
    coolant: Coolant | None = None
    pauses: int = 0
    settings: dict[tuple[str, int], Block] = field(default_factory=dict)

    def note(self, block: Block) -> None:
        """Update the state by a skipped block.

        Raises:
            GcodeError: ``from-line-unknown`` if its outcome depends on a board.
        """
        self.pauses += bool(pause_reason(block))
        if isinstance(block, Polyline):
            self._fed(block)
            self._moved(block.points[-1], block.points)
        elif isinstance(block, ArcFeed | NurbsFeed):
            ends = block.end[None, :] if isinstance(block, ArcFeed) else block.control_points
            self._moved(ends[-1], ends)
            self.feed = block.feed
        elif isinstance(block, Spindle):
            self.spindle = block
        elif isinstance(block, Coolant):
            self.coolant = block
        elif isinstance(block, Tool):
            self.tool = block.number
        elif isinstance(block, PathMode | Overrides):
            self.settings[type(block).__name__, 0] = block
        elif isinstance(block, DigitalOutput | AnalogOutput):
            self.settings[type(block).__name__, block.number] = replace(block, with_motion=False)
        elif isinstance(block, TipControl):
            self.position = block.position
            self.settings["TipControl", 0] = block
        elif isinstance(block, SpindleSync):
            self.settings["SpindleSync", 0] = block
        elif isinstance(block, BoardCommand) and block.answer.values:
            self.position = np.array(block.answer.values)
        elif isinstance(block, Probe | WaitInput):
            kind = "a probe" if isinstance(block, Probe) else "an input"
            message = f"the lines after this one depend on {kind} here, whose answer is not known"
            raise _refused(block, message, "begin at or before this line")

    def refuse_coupled(self, file: str, line: int) -> None:
        """Raise GcodeError if the motion at a line depends on more than the position."""
        sync = self.settings.get(("SpindleSync", 0))
        control = self.settings.get(("TipControl", 0))
        if isinstance(sync, SpindleSync) and sync.pitch:
            message, hint = "the motion follows the spindle", "begin before the thread"
        elif isinstance(control, TipControl) and control.offset is not None:
            message = "tool-tip control is on"
            hint = "begin at the line that switches it on, or before"
        else:
            return
        message = f"at line {line} {message}"
        raise GcodeError(Diagnostic("from-line-unknown", message, file, line, hint=hint))

    def _moved(self, end: Floats, points: Floats) -> None:
        self.touched |= (np.abs(points - self.position) > SAME).any(axis=0)
        self.highest = np.maximum(self.highest, points.max(axis=0))
        self.position = end

    @classmethod
    def at(cls, start: Floats, z: int | None) -> SkippedState:
        """Return the state before the first line."""
        return cls(start, np.zeros(len(start), np.bool_), start, z)

    def _fed(self, block: Polyline) -> None:
        feeds = block.feeds
        fed = ~np.isnan(feeds)
        if fed.any():
            self.feed = float(feeds[fed][-1])
        if self.z is not None:
            down = fed & (np.diff(block.points[:, self.z], prepend=self.position[self.z]) < -SAME)
            if down.any():
                self.plunge = float(feeds[down][-1])


def _refused(block: Block, message: str, hint: str) -> GcodeError:
    return GcodeError(Diagnostic("from-line-unknown", message, block.file, block.line, hint=hint))


def at_pause(
    blocks: Iterable[Block], number: int, start: Floats, z: int | None
) -> tuple[SkippedState, Block]:
    """Return the state at the n-th pause of a program, and the block of the pause.

    Args:
        blocks: Blocks of the program.
        number: n, from 1.
        start: Position before the program (axes,), mm.
        z: Column of the Z axis, None without one.

    Raises:
        GcodeError: ``from-line-unknown`` if a run cannot go on from there.
    """
    state = SkippedState.at(start, z)
    for block in apart(blocks):
        if not isinstance(block, CallBoundary):
            state.note(block)
            if state.pauses == number:
                state.refuse_coupled(block.file, block.line)
                return state, block
    message = f"the program has no {number} pauses"
    raise GcodeError(Diagnostic("from-line-unknown", message, hint="stop it, and start it again"))


class RestartPoint:
    """The line to begin at, and the moves that lead to it.

    Args:
        line: The source line, from 1.
        file: The program.
        axes: Letters of the axes, in the order of the columns.
        top: Highest machine coordinate of the Z axis, mm; None if it is not known.
        laser: The spindle is a laser, which has no power before line N.
        pause: The pause after which the run goes on, in place of line N.

    Attributes:
        steps: The steps to the line, in words, after the program has been read that far.
        approach: The places of these steps (axes,), mm, the start position first.
        pauses: Pauses of the program that are skipped.
    """

    def __init__(
        self,
        line: int,
        file: str,
        axes: tuple[str, ...],
        top: float | None,
        *,
        laser: bool = False,
        pause: PausePlace | None = None,
    ) -> None:
        if line < 1:
            message = f"there is no line {line}"
            raise UsageError(Diagnostic("from-line", message, hint="lines count from 1"))
        self.line = line
        self.file = file
        self.steps: tuple[str, ...] = ()
        self.approach: list[Floats] = []
        self.pauses = 0
        self._pause = pause
        self._last_pause = ("", 0)
        self._unnamed = np.zeros(len(axes), np.bool_)
        self._letters = tuple(axis.upper() for axis in axes)
        self._z = axes.index("z") if "z" in axes else None
        self._top = math.inf if top is None else top
        self._laser = laser

    def check(self, read: Callable[[Floats], Iterable[Block]], start: Floats) -> None:
        """Check that the program can begin at line N.

        Args:
            read: Returns the blocks of the program from a start position.
            start: The present position (axes,), mm.

        Raises:
            UsageError: If nothing is done at or after the line.
            GcodeError: If its meaning depends on the start position, or it lies in a subprogram.
        """
        self._refuse_subprogram(read(start))
        first = self._before(read(start), start)
        moved = start + SHIFT
        try:
            second = self._before(read(moved), moved).position
        except CncError:
            # For example, an arc from the present position is not possible there.
            second = moved
        differ = np.abs(first.position - second) > SAME
        unknown = [
            letter
            for letter, differs, touched in zip(self._letters, differ, first.touched, strict=True)
            if differs and touched
        ]
        self._unnamed = differ & ~first.touched
        if unknown:
            where = f"the position of {unknown[0]} at line {self.line}"
            message = f"{where} depends on the position before the program"
            hint = "begin at the first line, or program absolute positions before this line"
            raise self._unknown(message, hint)

    def _refuse_subprogram(self, blocks: Iterable[Block]) -> None:
        """Raise GcodeError if line N lies within the motion of a subprogram only."""
        calling = line_of_call(blocks, self.file, self.line)
        if calling:
            message = f"line {self.line} belongs to a subprogram, which line {calling} calls"
            raise self._unknown(message, f"begin at line {calling}, or at another of its calls")

    def _before(self, blocks: Iterable[Block], start: Floats) -> SkippedState:
        """Return the state before line N."""
        state = SkippedState.at(start, self._z)
        if next(self._rest(blocks, state), None) is None:
            message = f"nothing is done at or after line {self.line}"
            hint = "begin at a line that moves, or before it"
            raise UsageError(Diagnostic("from-line", message, self.file, self.line, hint=hint))
        return state

    def passed(self, blocks: Iterable[Block], start: Floats) -> Iterator[Block]:
        """Yield the blocks to carry out: the moves to line N, then the program from there."""
        pause = self._pause
        state = SkippedState.at(start if pause is None else pause.start, self._z)
        rest = self._rest(blocks, state)
        first = next(rest, None)
        self.pauses = state.pauses
        if pause is not None and (state.pauses, self._last_pause) != (
            pause.number,
            (pause.file, pause.line),
        ):
            message = "the program has no longer its pause at this line"
            raise self._unknown(message, "stop it, and start it again")
        if first is None:
            return
        feed = next(
            (each for each in (state.plunge, state.feed) if not math.isnan(each)), _feed_of(first)
        )
        yield from self._approach(state, start, feed, first.line)
        yield first
        yield from rest

    def _rest(self, blocks: Iterable[Block], state: SkippedState) -> Iterator[Block]:
        """Yield the blocks from line N on; ``state`` becomes the state before them."""
        begun, call = False, 0
        for block in apart(blocks):
            if isinstance(block, CallBoundary):
                call = block.line if block.inside else 0
                continue
            if begun:
                yield block
                continue
            if self._pause is not None:
                passed = state.pauses >= self._pause.number
                before, after = (None, block) if passed else (block, None)
            elif call:
                before, after = (block, None) if call < self.line else (None, block)
            else:
                before, after = self._split(block)
            if before is not None:
                state.note(before)
                if pause_reason(before):
                    self._last_pause = before.file, before.line
            if after is not None and not isinstance(after, End):
                begun = True
                yield after

    def _split(self, block: Block) -> tuple[Block | None, Block | None]:
        """Return the part of a block before line N, and the part from there on."""
        if block.file != self.file:
            return block, None
        if not isinstance(block, Polyline):
            return (block, None) if block.line < self.line else (None, block)
        late = np.flatnonzero(block.lines >= self.line)
        if not len(late):
            return block, None
        k = int(late[0])
        if k == 0:
            return None, block
        head = replace(block, points=block.points[:k], feeds=block.feeds[:k], lines=block.lines[:k])
        tail = replace(
            block,
            line=int(block.lines[k]),
            points=block.points[k:],
            feeds=block.feeds[k:],
            lines=block.lines[k:],
        )
        return head, tail

    def _approach(
        self, state: SkippedState, start: Floats, feed: float, line: int
    ) -> Iterator[Block]:
        """Yield the blocks from the present position to the begin of line N; see the drawing."""
        target, z, top = state.position, self._z, self._top
        self.approach = [np.array(start, np.float64)]
        steps = [
            f"from line {self.line}, in machine coordinates:"
            if self._pause is None
            else f"after line {self.line}, in machine coordinates:"
        ]
        moved = self._pause is not None or bool(state.touched.any())
        state.refuse_coupled(self.file, self.line)
        for coupling in ("SpindleSync", "TipControl"):
            state.settings.pop((coupling, 0), None)
        across = target.copy()
        if z is not None and moved:
            height = max(min(float(state.highest[z]), top), float(start[z]), float(target[z]))
            up = start.copy()
            up[z] = across[z] = height
            if height > start[z] + SAME:
                yield self._traverse(up, line)
                steps.append(f"lift Z to {height:.3f}")
        if moved:
            yield self._traverse(across, line)
            steps.append(f"go to {_listed(zip(self._letters, across, strict=True))}")
        if self._unnamed.any():
            places = zip(self._letters, start, self._unnamed, strict=True)
            kept = _listed((letter, value) for letter, value, unnamed in places if unnamed)
            steps.append(f"stay at {kept}: no line before gives a place there")
        yield from self._restore(state, line, steps)
        if z is not None and across[z] > target[z] + SAME:
            # Where no feed was programmed, the program itself has come here by traverses.
            if math.isnan(feed) and self._pause is None:
                message = f"no feed for the plunge is known at line {self.line}"
                hint = "begin at an earlier line that has F"
                raise GcodeError(
                    Diagnostic("from-line-unknown", message, self.file, line, hint=hint)
                )
            yield self._straight(target, feed, line)
            steps.append(
                f"go down to Z{target[z]:.3f}"
                if math.isnan(feed)
                else f"go down to Z{target[z]:.3f} with F{per_minute(feed):g}"
            )
        spindle = state.spindle
        if self._laser and spindle is not None and spindle.state != "off":
            yield replace(spindle, line=line, with_motion=True)
        self.steps = (*steps, f"continue with line {line}")

    def _restore(self, state: SkippedState, line: int, steps: list[str]) -> Iterator[Block]:
        """Yield the blocks that restore settings, spindle and coolant; add them to ``steps``."""
        for setting in state.settings.values():
            yield replace(setting, file=self.file, line=line)
        if state.tool is not None:
            steps.append(f"tool {state.tool} must be in the spindle")
        spindle, coolant = state.spindle, state.coolant
        if spindle is not None and spindle.state != "off":
            if self._laser:
                yield replace(spindle, line=line, rpm=0.0, with_motion=False)
                steps.append(f"switch the laser on; its power at line {line} is S{spindle.rpm:g}")
            else:
                yield replace(spindle, line=line)
                yield Dwell(self.file, line, SPIN_UP)
                steps.append(
                    f"start the spindle {spindle.state} with {spindle.rpm:g} rpm "
                    f"and wait {SPIN_UP:g} s"
                )
        if coolant is not None and (coolant.mist or coolant.flood):
            yield replace(coolant, line=line)
            both = coolant.mist and coolant.flood
            steps.append("mist and flood on" if both else "mist on" if coolant.mist else "flood on")

    def _unknown(self, message: str, hint: str) -> GcodeError:
        return GcodeError(Diagnostic("from-line-unknown", message, self.file, self.line, hint=hint))

    def _traverse(self, end: Floats, line: int) -> Polyline:
        return self._straight(end, math.nan, line)

    def _straight(self, end: Floats, feed: float, line: int) -> Polyline:
        self.approach.append(np.array(end, np.float64))
        return Polyline(
            self.file, line, end[None, :].copy(), np.array([feed]), np.array([line], np.int32)
        )


def _listed(places: Iterable[tuple[str, float]]) -> str:
    """Return the places of axes as a text, mm."""
    return " ".join(f"{letter}{value:.3f}" for letter, value in places)


def _feed_of(block: Block) -> float:
    """Return the first feed of a block, mm/s; NaN if it has none."""
    if isinstance(block, ArcFeed | NurbsFeed):
        return block.feed
    if isinstance(block, Polyline):
        programmed = block.feeds[~np.isnan(block.feeds)]
        return float(programmed[0]) if len(programmed) else math.nan
    return math.nan
