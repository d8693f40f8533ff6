"""Random programs and machines by seed: all kinds of moves, all path modes, limits of 3 decades."""

import math
import re

import numpy as np

from cnc.machine.models import Axis, Board, Machine, PathLimits

AXES = ("X", "Y", "Z")
TOOL_LENGTH = 80.0
_MOVE = re.compile(r"G[0-3] X")
MODES = ("G61", "G61.1", "G64", "G64 P0")


def random_machine(rng: np.random.Generator, period: float) -> tuple[Machine, float]:
    """Return a machine, and the length in mm of moves that it makes in about a second."""
    accel, seconds = 10 ** rng.uniform(1.5, 4.5), 10 ** rng.uniform(-2.5, -0.5)
    jerk, velocity = accel / seconds, 10 ** rng.uniform(1, 3)
    limits = str(rng.choice(["path", "axes", "both"]))
    slow = [1.0, 1.0, 1.0]
    if rng.random() < 0.3:
        slow[int(rng.integers(3))] = 10 ** rng.uniform(-3, 0)
    axes = {
        letter: Axis(
            steps_per_mm=100.0,
            max_velocity=velocity * part,
            max_acceleration=accel * part * rng.uniform(0.5, 1.0) if limits != "path" else None,
            max_jerk=jerk * part * rng.uniform(0.5, 1.0) if limits != "path" else None,
        )
        for letter, part in zip("xyz", slow, strict=True)
    }
    along = limits != "axes"
    path = PathLimits(
        max_feed=velocity,
        max_tangential_acceleration=accel * rng.uniform(0.5, 1.5) if along else None,
        max_normal_acceleration=accel * rng.uniform(0.5, 3.0) if along else None,
        max_jerk=jerk * rng.uniform(0.5, 1.5) if along else None,
        chord_error=10 ** rng.uniform(-4, -2),
        tolerance=10 ** rng.uniform(-3, -1),
        period=period,
    )
    reach = min(0.3 * accel * min(slow), velocity * min(slow), 20.0)
    return Machine(axes=axes, path=path, board=Board(max_step_rate=1e9)), max(
        reach * (1.0 if period >= 1e-3 else 0.3), 0.02
    )


