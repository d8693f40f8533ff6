"""Beginning in the middle of a program (``--from-line``): its state is restored first, at a safe
height.

The program is read from its first line, so units, plane, distance mode, offsets, feed and
parameters are what they would be; what moves before line N is left out. What is carried out
instead:

        2 ─────────────► 3         1  up from where the machine stands
        │                │         2  across, at the height
        1                4         3  tool, path control, outputs, spindle, coolant as they were, and a pause for the spindle
        o                x ──► N   4  down at the feed of the last way down, then on with line N

The height is the highest that the program itself comes to, or the machine stands at.

Line N is one of the main program, reached for the first time: of a loop the first time round, and a
call is part of the line that it stands at. A line of a subprogram is no place to begin: which of
its calls is meant nobody knows.
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
    Tool,
    WaitInput,
)
from cnc.model.diagnostics import CncError, Diagnostic, GcodeError, UsageError
from cnc.model.units import per_minute

Floats = NDArray[np.float64]

SPIN_UP = 4.0
"""Seconds for a spindle to reach its speed before the tool goes down."""
SHIFT = 1.0
"""mm by which the start is moved to see whether the program's meaning depends on it."""
SAME = 1e-6
"""mm: positions that differ by less are the same."""


@dataclass(slots=True)
class State:
    """What the lines before have left.

    position (axes,); touched: whether each axis was moved; highest: the highest position of each;
    z: column of the Z axis, None without one; feed: mm/s; plunge: mm/s of the last feed move that
    went down; tool; settings: what else is in effect.
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
    settings: dict[tuple[str, int], Block] = field(default_factory=dict)

    def note(self, block: Block) -> None:
        """A block that is left out. GcodeError ``from-line-unknown`` for one whose outcome nobody
        knows.
        """
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
        elif isinstance(block, SpindleSync):
            self.settings["SpindleSync", 0] = block
        elif isinstance(block, Probe | WaitInput):
            what = "a probe" if isinstance(block, Probe) else "an input"
            raise _refused(
                block,
                f"what follows depends on {what} here, whose answer is not known",
                "begin at or before this line",
            )

    def _moved(self, end: Floats, points: Floats) -> None:
        self.touched |= (np.abs(points - self.position) > SAME).any(axis=0)
        self.highest = np.maximum(self.highest, points.max(axis=0))
        self.position = end

    @classmethod
    def at(cls, start: Floats, z: int | None) -> State:
        """Before the first line."""
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


def line_of_call(blocks: Iterable[Block], file: str, line: int) -> int:
    """Where a program calls the subprogram that a line lies in for the first time; 0 for a line of
    the main program.

    blocks: of the program, with its calls.
    """
    call, low, high, found = 0, 0, 0, 0
    for block in blocks:
        if isinstance(block, CallBoundary):
            call, low, high = block.line if block.inside else 0, 0, 0
        elif block.file == file:
            lines = block.lines if isinstance(block, Polyline) else np.array([block.line])
            if not call:
                if (lines == line).any():
                    return 0
                continue
            low, high = min(low or int(lines.min()), int(lines.min())), max(high, int(lines.max()))
            found = found or (call if low <= line <= high else 0)
    return found


class Beginning:
    """Where to begin, and how to get there.

    line: the source line, from 1. file: the program. axes: names of the columns. top: highest
    machine coordinate of the Z axis, None without travel. ``story`` says what will be done, once
    the program has been read that far.
    """

    def __init__(self, line: int, file: str, axes: tuple[str, ...], top: float | None) -> None:
        if line < 1:
            raise UsageError(
                Diagnostic("from-line", f"there is no line {line}", hint="lines count from 1")
            )
        self.line = line
        self.file = file
        self.story: tuple[str, ...] = ()
        self._letters = tuple(axis.upper() for axis in axes)
        self._z = axes.index("z") if "z" in axes else None
        self._top = math.inf if top is None else top

    def check(self, read: Callable[[Floats], Iterable[Block]], start: Floats) -> None:
        """UsageError, GcodeError where it can't be told what line N means: it is not there, or
        depends on where the machine stood.

        read: the blocks of the program for a machine that stands somewhere.
        """
        self._refuse_subprogram(read(start))
        first = self._before(read(start), start)
        moved = start + SHIFT
        try:
            second = self._before(read(moved), moved).position
        except CncError:
            # such as an arc from where the machine stands
            second = moved
        differ = np.abs(first.position - second) > SAME
        unknown = [
            letter
            for letter, differs, touched in zip(self._letters, differ, first.touched, strict=True)
            if differs and touched
        ]
        if unknown:
            message = f"where {unknown[0]} is at line {self.line} depends on where the machine stood when the program began"
            hint = (
                "begin at the first line, or let the program say absolute positions before this one"
            )
            raise GcodeError(
                Diagnostic("from-line-unknown", message, self.file, self.line, hint=hint)
            )

    def _refuse_subprogram(self, blocks: Iterable[Block]) -> None:
        """GcodeError if line N lies between the lines of a subprogram's motion, and is none of the
        main program's.
        """
        found = line_of_call(blocks, self.file, self.line)
        if found:
            message = f"line {self.line} is one of a subprogram, called at line {found}"
            hint = f"begin at line {found}, or at another of its calls"
            raise GcodeError(
                Diagnostic("from-line-unknown", message, self.file, self.line, hint=hint)
            )

    def _before(self, blocks: Iterable[Block], start: Floats) -> State:
        """The state before line N."""
        state = State.at(start, self._z)
        if next(self._rest(blocks, state), None) is None:
            hint = "name a line of the program that moves, or one before it"
            raise UsageError(
                Diagnostic(
                    "from-line",
                    f"nothing is done at or after line {self.line}",
                    self.file,
                    self.line,
                    hint=hint,
                )
            )
        return state

    def passed(self, blocks: Iterable[Block], start: Floats) -> Iterator[Block]:
        """The blocks to carry out: the way to line N, then the program from there."""
        state = State.at(start, self._z)
        rest = self._rest(blocks, state)
        first = next(rest, None)
        if first is None:
            return
        feed = next(
            (each for each in (state.plunge, state.feed) if not math.isnan(each)), _feed_of(first)
        )
        yield from self._approach(state, start, feed, first.line)
        yield first
        yield from rest

    def _rest(self, blocks: Iterable[Block], state: State) -> Iterator[Block]:
        """What is left of a program from line N on; ``state`` is that before it."""
        begun, call = False, 0
        for block in blocks:
            if isinstance(block, CallBoundary):
                call = block.line if block.inside else 0
                continue
            if begun:
                yield block
                continue
            here, later = (
                self._split(block)
                if not call
                else (block, None)
                if call < self.line
                else (None, block)
            )
            if here is not None:
                state.note(here)
            if later is not None and not isinstance(later, End):
                begun = True
                yield later

    def _split(self, block: Block) -> tuple[Block | None, Block | None]:
        """The part of a block that lies before line N, and the one from there on."""
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

    def _approach(self, state: State, start: Floats, feed: float, line: int) -> Iterator[Block]:
        """From where the machine stands to where line N begins."""
        file, target, z = self.file, state.position, self._z
        away = bool(state.touched.any())
        sync = state.settings.pop(("SpindleSync", 0), None)
        if isinstance(sync, SpindleSync) and sync.pitch:
            message = f"at line {self.line} the motion follows the spindle"
            raise GcodeError(
                Diagnostic("from-line-unknown", message, file, line, hint="begin before the thread")
            )
        story = [f"from line {self.line}:"]
        across = target.copy()
        if z is not None and away:
            height = max(min(float(state.highest[z]), self._top), float(start[z]), float(target[z]))
            if height <= target[z] + SAME and self._top < math.inf:
                height = max(height, self._top)
            up = start.copy()
            up[z] = across[z] = height
            if height > start[z] + SAME:
                yield self._traverse(up, line)
                story.append(f"lift Z to {height:.3f}")
        if away:
            yield self._traverse(across, line)
            story.append(
                "go to "
                + " ".join(
                    f"{letter}{value:.3f}"
                    for letter, value in zip(self._letters, across, strict=True)
                )
            )
        yield from state.settings.values()
        if state.tool is not None:
            story.append(f"tool {state.tool} is taken to be in the spindle")
        if state.spindle is not None and state.spindle.state != "off":
            yield replace(state.spindle, line=line)
            yield Dwell(file, line, SPIN_UP)
            story.append(
                f"start the spindle {state.spindle.state} with {state.spindle.rpm:g} rpm and wait {SPIN_UP:g} s"
            )
        if state.coolant is not None and (state.coolant.mist or state.coolant.flood):
            yield replace(state.coolant, line=line)
            story.append(
                " and ".join(
                    name
                    for name, on in (("mist", state.coolant.mist), ("flood", state.coolant.flood))
                    if on
                )
                + " on"
            )
        if z is not None and across[z] > target[z] + SAME:
            if math.isnan(feed):
                message = f"no feed is known at line {self.line} to go down with"
                raise GcodeError(
                    Diagnostic(
                        "from-line-unknown",
                        message,
                        file,
                        line,
                        hint="begin at a line before that has F",
                    )
                )
            yield Polyline(
                file, line, target[None, :].copy(), np.array([feed]), np.array([line], np.int32)
            )
            story.append(f"go down to Z{target[z]:.3f} with F{per_minute(feed):g}")
        self.story = (*story, f"go on with line {line}")

    def _traverse(self, end: Floats, line: int) -> Polyline:
        return Polyline(
            self.file, line, end[None, :].copy(), np.array([math.nan]), np.array([line], np.int32)
        )


def _feed_of(block: Block) -> float:
    """The first feed of a block, NaN if it has none."""
    if isinstance(block, ArcFeed | NurbsFeed):
        return block.feed
    if isinstance(block, Polyline):
        known = block.feeds[~np.isnan(block.feeds)]
        return float(known[0]) if len(known) else math.nan
    return math.nan
