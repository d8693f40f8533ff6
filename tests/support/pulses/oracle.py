"""Independent evaluation of paths: closed formulas and scipy's splines on the canonical blocks,
without the package's kernels.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import quad
from scipy.interpolate import BSpline

from cnc.model.blocks import ArcFeed, Block, NurbsFeed, Polyline

Floats = NDArray[np.float64]


@dataclass
class Segment:
    """A smooth stretch: q(w) (k, n) for w (k,) in [0, 1], and its arc length from 0 to w."""

    q: Callable[[Floats], Floats]
    length: Callable[[float], float]


def _line(p: Floats, e: Floats) -> Segment:
    size = float(np.linalg.norm((e - p)[:3])) or float(np.linalg.norm(e - p))
    return Segment(lambda w: p + np.multiply.outer(w, e - p), lambda w: w * size)


def _arc(p: Floats, block: ArcFeed) -> Segment:
    """Return an XY arc, helix or spiral: radius and other axes change evenly with the angle."""
    center = np.asarray(block.center)
    first = np.arctan2(*(p[:2] - center)[::-1])
    r0, r1 = np.hypot(*(p[:2] - center)), np.hypot(*(block.end[:2] - center))

    def q(w: Floats) -> Floats:
        out = p + np.multiply.outer(w, block.end - p)
        angle = first + 2 * np.pi * block.turns * w
        r = r0 + (r1 - r0) * w
        out[..., 0] = center[0] + r * np.cos(angle)
        out[..., 1] = center[1] + r * np.sin(angle)
        return out

    rise = np.linalg.norm((block.end - p)[2:3])

    def speed(w: float) -> float:
        return float(
            np.sqrt(
                (2 * np.pi * block.turns * (r0 + (r1 - r0) * w)) ** 2 + (r1 - r0) ** 2 + rise**2
            )
        )

    if abs(r1 - r0) < 1e-9:
        return Segment(q, lambda w: w * speed(0.5))
    return Segment(q, lambda w: float(quad(speed, 0.0, w, epsabs=1e-13, epsrel=1e-13)[0]))


def _spans(block: NurbsFeed) -> list[Segment]:
    """Return a segment for each knot span, by scipy in homogeneous coordinates."""
    weights = block.weights[:, None]
    spline = BSpline(
        block.knots, np.hstack((block.control_points * weights, weights)), block.degree
    )
    slope = spline.derivative()

    def speed(u: float) -> float:
        f, d = spline(u), slope(u)
        return float(np.linalg.norm(((d[:-1] - f[:-1] / f[-1] * d[-1]) / f[-1])[:3]))

    segments = []
    breaks = np.unique(block.knots)
    for a, b in itertools.pairwise(breaks):

        def q(w: Floats, a: float = a, b: float = b) -> Floats:
            f = spline(a + (b - a) * np.asarray(w))
            return np.asarray(f[..., :-1] / f[..., -1:])

        def length(w: float, a: float = a, b: float = b) -> float:
            return float(quad(speed, a, a + (b - a) * w, epsabs=1e-13, epsrel=1e-13, limit=200)[0])

        segments.append(Segment(q, length))
    return segments


def segments_of(blocks: Sequence[Block], start: ArrayLike) -> list[Segment]:
    """Return the path of the blocks."""
    p = np.asarray(start, dtype=np.float64)
    out: list[Segment] = []
    for block in blocks:
        if isinstance(block, Polyline):
            for e in block.points:
                if (e != p).any():
                    out.append(_line(p, e))
                p = e
        elif isinstance(block, ArcFeed):
            out.append(_arc(p, block))
            p = block.end
        elif isinstance(block, NurbsFeed):
            out += _spans(block)
            p = block.control_points[-1]
    return out


@dataclass
class Crossing:
    """An axis passes a half-grid line: place (segment index + w), axis, direction."""

    place: float
    axis: int
    sign: int


def _roots(f: Callable[[Floats], Floats], a: float, b: float) -> float:
    """Return the zero of f in [a, b], where f changes its sign, by bisection."""
    fa = float(f(np.array(a)))
    for _ in range(60):
        middle = 0.5 * (a + b)
        fm = float(f(np.array(middle)))
        a, b, fa = (middle, b, fm) if (fm < 0) == (fa < 0) else (a, middle, fa)
    return 0.5 * (a + b)


def crossings(
    segments: Sequence[Segment], steps_per_mm: Floats, grid: NDArray[np.int64], dense: int
) -> list[Crossing]:
    """Return every crossing of a half-grid line, from ``dense`` points a segment and bisection
    between them. An excursion that turns back between two points is missed, so paths are chosen
    without such excursions.
    """
    g = grid.copy()
    found: list[Crossing] = []
    for number, segment in enumerate(segments):
        w = np.linspace(0.0, 1.0, dense + 1)
        p = segment.q(w) * steps_per_mm
        for axis in range(len(g)):
            for i in range(dense):
                b = p[i + 1, axis]
                while abs(b - g[axis]) > 0.5 + 1e-8:
                    sign = 1 if b > g[axis] else -1
                    line = g[axis] + 0.5 * sign
                    where = w[i]
                    if (p[i, axis] - line) * sign < 0:
                        where = _roots(
                            lambda x, s=segment, n=axis, h=line: (
                                s.q(x)[..., n] * steps_per_mm[n] - h
                            ),
                            w[i],
                            w[i + 1],
                        )
                    found.append(Crossing(number + where, axis, sign))
                    g[axis] += sign
    found.sort(key=lambda c: c.place)
    return found