class Job:
    """Writes a program move by move."""

    def __init__(self, rng: np.random.Generator, size: float) -> None:
        self.rng, self.size = rng, size * 10 ** rng.uniform(-1.0, 0.0)
        self.here = np.zeros(3)
        self.lines = ["G21 G90 G94 G17", self.mode()]

    def mode(self) -> str:
        tolerance = min(10 ** self.rng.uniform(-4, 0), self.size)
        return str(self.rng.choice((*MODES, *[f"G64 P{tolerance:.5f}"] * 4)))

    def feed(self) -> str:
        """Return a feed with which a move takes at most a few seconds."""
        return f"F{60 * self.size * 10 ** self.rng.uniform(-0.5, 2.5):.4f}"

    def go(self, there: np.ndarray, head: str, tail: str = "") -> None:
        there = np.round(there, 4)
        self.lines.append(
            " ".join(
                (
                    head,
                    *(f"{axis}{value:.4f}" for axis, value in zip(AXES, there, strict=True)),
                    tail,
                )
            ).strip()
        )
        self.here = there

    def near(self, scale: float = 1.0) -> np.ndarray:
        return np.round(
            self.here
            + self.rng.normal(0, self.size * scale, 3)
            * self.rng.choice((0.0, 1.0), 3, p=(0.2, 0.8)),
            4,
        )

    def rapid(self) -> None:
        self.go(self.near(), "G0")

    def corners(self) -> None:
        scale, feed = 10 ** self.rng.uniform(-2, 0), self.feed()
        for _ in range(int(self.rng.integers(1, 7))):
            self.go(self.near(scale), "G1", feed)

    def chain(self) -> None:
        """Write chords of a smooth curve, as a CAM system does, with a few corners."""
        count, feed = int(self.rng.integers(10, 120)), self.feed()
        chord = max(self.size * 10 ** self.rng.uniform(-2.5, -1), 2e-4)
        bend = np.cumsum(self.rng.normal(0, 10 ** self.rng.uniform(-3, -1.2), count))
        turn = self.rng.uniform(0, 2 * math.pi) + np.cumsum(bend * 10 ** self.rng.uniform(-2, -0.5))
        if self.rng.random() < 0.3:
            turn[int(self.rng.integers(count)) :] += self.rng.uniform(-3, 3)
        rise = np.cumsum(self.rng.normal(0, 0.03, count)) * (self.rng.random() < 0.7)
        for angle, up in zip(turn, rise, strict=True):
            length = chord * (1.0 if self.rng.random() < 0.9 else self.rng.uniform(0.05, 2.0))
            self.go(
                self.here + length * np.array([math.cos(angle), math.sin(angle), up]), "G1", feed
            )

    def arc(self) -> None:
        radius, angle = (
            self.size * 10 ** self.rng.uniform(-1.5, 0),
            self.rng.uniform(0, 2 * math.pi),
        )
        offset = np.round(radius * np.array([math.cos(angle), math.sin(angle)]), 4)
        if not offset.any():
            return
        sweep = self.rng.choice((-1.0, 1.0)) * (
            self.rng.uniform(0.1, 6.1) if self.rng.random() < 0.8 else 2 * math.pi
        )
        cos, sin = (1.0, 0.0) if abs(sweep) > 6.2 else (math.cos(sweep), math.sin(sweep))
        there = self.here.copy()
        there[:2] += offset - [cos * offset[0] - sin * offset[1], sin * offset[0] + cos * offset[1]]
        there[2] += self.rng.normal(0, self.size) if self.rng.random() < 0.4 else 0.0
        self.go(
            there, "G3" if sweep > 0 else "G2", f"I{offset[0]:.4f} J{offset[1]:.4f} {self.feed()}"
        )

    def tangent(self) -> None:
        """Write a line, an arc tangent to it, and a line tangent to the arc."""
        heading, radius = (
            self.rng.uniform(0, 2 * math.pi),
            self.size * 10 ** self.rng.uniform(-1, 0),
        )
        along, sense, feed = (
            np.array([math.cos(heading), math.sin(heading), 0.0]),
            self.rng.choice((-1, 1)),
            self.feed(),
        )
        left = sense * np.array([-along[1], along[0], 0.0])
        self.go(self.here + self.size * along, "G1", feed)
        sweep = self.rng.uniform(0.2, 3.0)
        there = self.here + radius * (left * (1 - math.cos(sweep)) + along * math.sin(sweep))
        self.go(
            there, "G3" if sense > 0 else "G2", f"I{radius * left[0]:.6f} J{radius * left[1]:.6f}"
        )
        self.go(self.here + self.size * (math.cos(sweep) * along + math.sin(sweep) * left), "G1")

    def nurbs(self) -> None:
        degree = int(self.rng.integers(1, 5))
        count = degree + 1 + int(self.rng.integers(0, 5))
        inner = np.sort(self.rng.choice(np.arange(1, 20), count - degree - 1)) / 20
        if (np.unique(inner, return_counts=True)[1] > degree).any():
            return
        knots = [0.0] * (degree + 1) + inner.tolist() + [1.0] * (degree + 1)
        self.lines.append(
            f"G06.2 K{degree} U0 X{self.here[0]:.4f} Y{self.here[1]:.4f} Z{self.here[2]:.4f} "
            f"W1 {self.feed()}"
        )
        for knot in knots[1:count]:
            self.go(self.near(0.5), f"U{knot:.3f}", f"W{10 ** self.rng.uniform(-0.7, 0.7):.3f}")
        self.lines += [f"U{knot:.3f}" for knot in knots[count:]]

    def write(self) -> str:
        moves = (
            self.rapid,
            self.corners,
            self.chain,
            self.chain,
            self.arc,
            self.tangent,
            self.nurbs,
        )
        for _ in range(int(self.rng.integers(1, 7))):
            moves[int(self.rng.integers(len(moves)))]()
            if self.rng.random() < 0.2:
                self.lines.append(self.mode())
            if self.rng.random() < 0.05:
                self.lines.append("G4 P0.01")
        return "\n".join([*self.lines, "M2"]) + "\n"


def with_angles(program: str, tilt: str, rng: np.random.Generator) -> str:
    """Return a program under tool-tip control with angles in most of its moves."""
    lines = ["G21 G90", f"G43.1 Z{TOOL_LENGTH}", "M428", "G0 X0 Y0 Z0"]
    angles, turning = np.zeros(2), rng.normal(0.0, 1.0, 2)
    largest = 10 ** rng.uniform(-1.0, 1.5)
    smooth = rng.random() < 0.6
    before = ""
    for line in program.split("\n"):
        place = " ".join(re.findall(r"[XYZ]\S+", line))
        # Without a move of the tip the length of the path would be in degrees.
        before, moves = place or before, place != before
        if _MOVE.match(line) and moves and rng.random() < 0.85:
            turning = 0.9 * turning + 0.3 * rng.normal(0.0, 1.0, 2)
            step = turning if smooth else rng.normal(0.0, 1.0, 2)
            angles = np.clip(angles + 0.3 * largest * step, -120.0, 120.0).round(4)
            line += f" {tilt}{angles[0]:.4f} C{angles[1]:.4f}"
        lines.append(line)
    return "\n".join(lines)


def random_job(seed: int) -> tuple[str, Machine]:
    """Return the program and the machine of a seed."""
    rng = np.random.default_rng(seed)
    machine, size = random_machine(rng, float(rng.choice((1e-3, 1e-4))))
    return Job(rng, size).write(), machine
