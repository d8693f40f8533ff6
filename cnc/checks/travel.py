"""Travel check of a path: extent, moves outside the travel, feeds of threads, times under G93."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cnc.machine.load import is_default
from cnc.machine.models import Axis, Machine
from cnc.model.blocks import ROTARY_LETTERS, Block, SpindleSync
from cnc.model.diagnostics import Diagnostic, MotionLimitError
from cnc.path.build import DueTimes, Place
from cnc.path.chunk import PathChunk, bounding_box
from cnc.path.kernels.curve import AXES, LENGTH, START
from cnc.planner.plan import PlanChunk

ROUNDING = 1e-6
"""mm or degrees. Rounding alone may take a move that ends on the limit this far beyond it."""

TURN = 360.0

Floats = NDArray[np.float64]


class TravelCheck:
    """Measures a path chunk by chunk and compares it with the travel of the axes.

    Args:
        machine: gives the travel and the highest speed of each axis.

    Attributes:
        length: path length so far, mm.
        lo: (columns,) smallest position so far, infinite before the first chunk; the columns of
            the axes, then those of the joints, if these are not the axes.
        hi: (columns,) largest position so far.
        last_line: source line of the last motion.
    """

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        self.length = 0.0
        self.last_line = 0
        self._tables: list[tuple[str, str, Axis]] = []
        self._tables += [("axes", letter, axis) for letter, axis in machine.axes.items()]
        if machine.kinematics.with_tip_control:
            # The travel is that of the joints, which have the names and the tables of the axes.
            free = [axis.model_copy(update={"travel": None}) for _, _, axis in self._tables]
            tip = zip(machine.axes, free, strict=True)
            self._tables = [*(("axes", letter, axis) for letter, axis in tip), *self._tables]
        elif machine.is_compensated:
            # The travel holds for true places. A motor at rest is on a step beside its place.
            free = [axis.model_copy(update={"travel": None}) for _, _, axis in self._tables]
            self._tables += [
                ("axes", letter, axis) for letter, axis in zip(machine.axes, free, strict=True)
            ]
        elif machine.kinematics.joints:
            joints = machine.joint_tables.items()
            self._tables += [("joints", name, joint) for name, joint in joints]
        n = len(self._tables)
        self.lo: Floats = np.full(n, np.inf)
        self.hi: Floats = np.full(n, -np.inf)
        travels = [axis.travel or (-np.inf, np.inf) for _, _, axis in self._tables]
        # The travel of an axis that repeats after a turn holds for the place within the turn.
        self._repeats = np.array([axis.wrap is not None for _, _, axis in self._tables])
        slacks = np.full(n, ROUNDING)
        if machine.is_compensated:
            steps = 1.0 / machine.steps_per_mm
            slacks = np.maximum(slacks, np.concatenate((steps, steps)))
        self._lowest = np.array([low for low, _ in travels]) - slacks
        self._highest = np.array([high for _, high in travels]) + slacks
        self._reported: set[tuple[int, int]] = set()
        self._pitch = 0.0
        self._begun = False
        self._max_velocity = np.array([axis.max_velocity for _, _, axis in self._tables])

    def add(self, chunk: PathChunk) -> Iterator[MotionLimitError]:
        """Measure a chunk.

        The whole curve counts, so that the bulge of an arc or spline is compared as well.

        Yields:
            A ``soft-limit`` fault, without the text of the line, for each line and axis that
            leaves the travel. A ``spindle-too-fast`` fault for moves that would have to follow the
            spindle faster than the machine can: a lower feed would spoil the thread.
        """
        if self._pitch:
            yield from self._check_synchronized(chunk)
        lo, hi = bounding_box(chunk)
        self.length += float(chunk.length.sum())
        self.lo = np.minimum(self.lo, lo.min(axis=0))
        self.hi = np.maximum(self.hi, hi.max(axis=0))
        self.last_line = int(chunk.line[-1])
        if self._repeats.any():
            with np.errstate(invalid="ignore"):
                turns = np.floor((lo - self._lowest) / TURN)
            turns = np.where(self._repeats & np.isfinite(turns), TURN * turns, 0.0)
            lo, hi = lo - turns, hi - turns
            hi = np.where(self._repeats & (self._highest - self._lowest >= TURN), lo, hi)
        outside = (lo < self._lowest) | (hi > self._highest)
        start = None
        if not self._begun and len(chunk):
            self._begun = True
            first = int(chunk.at[0]) + START
            start = chunk.data[first : first + outside.shape[1]]
        if outside.any():
            for piece, axis in np.argwhere(outside).tolist():
                line = int(chunk.line[piece])
                if (line, axis) not in self._reported:
                    self._reported.add((line, axis))
                    # A move of joints consists of several pieces.
                    whole = (chunk.line == line) & (not self._repeats[axis])
                    whole[piece] = True
                    if start is not None and piece == 0:
                        place = float(start[axis])
                        if not self._repeats[axis] and not self._allows(axis, place):
                            yield self._begins_outside(chunk, line, axis, place)
                            continue
                    lowest, highest = lo[whole, axis].min(), hi[whole, axis].max()
                    yield self._fault(chunk, line, axis, float(lowest), float(highest))

    def between(self, block: Block) -> None:
        """Take a block between the moves into account."""
        if isinstance(block, SpindleSync):
            self._pitch = block.pitch

    def _check_synchronized(self, chunk: PathChunk) -> Iterator[MotionLimitError]:
        """Check straight moves that all follow the spindle."""
        max_feed = self.machine.path.max_feed
        for at, feed, line in zip(
            chunk.at.tolist(), chunk.feed.tolist(), chunk.line.tolist(), strict=True
        ):
            n = int(chunk.data[at + AXES])
            start, end = chunk.data[at + START : at + START + 2 * n].reshape(2, n)
            speed = np.abs(end - start) / chunk.data[at + LENGTH] * feed
            excess = float(max((speed / self._max_velocity).max(), feed / max_feed))
            if excess > 1.0 + ROUNDING and (line, -1) not in self._reported:
                self._reported.add((line, -1))
                message = (
                    f"to follow the spindle the tool would have to move at {feed:.7g} mm/s, "
                    f"{excess:.3g} times the highest speed of the machine"
                )
                hint = (
                    "lower S, or raise max_velocity of the axes or path.max_feed in the machine "
                    "file if the machine permits"
                )
                yield MotionLimitError(
                    Diagnostic("spindle-too-fast", message, chunk.file, line, hint=hint)
                )

    def box(self) -> dict[str, tuple[float, float]]:
        """Return (smallest, largest) position by axis; empty without motion."""
        if not np.isfinite(self.lo).all():
            return {}
        return {
            axis: (low, high)
            for axis, low, high in zip(
                self.machine.axes, self.lo.tolist(), self.hi.tolist(), strict=False
            )
        }

    def _allows(self, axis: int, place: float) -> bool:
        return bool(self._lowest[axis] <= place <= self._highest[axis])

    def _begins_outside(
        self, chunk: PathChunk, line: int, axis: int, place: float
    ) -> MotionLimitError:
        """Return the fault of a program that begins outside the travel of an axis."""
        table, letter, limits = self._tables[axis]
        lowest, highest = limits.travel or (-np.inf, np.inf)
        name = f"joint {letter} " if table == "joints" else letter.upper()
        message = (
            f"the program begins at {name}{_plain(place)}; "
            f"the travel is {_plain(lowest)} to {_plain(highest)}"
        )
        hint = (
            "write where the machine stands into [machine] start of the machine file, home it "
            f"before the program, or correct {table}.{letter}.travel"
        )
        return MotionLimitError(Diagnostic("soft-limit", message, chunk.file, line, hint=hint))

    def _fault(
        self, chunk: PathChunk, line: int, axis: int, lo: float, hi: float
    ) -> MotionLimitError:
        table, letter, limits = self._tables[axis]
        lowest, highest = limits.travel or (-np.inf, np.inf)
        unit = "degrees" if letter in ROTARY_LETTERS else "mm"
        name = letter.upper()
        if table == "joints":
            unit, name = "", f"joint {letter}"
        reached = hi if hi > self._highest[axis] else lo
        message = (
            f"{name} would reach {_plain(reached)} {unit}; "
            f"the travel is {_plain(lowest)} to {_plain(highest)} {unit}"
        )
        hint = (
            f"move the work offset or the part, or correct {table}.{letter}.travel in the machine "
            "file; positions are machine coordinates, after all offsets"
        )
        if is_default(self.machine):
            hint = (
                f"this is the travel of the default machine; name yours: --machine FILE; or {hint}"
            )
        return MotionLimitError(Diagnostic("soft-limit", message, chunk.file, line, hint=hint))


def _plain(value: float) -> str:
    """Return a coordinate with 7 digits, enough for a small excess over a round limit."""
    return f"{value:.7g}"


# Times of blocks under inverse time feed (G93): 1/F minutes, unless a limit forbids it.
#
# The planner never exceeds the feed at which the programmed length of a block takes its time. So a
# block that has to speed up, to slow down or to keep a limit takes longer. One whose path a blend
# or a fit makes shorter may take less.

LATE = "the machine has to speed up and slow down, or keeps a limit: give a smaller F"
EARLY = "a blend or a fit (G64) shortens the path of the block: use a smaller tolerance, or G61"


class BlockTimes:
    """Compares the times of blocks in a plan with those of their F words.

    A fit may make one piece of several blocks; they count as one block at the first line. A blend
    between two blocks counts as part of the one whose line the plan gives it.

    Args:
        due: the times of the F words, in the order of the plan.
        period: difference that is not reported, s.
    """

    def __init__(self, due: DueTimes, period: float) -> None:
        self._due, self._period = due, period
        self._place: Place | None = None
        self._wanted = self._taken = 0.0

    def add(self, item: PlanChunk | Block) -> Iterator[Diagnostic]:
        """Yield a note for each block that has ended before an item, and takes another time."""
        if not isinstance(item, PlanChunk) or not item.path.timed:
            return
        file = item.path.file
        for line, actual in item.line_times():
            if (file, line) != self._place:
                yield from self._ended((file, line))
            self._wanted += self._due.at((file, line))
            self._taken += actual

    def end(self) -> Iterator[Diagnostic]:
        """Yield the note of the last block."""
        yield from self._ended(None)

    def _ended(self, following: Place | None) -> Iterator[Diagnostic]:
        """Yield the note of the present block, when another one begins."""
        between = self._due.before(following)
        late = self._taken - self._wanted - between
        # A traverse has no feed: its time is not a number, and it is not reported.
        if self._place is not None and abs(late) > self._period:
            wanted = self._wanted + between
            message = f"the block takes {self._taken:.4f} s; F is {wanted:.4f} s"
            hint = LATE if late > 0.0 else EARLY
            yield Diagnostic("block-time", message, *self._place, severity="note", hint=hint)
        # Blocks without a piece at the start of the plan count as part of the first one.
        self._wanted = between if self._place is None else 0.0
        self._place, self._taken = following, 0.0
