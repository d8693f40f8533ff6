"""Records of the pieces of a block that moves, and the checks of its numbers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.kernels.path.curve import START
from cnc.model.blocks import PLANE_AXES, ArcFeed, Block, NurbsFeed, Polyline
from cnc.model.diagnostics import Diagnostic, GcodeError
from cnc.model.motion_commands import Commands
from cnc.path.gatherer import MOST_PIECES
from cnc.path.records import Floats, Records, arc_records, line_records, moving, spline_records
from cnc.path.standing_tip import with_standing_tip

JOIN = 1e-6
"""mm. A NURBS whose first control point is this near to the position is moved there. A larger
distance is an error.
"""


@dataclass(frozen=True, slots=True)
class Frame:
    """Axes of the path: their names, their classes (n,), and the accuracy of arc lengths (mm)."""

    axes: tuple[str, ...]
    classes: NDArray[np.int64]
    accuracy: float


def pieces_of(
    block: Polyline | ArcFeed | NurbsFeed,
    position: Floats,
    frame: Frame,
    *,
    exact_stop: bool,
) -> Iterator[tuple[Records, Floats, NDArray[np.int32], NDArray[np.bool_], Commands | None]]:
    """Yield records of one block, with feed, line and stop of each piece, and the commands.

    ``position`` (n,) is moved along. exact_stop: motion rests at the end of the block.
    """
    axes, classes, accuracy = frame.axes, frame.classes, frame.accuracy
    if isinstance(block, Polyline):
        here = position.copy()
        for moves, feeds, lines, commands in moves_of(block, position):
            stops = np.full(len(moves), exact_stop)
            yield line_records(here, moves, classes), feeds, lines, stops, commands
            here[:] = moves[-1]
        return
    if isinstance(block, ArcFeed):
        check_finite(
            block,
            block.end,
            np.array([*block.center, block.radius, block.turns]),
            np.array(block.feed),
        )
        first_axis, second_axis = PLANE_AXES[block.plane]
        plane = axes.index(first_axis), axes.index(second_axis)
        end = np.array(block.end, np.float64)
        runs = arc_records(
            position.copy(), end, plane, block.center, block.turns, classes, accuracy
        )
    else:
        check_finite(block, block.knots, block.control_points, block.weights, np.array(block.feed))
        points = joined(block, position)
        runs = spline_records(block.degree, block.knots, points, block.weights, classes, accuracy)
    # Only an axis that does not measure the length may go on while the others stand.
    paced: Iterable[tuple[Records, float]] = ((records, 1.0) for records in runs)
    if isinstance(block, NurbsFeed) and np.ptp(points[:, classes != 0], axis=0).any():
        paced = with_standing_tip(runs, classes, accuracy)
    last: tuple[Records, float] | None = None
    for each in paced:
        if last is not None:
            yield *_spread(block, *last, stop=False), None
        last = each
    if last is not None:
        position[:] = _end_of(last[0], len(axes))
        yield *_spread(block, *last, stop=exact_stop), None


def moves_of(
    block: Polyline, position: Floats
) -> Iterator[tuple[Floats, Floats, NDArray[np.int32], Commands | None]]:
    """Yield ends, feeds, lines and commands of the moves with a length, MOST_PIECES at a time.

    ``position`` (n,) is moved along. With commands, all moves must have a length.
    """
    _check_polyline(block)
    for first in range(0, len(block.points), MOST_PIECES):
        part = slice(first, first + MOST_PIECES)
        points, feeds, lines = block.points[part], block.feeds[part], block.lines[part]
        keep = moving(position, points)
        commands = None if block.commands is None else block.commands[part]
        if not keep.all():
            points, feeds, lines = points[keep], feeds[keep], lines[keep]
        if len(points):
            position[:] = points[-1]
            yield points, feeds.astype(np.float64), lines.astype(np.int32), commands


def _spread(
    block: ArcFeed | NurbsFeed, records: Records, factor: float, *, stop: bool
) -> tuple[Records, Floats, NDArray[np.int32], NDArray[np.bool_]]:
    """Return records with the feed, line and stop of each piece; a stop comes after the last.

    factor: of the feed.
    """
    count = len(records.at)
    stops = np.zeros(count, np.bool_)
    stops[-1] = stop
    return records, np.full(count, factor * block.feed), np.full(count, block.line, np.int32), stops


def _end_of(records: Records, n: int) -> Floats:
    """Return the end point (n,) of the last piece."""
    at = int(records.at[-1]) + START + n
    return records.data[at : at + n]


def _error(block: Block, code: str, message: str, hint: str, line: int | None = None) -> GcodeError:
    return GcodeError(
        Diagnostic(
            code, message, file=block.file, line=block.line if line is None else line, hint=hint
        )
    )


def _not_finite(block: Block, line: int) -> GcodeError:
    return _error(
        block,
        "not-finite",
        "a coordinate or feed of this move is not a finite number",
        "check the values that the block computes",
        line,
    )


def check_finite(block: Block, *arrays: Floats) -> None:
    """Raise ``not-finite`` if a number of a block is not finite."""
    if not all(np.isfinite(array).all() for array in arrays):
        raise _not_finite(block, block.line)


def _check_polyline(block: Polyline) -> None:
    """Check that points are finite, and feeds finite or NaN (a traverse)."""
    if np.isfinite(block.points).all() and not np.isinf(block.feeds).any():
        return
    bad = ~np.isfinite(block.points).all(axis=1) | np.isinf(block.feeds)
    raise _not_finite(block, int(block.lines[int(np.argmax(bad))]))


def joined(block: NurbsFeed, position: Floats) -> Floats:
    """Return the control points, with the first one on ``position``.

    Raises:
        GcodeError: if the curve does not start there, or is not continuous.
    """
    points = np.array(block.control_points, np.float64)
    gap = float(np.abs(points[0] - position).max())
    if gap > JOIN:
        raise _error(
            block,
            "nurbs-start",
            f"the NURBS starts {gap:.6g} mm from the current position",
            "make the first control point the position before the block",
        )
    points[0] = position
    order = block.degree + 1
    inner = slice(1, len(block.knots) - 1)
    if len(block.knots) > 2 * order:
        values, firsts, counts = np.unique(
            block.knots[inner], return_index=True, return_counts=True
        )
        for value, first, count in zip(values, firsts + 1, counts, strict=True):
            # As many equal knots as the order: the curve ends at the control point before them, and
            # begins anew at the last one that they leave over.
            if count >= order and block.knots[0] < value < block.knots[-1]:
                jump = float(np.abs(points[first + count - order] - points[first - 1]).max())
                if jump > JOIN:
                    raise _error(
                        block,
                        "nurbs-not-continuous",
                        f"the NURBS jumps {jump:.6g} mm at knot {value:.6g}, "
                        f"which occurs {count} times",
                        f"give an inner knot at most {block.degree} times",
                    )
    return points
