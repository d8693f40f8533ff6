"""Runs of straight moves the quick way: a program of a million short lines makes no Python object a line (:mod:`cnc.kernels.straight`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cnc.gcode.text import Window
from cnc.kernels import straight as kernel

SHORTEST = 4
"""Lines; a shorter run is no faster in one piece."""


@dataclass(slots=True)
class Straight:
    """The state that straight moves read and change.

    ``column`` (26,): the index of each letter's axis, -1 where the machine or the dialect has none. ``scale`` and ``zero``, by axis: mm or
    degrees a program unit, and the position of the program's zero point. ``turns`` by axis: whether it is a rotary one. ``feed_scale`` is
    mm a program unit of F, ``min_feed`` mm/s. ``mode``: 0 for G0, 1 for G1, -1 for neither. ``position`` by axis; ``feed`` mm/s and deg/s,
    or None.
    """

    column: NDArray[np.int64]
    scale: list[float]
    zero: list[float]
    turns: list[float]
    absolute: bool
    feed_scale: float
    min_feed: float
    mode: int
    position: list[float]
    feed: tuple[float, float] | None


@dataclass(frozen=True, slots=True)
class Run:
    """The moves of ``count`` lines: points (n, axes), feeds (n,) mm/s, NaN for a traverse, numbers (n,) of their lines."""

    count: int
    points: NDArray[np.float64]
    feeds: NDArray[np.float64]
    lines: NDArray[np.int32]


def columns(axes: tuple[str, ...]) -> NDArray[np.int64]:
    """The index of each letter's axis, -1 for none."""
    found = np.full(26, -1, np.int64)
    for index, axis in enumerate(axes):
        found[ord(axis.upper()) - ord("A")] = index
    return found


def execute(window: Window, index: int, state: Straight) -> Run:
    """Execute lines of a window from ``index`` on, as many as hold nothing but straight moves and raise no question; ``state`` goes along.

    It stops before a line that the machine, the dialect or the state as it is may have a word to say about.
    """
    scan, count = window.scan, int(window.straight[index])
    position, axes = np.array(state.position), np.array([state.scale, state.zero, state.turns])
    feed = np.array(state.feed or (np.nan, np.nan))
    points, feeds, lines = np.empty((count, len(position))), np.empty(count), np.empty(count, np.int32)
    count, moves, state.mode = kernel.straight(
        window.first + index, scan.first, scan.letter, scan.number, index, index + count, state.column, axes, int(state.absolute),
        state.feed_scale, state.min_feed, state.mode, position, feed, points, feeds, lines,
    )  # fmt: skip
    state.position = position.tolist()
    if not np.isnan(feed[0]):
        state.feed = float(feed[0]), float(feed[1])
    return Run(count, points[:moves], feeds[:moves], lines[:moves])
