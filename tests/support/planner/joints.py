"""Programs of two or three moves with all kinds of moves, joints and path modes.

    mode, (kind, feed) joint (kind, feed) [joint (kind, feed)]

A joint determines the direction of the second move from that of the first: on the same line, back
along it, at an angle, or along the tangent. Kinds and joints are enumerated; feeds, lengths,
tolerances and machines are random by seed.
"""

from __future__ import annotations

import math
from itertools import product

import numpy as np

from cnc.machine.models import Axis, Board, Machine, PathLimits

KINDS = ("G0", "G1", "arc", "NURBS")
JOINTS = ("collinear", "reversed", "corner", "tangent")
MODES = ("G61", "G61.1", "G64 P")
MACHINES = 50

SHAPES = [
    (kinds, joints)
    for count in (2, 3)
    for kinds in product(KINDS, repeat=count)
    for joints in product(JOINTS, repeat=count - 1)
]
"""All pairs and triples of kinds of move and the joints between them."""

SLOWEST = 1.0 / 60.0
"""mm/s: F1."""

DECADES = 3.0
"""Feeds in one program differ by up to 1 : 1000, and so do the limits of machines."""

LONGEST = 20.0
"""s; a move that would take longer at its feed is made shorter."""


def machine_number(number: int, seed: int) -> Machine:
    """Return a machine with limits along the path, of the axes, or both, over three decades."""
    rng = np.random.default_rng((seed, number))
    acceleration = 10 ** rng.uniform(1.5, 1.5 + DECADES)
    jerk = acceleration / 10 ** rng.uniform(-2.5, -0.5)
    velocity = 10 ** rng.uniform(0.5, 0.5 + DECADES)
    has = ("path", "axes", "both")[number % 3]

    def axis() -> Axis:
        part = 10 ** rng.uniform(-0.5, 0.0)
        return Axis(
            steps_per_mm=100.0,
            max_velocity=velocity * part,
            max_acceleration=None if has == "path" else acceleration * part,
            max_jerk=None if has == "path" else jerk * part,
        )

    path = PathLimits(
        max_feed=velocity,
        max_tangential_acceleration=None if has == "axes" else acceleration * rng.uniform(0.5, 1.0),
        max_normal_acceleration=None if has == "axes" else acceleration * rng.uniform(0.5, 2.0),
        max_jerk=None if has == "axes" else jerk * rng.uniform(0.5, 1.0),
        chord_error=10 ** rng.uniform(-4, -2),
        tolerance=10 ** rng.uniform(-3, -1),
        period=float(rng.choice((1e-3, 1e-4))) if acceleration > 300.0 else 1e-3,
    )
    return Machine(
        axes={"x": axis(), "y": axis(), "z": axis()}, path=path, board=Board(max_step_rate=1e9)
    )


