"""Random programs for boards that take lines, with their paths by geometry alone."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from scipy.interpolate import BSpline

INCH = 25.4
PLANES = {"G17": (0, 1, 2), "G18": (2, 0, 1), "G19": (1, 2, 0)}
FINE = 5e-5
"""mm: how far the chords of ``points`` may be from a curve."""


@dataclass
class Geometry:
    """A program and its way: lines of text, points (k, 3) in mm from the origin on."""

    rng: np.random.Generator
    unit: float = 1.0
    lines: list[str] = field(default_factory=list)
    points: list[np.ndarray] = field(default_factory=list)
    feed_mode: str = "G94"

    @property
    def at(self) -> np.ndarray:
        return self.points[-1][-1]

    def rounded(self, values: np.ndarray, digits: int = 5) -> np.ndarray:
        """As the program's text can say it, mm."""
        return np.round(np.asarray(values) / self.unit, digits) * self.unit

    def words(self, letters: str, values: np.ndarray, digits: int = 5) -> str:
        return " ".join(
            f"{letter}{value / self.unit:.{digits}f}"
            for letter, value in zip(letters, values, strict=True)
        )

    def feed(self) -> str:
        return f"F{10 ** self.rng.uniform(1.5, 3.9) / self.unit:.2f}"

    def near(self, reach: float) -> np.ndarray:
        return self.rounded(self.at + self.rng.uniform(-reach, reach, 3))

    # one move or a few
    def line(self) -> None:
        end = self.near(float(10 ** self.rng.uniform(-3, 2)))
        if self.rng.random() < 0.3:
            only = int(self.rng.integers(0, 3))
            end = np.where(np.arange(3) == only, end, self.at)
        code = "G0" if self.rng.random() < 0.2 else "G1"
        self.lines.append(f"{code} {self.words('XYZ', end)} {self.feed()}")
        self.points.append(np.array([end]))

    def run(self) -> None:
        """Short moves along something smooth, or jagged."""
        count, step = int(self.rng.integers(4, 60)), float(10 ** self.rng.uniform(-2.5, 0.5))
        heading, bend = self.rng.uniform(0, math.tau), self.rng.normal(0, 0.2)
        rough = float(self.rng.choice([0.0, 0.0, 0.02, 1.0]))
        rows, at = [], self.at
        for _ in range(count):
            heading += bend + rough * self.rng.normal()
            at = self.rounded(
                at + step * np.array([math.cos(heading), math.sin(heading), 0.1 * bend])
            )
            rows.append(at)
        feed = self.feed()
        self.lines += [f"G1 {self.words('XYZ', row)} {feed}" for row in rows]
        self.points.append(np.array(rows))

    def arc(self, radius: float | None = None, turns: int | None = None) -> None:
        code = str(self.rng.choice(list(PLANES)))
        i, j, across = PLANES[code]
        if radius is None:
            radius = float(10 ** self.rng.uniform(-2, 3))
        digits = 5
        angle = self.rng.uniform(0, math.tau)
        out = self.rounded(radius * np.array([math.cos(angle), math.sin(angle)]), digits)
        sign = float(self.rng.choice([1.0, -1.0]))
        whole = self.rng.random() < 0.25
        sweep = (
            math.tau
            if whole
            else float(
                self.rng.choice(
                    [self.rng.uniform(0.02, math.tau - 0.02), self.rng.uniform(0.002, 0.2)]
                )
            )
        )
        climb = float(
            self.rng.choice([0.0, self.rng.uniform(-2, 2) * radius, self.rng.uniform(-0.5, 0.5)])
        )
        if turns is None:
            turns = int(self.rng.choice([1, 1, 1, self.rng.integers(2, 6)]))
        start, end = self.at, self.at.copy()
        begin = -out
        if not whole:
            c, s = math.cos(sign * sweep), math.sin(sign * sweep)
            turned = np.array([c * begin[0] - s * begin[1], s * begin[0] + c * begin[1]])
            ends = self.rounded(
                np.array([start[i] + out[0] + turned[0], start[j] + out[1] + turned[1]]), digits
            )
            if np.linalg.norm(ends - [start[i], start[j]]) < 1e-3 * self.unit:
                return
            end[i], end[j] = ends
        end[across] = self.rounded(np.array([start[across] + climb]), digits)[0]
        center = np.array([start[i] + out[0], start[j] + out[1]])
        a0 = math.atan2(begin[1], begin[0])
        a1 = math.atan2(end[j] - center[1], end[i] - center[0])
        r0, r1 = math.hypot(*begin), math.hypot(end[i] - center[0], end[j] - center[1])
        if abs(r1 - r0) > min(0.004, 0.0008 * r0):
            return
        total = (a1 - a0) % math.tau if sign > 0 else -((a0 - a1) % math.tau)
        if whole:
            total, a1 = sign * math.tau, a0
        total += sign * math.tau * (turns - 1)
        count = max(16, math.ceil(abs(total) / (2.0 * math.acos(max(1.0 - FINE / radius, 0.0)))))
        part = np.linspace(0, 1, count + 1)[1:]
        rows = np.empty((count, 3))
        r = r0 + (r1 - r0) * part
        rows[:, i] = center[0] + r * np.cos(a0 + total * part)
        rows[:, j] = center[1] + r * np.sin(a0 + total * part)
        rows[:, across] = start[across] + (end[across] - start[across]) * part
        rows[-1] = end
        text = f"{code} {'G3' if sign > 0 else 'G2'} {self.words('XYZ', end, digits)} "
        text += self.words("IJK"[i] + "IJK"[j], out, digits) + (f" P{turns}" if turns > 1 else "")
        self.lines.append(f"{text} {self.feed()}")
        self.points.append(rows)

    def tiny_arc(self) -> None:
        self.arc(float(10 ** self.rng.uniform(-2, -0.7)))

    def tiny_spiral(self) -> None:
        self.arc(float(10 ** self.rng.uniform(-2, -0.7)), int(self.rng.integers(2, 30)))

    def nurbs(self, degree: int | None = None, *, flat: bool = False) -> None:
        if degree is None:
            degree = int(self.rng.integers(1, 6))
        count = degree + 1 + int(self.rng.integers(0, 5))
        inner = sorted(
            (self.rng.choice(np.arange(50, 950), count - degree - 1, replace=False) / 1000).tolist()
        )
        knots = np.array([0.0] * (degree + 1) + inner + [1.0] * (degree + 1))
        reach = float(10 ** self.rng.uniform(-1.5, 1.5))
        control = [self.at]
        for _ in range(count - 1):
            control.append(
                self.rounded(
                    control[-1]
                    + self.rng.uniform(-reach, reach, 3) * ([1.0, 1.0, 0.0] if flat else 1.0)
                )
            )
        weights = np.round(np.concatenate(([1.0], self.rng.uniform(0.3, 3.0, count - 2), [1.0])), 3)
        for k, (knot, point, weight) in enumerate(zip(knots, control, weights, strict=False)):
            head, tail = (f"G06.2 K{degree} ", " " + self.feed()) if k == 0 else ("", "")
            self.lines.append(f"{head}U{knot:.3f} {self.words('XYZ', point)} W{weight:.3f}{tail}")
        self.lines += [f"U{knot:.3f}" for knot in knots[count:]]
        spline = BSpline(
            knots, np.column_stack((np.array(control) * weights[:, None], weights)), degree
        )
        borders = np.unique(knots)
        between = [np.linspace(a, b, 1 if degree == 1 else 400) for a, b in pairwise(borders)]
        parts = np.unique(np.concatenate([*between, borders]))
        rows = spline(parts)
        self.points.append((rows[:, :3] / rows[:, 3:])[1:])

    def drill(self) -> None:
        """G81 with G98: over the hole, down to R by a traverse, to the bottom, back to where Z
        was.
        """
        x, y, z = self.at
        over = self.rounded(np.array([x, y]) + self.rng.uniform(-5, 5, 2))
        level, bottom = (
            self.rounded(np.array([z - self.rng.uniform(0.1, 1)]))[0],
            self.rounded(np.array([z - self.rng.uniform(1.2, 4)]))[0],
        )
        self.lines.append(
            f"G17 G98 G81 {self.words('XYZR', np.array([*over, bottom, level]))} {self.feed()}"
        )
        self.lines.append("G80")
        self.points.append(
            np.array([[*over, z], [*over, level], [*over, bottom], [*over, level], [*over, z]])
        )

    def between(self) -> None:
        self.lines.append(
            str(
                self.rng.choice(
                    ["G4 P0.01", "M3 S1000", "(MSG, on)", "M8", "G61", "G61.1", "G64 P0.02"]
                )
            )
        )


KINDS: list[Callable[[Geometry], None]] = [
    Geometry.line, Geometry.run, Geometry.arc, Geometry.tiny_arc, Geometry.tiny_spiral,
    Geometry.nurbs, Geometry.drill,
]  # fmt: skip


def geometry(seed: int) -> Geometry:
    """The program of a seed. It begins at zero, with a traverse."""
    rng = np.random.default_rng(seed)
    made = Geometry(rng, INCH if rng.random() < 0.25 else 1.0)
    made.points.append(np.zeros((1, 3)))
    made.lines += [
        f"{'G20' if made.unit == INCH else 'G21'} G90 G94 G17",
        str(rng.choice(["G61", "G61.1", "G64", "G64 P0.01"])),
    ]
    first = made.rounded(rng.uniform(-50, 50, 3))
    made.lines.append(f"G0 {made.words('XYZ', first)}")
    made.points.append(np.array([first]))
    some = KINDS if rng.random() < 0.5 else [KINDS[int(rng.integers(0, len(KINDS)))]]
    for _ in range(int(rng.integers(2, 10))):
        some[int(rng.integers(0, len(some)))](made)
        if rng.random() < 0.15:
            made.between()
    made.lines.append("M2")
    return made
