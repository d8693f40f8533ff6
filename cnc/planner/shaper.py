r"""Shapers: the motion is delayed in parts, so that what the parts ring cancels.

A shaper splits a motion s(t) into parts that follow each other: sum of A_i s(t - t_i), with A_i > 0
of sum 1. It keeps speed, acceleration and jerk within bounds that s keeps. A motion that excites a
mode of frequency w (rad/s) and damping d by an amplitude then excites it by the part

    V(w, d) = | sum A_i exp((d w + i w sqrt(1 - d^2)) (t_i - t_n)) |

of it, measured when each motion is over (N. Singer, W. Seering, J. Dyn. Sys. Meas. Control 112,
1990). The shaper here is the shortest one with V at most ``NEAR`` where the true frequency is up to
10 % off, and ``FAR`` at 20 %, for all modes together. For one mode it takes 0.90 to 0.94 of a
period. For several it is far shorter than one shaper after the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Waves = NDArray[np.complex128]

NEAR = 0.05
"""Part of the amplitude that may remain where the true frequency is up to 10 % off."""
FAR = 0.10
"""The same at 20 %; in between it rises evenly."""
OFF = 0.2
"""How far the true frequency may be off."""
FREQUENCIES = 17
"""Frequencies of a mode for which a shaper is made, evenly from 20 % below to 20 % above."""
PLACES = 48
"""Parts of the length of a shaper, at whose ends its parts may lie at first."""
HALVINGS = 6
"""Halvings of the interval in which the shortest length is sought."""
MARGIN = 0.98
"""Part of the bounds that is used while the places of the parts are sought."""
SMALL = 4e-3
"""A part that is smaller is left out, where the others keep the bounds."""
ACCURACY = 1e-4
"""Of the least of the largest values, where its bound is 1."""
CENTRED = 0.5
"""Decrease of the barrier by a step, below which the place is near a centre."""
FASTER = 8.0
"""Factor of the weight of the bound from centre to centre."""


class Mode(NamedTuple):
    """A way in which a machine rings.

    Attributes:
        frequency: Hz.
        damping: Damping ratio.
    """

    frequency: float
    damping: float


class Shaper(NamedTuple):
    """The parts of a motion.

    Attributes:
        times: Delay of each part (n,), s; the first is 0.
        parts: Each part (n,); their sum is 1.
    """

    times: Floats
    parts: Floats

    @property
    def length(self) -> float:
        """Time by which the motion becomes longer, s."""
        return float(self.times[-1])

    @property
    def reach(self) -> float:
        """Longest time between the delay of a part and the mean delay, s."""
        mean = float(self.parts @ self.times)
        return max(mean, self.length - mean)


NO_SHAPER = Shaper(np.zeros(1), np.ones(1))


def remaining(shaper: Shaper, mode: Mode) -> float:
    """Return the part of the amplitude of a mode that remains behind a shaper."""
    return float(np.abs(_waves(shaper.times, [mode]) @ shaper.parts)[0])


@lru_cache(maxsize=64)
def shortest_shaper(modes: tuple[Mode, ...]) -> Shaper:
    """Return the shortest shaper that keeps the bounds for all modes, to a part of its length."""
    if not modes:
        return NO_SHAPER
    off = np.linspace(1.0 - OFF, 1.0 + OFF, FREQUENCIES)
    rises = np.clip(2.0 * np.abs(off - 1.0) / OFF - 1.0, 0.0, 1.0)
    bounds = np.tile(NEAR + (FAR - NEAR) * rises, len(modes))
    around = [Mode(mode.frequency * part, mode.damping) for mode in modes for part in off]
    periods = [1.0 / mode.frequency for mode in modes]
    # One shaper after the other keeps the bounds, and each is shorter than a period.
    short, long = 0.85 * max(periods), sum(periods)
    for _ in range(HALVINGS):
        middle = 0.5 * (short + long)
        waves = _waves(np.linspace(0.0, middle, PLACES + 1), around) / bounds[:, None]
        if _least(waves, MARGIN)[1] <= MARGIN:
            long = middle
        else:
            short = middle
    times = np.linspace(0.0, long, PLACES + 1)
    parts, _ = _least(_waves(times, around) / bounds[:, None])
    large = np.flatnonzero(parts > SMALL)
    # The best place of a part often lies between two of the grid.
    groups = np.split(large, np.flatnonzero(np.diff(large) > 1) + 1)
    merged = np.array([np.average(times[group], weights=parts[group]) for group in groups])
    for places in (merged, times[large], times):
        times = places - places[0]
        parts, worst = _least(_waves(times, around) / bounds[:, None])
        if worst <= 1.0:
            break
    return Shaper(times, parts / parts.sum())


def _least(waves: Waves, enough: float = 0.0) -> tuple[Floats, float]:
    """Return the parts (n,) > 0 of sum 1 whose largest ``abs(waves @ parts)`` is least, and that.

    The search ends as soon as that is at most ``enough``, or cannot come to be. It follows the
    path of centres of a barrier: log(parts), and log(e^2 - abs(waves @ parts)^2) for the bound e.

    Args:
        waves: (m, n).
        enough: see above.
    """
    m, n = waves.shape
    parts = np.full(n, 1.0 / n)
    worst = float(np.abs(waves @ parts).max())
    e, weight = 1.5 * worst + 1e-6, 1.0
    matrix, right = np.zeros((n + 2, n + 2)), np.zeros(n + 2)
    matrix[n + 1, :n] = matrix[:n, n + 1] = 1.0
    while True:
        sums = waves @ parts
        worst = float(np.abs(sums).max())
        if worst <= enough:
            return parts, worst
        room = e * e - np.abs(sums) ** 2
        slope = (waves.conj() * sums[:, None]).real * (2.0 / room)[:, None]
        pull = 2.0 * e / room
        scaled = waves * np.sqrt(2.0 / room)[:, None]
        matrix[:n, :n] = slope.T @ slope + scaled.real.T @ scaled.real + scaled.imag.T @ scaled.imag
        matrix[range(n), range(n)] += parts**-2
        matrix[n, :n] = matrix[:n, n] = -(slope.T @ pull)
        matrix[n, n] = float(pull @ pull) - float((2.0 / room).sum())
        right[:n] = 1.0 / parts - slope.sum(axis=0)
        right[n] = float(pull.sum()) - weight
        step = np.linalg.solve(matrix, right)
        decrement = float(step[: n + 1] @ right[: n + 1])
        size = _inside(step[: n + 1], parts, e, waves, sums)
        parts, e = parts + size * step[:n], e + size * float(step[n])
        if decrement < CENTRED:
            gap = (n + 2 * m) / weight
            if gap < ACCURACY or e - 2.0 * gap > enough > 0.0:
                return parts, worst
            weight *= FASTER


def _inside(step: Floats, parts: Floats, e: float, waves: Waves, sums: Waves) -> float:
    """Return the part of a step of the parts and of e up to which the bounds are kept."""
    moved, size = waves @ step[:-1], 1.0
    while not (
        (parts + size * step[:-1] > 0.0).all()
        and e + size * step[-1] > np.abs(sums + size * moved).max()
    ):
        size *= 0.8
    return size if size == 1.0 else 0.8 * size


def _waves(times: Floats, modes: Sequence[Mode]) -> Waves:
    """Return what parts at ``times`` (n,) excite in each mode at the end of the last (modes, n)."""
    frequency, damping = np.array(modes).T
    w = 2.0 * np.pi * frequency
    root = w * (damping + 1j * np.sqrt(1.0 - damping**2))
    waves: Waves = np.exp(np.outer(root, times - times[-1]))
    return waves