class Chain:
    """Writes consecutive moves, each in the direction that its joint gives."""

    def __init__(self, rng: np.random.Generator, mode: str, fastest: float) -> None:
        self.rng = rng
        self.here = np.zeros(3)
        self.ahead = self.direction()
        if rng.random() < 0.5:
            self.ahead = np.eye(3)[rng.integers(3)] * rng.choice((-1.0, 1.0))
        self.reach = min(10 ** rng.uniform(-1.0, 1.5), LONGEST * fastest)
        self.slowest = max(fastest * 10 ** -rng.uniform(0.0, DECADES), min(SLOWEST, fastest))
        self.fastest = fastest
        tolerance = max(min(10 ** rng.uniform(-3.0, 0.0), self.reach), 2e-5)
        self.lines = ["G21 G90 G94 G17", f"G64 P{tolerance:.5f}" if mode == "G64 P" else mode]

    def direction(self) -> np.ndarray:
        vector = self.rng.normal(0.0, 1.0, 3)
        return vector / np.linalg.norm(vector)

    def turn(self, joint: str) -> None:
        """Set the direction in which the next move begins."""
        if joint == "reversed":
            self.ahead = -self.ahead
        elif joint == "corner":
            side = np.cross(self.ahead, self.direction())
            angle = self.rng.uniform(0.01, 3.0)
            self.ahead = math.cos(angle) * self.ahead + math.sin(angle) * side / np.linalg.norm(
                side
            )
        elif joint == "tangent":
            side = np.cross(self.ahead, self.direction())
            self.ahead = self.ahead + 10 ** self.rng.uniform(-7.0, -3.0) * side / np.linalg.norm(
                side
            )
            self.ahead /= np.linalg.norm(self.ahead)

    def move(self, kind: str) -> None:
        feed = 10 ** self.rng.uniform(math.log10(self.slowest), math.log10(self.fastest))
        length = min(self.reach * 10 ** self.rng.uniform(-1.0, 0.0), LONGEST * feed)
        if kind == "arc":
            self.arc(length, feed)
        elif kind == "NURBS":
            self.nurbs(length, feed)
        else:
            self.go(
                "G0" if kind == "G0" else f"G1 F{60.0 * feed:.4f}", self.here + length * self.ahead
            )

    def go(self, head: str, there: np.ndarray, tail: str = "") -> None:
        words = " ".join(f"{letter}{value:.9f}" for letter, value in zip("XYZ", there, strict=True))
        self.lines.append(f"{head} {words} {tail}".strip())
        self.here = np.round(there, 9)

    def arc(self, length: float, feed: float) -> None:
        """Write an arc in the XY plane, or a helix, that begins in the direction ahead."""
        flat = float(np.hypot(self.ahead[0], self.ahead[1]))
        if flat < 0.1:
            self.ahead = np.array([1.0, 0.0, 0.0])
            flat = 1.0
        sweep = self.rng.uniform(0.2, 5.5)
        radius = length * flat / sweep
        sense = float(self.rng.choice((-1.0, 1.0)))
        along = self.ahead[:2] / flat
        left = np.array([-along[1], along[0]])
        to_centre = np.round(sense * radius * left, 9)
        out = -to_centre
        angle = sense * sweep
        turned = np.array(
            [
                math.cos(angle) * out[0] - math.sin(angle) * out[1],
                math.sin(angle) * out[0] + math.cos(angle) * out[1],
            ]
        )
        there = self.here.copy()
        there[:2] += to_centre + turned
        there[2] += length * self.ahead[2]
        self.go(
            "G3" if sense > 0 else "G2",
            there,
            f"I{to_centre[0]:.9f} J{to_centre[1]:.9f} F{60.0 * feed:.4f}",
        )
        end = sense * np.array([-turned[1], turned[0]]) / np.linalg.norm(turned) * flat
        self.ahead = np.array([*end, self.ahead[2]])

    def nurbs(self, length: float, feed: float) -> None:
        """Write a cubic of five points that begins in the direction ahead; it may be straight."""
        bend = length * float(self.rng.choice((0.0, 10 ** self.rng.uniform(-3.0, -0.5))))
        points = [self.here, self.here + 0.25 * length * self.ahead]
        points += [
            self.here + part * length * self.ahead + bend * self.direction()
            for part in (0.5, 0.75, 1.0)
        ]
        knots = (0, 0, 0, 0, 0.5, 1, 1, 1, 1)
        before = self.here
        for index, point in enumerate(points):
            first = f"G06.2 K3 U{knots[0]} F{60.0 * feed:.4f}"
            self.go(first if index == 0 else f"U{knots[index]}", point, "W1")
            if index == len(points) - 2:
                before = self.here
        self.lines += [f"U{knot}" for knot in knots[len(points) :]]
        last = self.here - before
        if np.linalg.norm(last) > 0.0:
            self.ahead = last / np.linalg.norm(last)


def joint_program(number: int, seed: int) -> tuple[str, Machine]:
    """Return program ``number`` of a series and its machine.

    Shapes come in turn; the rest is random by ``seed``.
    """
    rng = np.random.default_rng((seed, number))
    kinds, joints = SHAPES[number % len(SHAPES)]
    mode = MODES[int(rng.integers(len(MODES)))]
    machine = machine_number(int(rng.integers(MACHINES)), seed)
    chain = Chain(rng, mode, machine.path.max_feed)
    chain.move(kinds[0])
    for kind, joint in zip(kinds[1:], joints, strict=True):
        chain.turn(joint)
        chain.move(kind)
    return "\n".join([*chain.lines, "M2"]) + "\n", machine
