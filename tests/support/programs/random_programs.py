"""Random programs of lines, arcs in all planes, helices and NURBS, by seed."""

import math

import numpy as np

PLANES = {
    "G17": ("X", "Y", "I", "J", "Z"),
    "G18": ("Z", "X", "K", "I", "Y"),
    "G19": ("Y", "Z", "J", "K", "X"),
}
BOX = {"X": (5.0, 60.0), "Y": (5.0, 60.0), "Z": (-30.0, 0.0)}


def word(letter: str, value: float) -> str:
    return f"{letter}{value:.4f}"


class Writer:
    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.at = {"X": 0.0, "Y": 0.0, "Z": 0.0}
        self.lines = ["G21 G90 G94 G17", str(self.rng.choice(["G61", "G61.1", "G64", "G64 P0.01"]))]

    def target(self, near: float | None = None) -> dict[str, float]:
        """A point in the box, to four digits; not farther than ``near`` from here in any axis."""
        there = {}
        for axis, (low, high) in BOX.items():
            if near is not None:
                low, high = max(low, self.at[axis] - near), min(high, self.at[axis] + near)
            there[axis] = round(float(self.rng.uniform(min(low, high), max(low, high))), 4)
        return there

    def feed(self) -> str:
        return word("F", float(10 ** self.rng.uniform(2.3, 3.9)))

    def go(self, there: dict[str, float]) -> None:
        self.at = dict(self.at, **there)

    def line(self) -> None:
        there = self.target(float(self.rng.choice([0.02, 0.5, 20.0])))
        if self.rng.random() < 0.4:
            axis = str(self.rng.choice(list(BOX)))
            there = {axis: there[axis]}
        words = " ".join(word(axis, value) for axis, value in there.items())
        self.lines.append(f"G0 {words}" if self.rng.random() < 0.2 else f"G1 {words} {self.feed()}")
        self.go(there)

    def arc(self) -> None:
        """By its centre and the angle it sweeps; the end, rounded to four digits, is off the circle
        by less than the slack.
        """
        code = str(self.rng.choice(list(PLANES)))
        first, second, i, j, across = PLANES[code]
        radius, angle = float(self.rng.uniform(0.3, 6.0)), float(self.rng.uniform(0, 2 * math.pi))
        offset = round(radius * math.cos(angle), 4), round(radius * math.sin(angle), 4)
        sweep = float(self.rng.choice([1.0, -1.0])) * float(
            self.rng.uniform(0.3, 2 * math.pi - 0.3)
        )
        cos, sin = math.cos(sweep), math.sin(sweep)
        there = {
            first: round(self.at[first] + offset[0] - (cos * offset[0] - sin * offset[1]), 4),
            second: round(self.at[second] + offset[1] - (sin * offset[0] + cos * offset[1]), 4),
        }
        if self.rng.random() < 0.4:
            there[across] = self.target(2.0)[across]
        words = " ".join(word(axis, value) for axis, value in there.items())
        turn = "G3" if sweep > 0 else "G2"
        center = f"{word(i, offset[0])} {word(j, offset[1])}"
        self.lines.append(f"{code} {turn} {words} {center} {self.feed()}")
        self.go(there)

    def nurbs(self) -> None:
        degree = int(self.rng.integers(1, 5))
        count = degree + 1 + int(self.rng.integers(0, 4))
        inner = sorted(
            (self.rng.choice(np.arange(50, 950), count - degree - 1, replace=False) / 1000).tolist()
        )
        knots = [0.0] * (degree + 1) + inner + [1.0] * (degree + 1)
        points = [dict(self.at)]
        for _ in range(count - 1):
            self.go(self.target(8.0))
            points.append(dict(self.at))
        weights = [1.0, *np.round(self.rng.uniform(0.4, 2.5, count - 2), 3).tolist(), 1.0]
        for index, (knot, point, weight) in enumerate(zip(knots, points, weights, strict=False)):
            words = " ".join(word(axis, value) for axis, value in point.items())
            head, tail = (f"G06.2 K{degree} ", " " + self.feed()) if index == 0 else ("", "")
            self.lines.append(f"{head}U{knot:.3f} {words} W{weight:.3f}{tail}")
        self.lines += [f"U{knot:.3f}" for knot in knots[count:]]

    def write(self) -> str:
        self.lines.append("G0 X30 Y30 Z-15")
        self.go({"X": 30.0, "Y": 30.0, "Z": -15.0})
        kinds = [self.line, self.arc, self.nurbs]
        only = int(self.rng.integers(0, 4))
        for _ in range(int(self.rng.integers(2, 9))):
            kinds[int(self.rng.integers(0, 3)) if only == 3 else only]()
            if self.rng.random() < 0.1:
                self.lines.append(str(self.rng.choice(["G4 P0.01", "M3 S1000", "(MSG, on)"])))
        return "\n".join([*self.lines, "M2"]) + "\n"


def random_program(seed: int) -> str:
    """The program of a seed."""
    return Writer(seed).write()
