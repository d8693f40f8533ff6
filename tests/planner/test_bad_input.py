"""Hard and bad input: it is planned legally or refused with a code, without NaN and without a hang.

A kernel that hangs cannot be interrupted, so the programs run in a process of their own, which is
killed after LONGEST seconds.
"""

import math
import multiprocessing
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from cnc.api import check
from cnc.machine.models import Axis, Board, Machine, PathLimits
from cnc.model.blocks import NurbsFeed, PathMode
from cnc.path.kernels.bspline import TINY
from cnc.planner.lookahead import LookAhead
from tests.support.planner.legality import Findings, examine
from tests.support.planner.motions import machine as mill_of
from tests.support.planner.motions import path_of
from tests.support.soak import share

LONGEST = 300.0
"""s."""
REFUSALS = {
    "knots inside as often as the order": "nurbs-position-jump",
    "a jump inside": "nurbs-position-jump",
    "feed of 1e-6": "feed-too-slow",
    "feed of 1e-6 on a curve": "feed-too-slow",
}
"""The error codes of programs that are refused; all others are planned."""


def nurbs(
    degree: int,
    knots: list[float],
    points: list[tuple[float, ...]],
    feed: float = 6000,
    weights: list[float] | None = None,
) -> str:
    """A NURBS in the words of the paper, its first point at zero."""
    rows = []
    for k, knot in enumerate(knots):
        words = [f"U{knot:.9f}"]
        if k < len(points):
            words += [
                f"{letter}{value:.13f}" for letter, value in zip("XYZ", points[k], strict=False)
            ]
            words.append(f"W{weights[k] if weights else 1:.6f}")
        rows.append(" ".join(words))
    return f"G06.2 K{degree} {rows[0]} F{feed:.6f}\n" + "\n".join(rows[1:])


def moves(points: list[tuple[float, ...]] | np.ndarray, feed: float = 3000, digits: int = 6) -> str:
    """Straight moves."""
    rows = (
        " ".join(f"{letter}{value:.{digits}f}" for letter, value in zip("XYZ", point, strict=False))
        for point in points
    )
    return f"G1 F{feed:.6f}\n" + "\n".join(rows)


def clamped(degree: int, *inner: float) -> list[float]:
    """Knots with full multiplicity at both ends."""
    return [0.0] * (degree + 1) + list(inner) + [1.0] * (degree + 1)


TURN = np.linspace(0, 2 * math.pi, 200)[1:]
LOOP = np.stack((5 * np.sin(TURN), 5 - 5 * np.cos(TURN)), axis=1)
SPIKES = [(0.1 * k, 3.0 if k % 20 == 10 else 0.0) for k in range(1, 100)]

PROGRAMS = {
    "a cusp": nurbs(3, clamped(3), [(0, 0), (10, 10), (0, 10), (10, 0)]),
    "a cusp in space": nurbs(3, clamped(3), [(0, 0, 0), (10, 10, 5), (0, 10, 5), (10, 0, 0)]),
    **{
        f"a cusp but for {off:g}": nurbs(3, clamped(3), [(0, 0), (10, 10), (off, 10), (10, 0)])
        for off in 10.0 ** -np.arange(1, 13)
    },
    "a cusp crossed at speed": moves([(-1, -1)])
    + "\nG0 X0 Y0\n"
    + nurbs(3, clamped(3), [(0, 0), (10, 10), (0, 10), (10, 0)], 60000),
    "a straight spline that turns back": nurbs(2, clamped(2), [(0, 0), (10, 0), (2, 0)]),
    "a spline that is a point": nurbs(3, clamped(3), [(0, 0)] * 4) + "\nG1 X1",
    "control points thrice at the ends": nurbs(
        3, clamped(3, 0.5), [(0, 0), (0, 0), (0, 0), (10, 5), (10, 5)]
    ),
    "control points thrice inside": nurbs(
        3, clamped(3, 0.25, 0.5, 0.75), [(0, 0), (5, 5), (5, 5), (5, 5), (9, 0), (12, 3), (15, 0)]
    ),
    "knots thrice inside: a corner": nurbs(
        3, clamped(3, 0.5, 0.5, 0.5), [(0, 0), (2, 4), (4, 4), (6, 0), (8, 4), (10, 4), (12, 0)]
    ),
    "knots twice inside": nurbs(
        3, clamped(3, 0.5, 0.5), [(0, 0), (2, 4), (4, 4), (6, 0), (8, 4), (10, 4)]
    ),
    "knots inside as often as the order": nurbs(
        2, clamped(2, 0.5, 0.5, 0.5), [(0, 0), (2, 4), (4, 0), (4, 0), (6, 4), (8, 0)]
    ),
    "a jump inside": nurbs(
        2, clamped(2, 0.5, 0.5, 0.5), [(0, 0), (2, 4), (4, 0), (5, 0), (6, 4), (8, 0)]
    ),
    "knots very close": nurbs(
        3, clamped(3, 0.5, 0.500000001), [(0, 0), (2, 4), (4, -4), (6, 4), (8, -4), (10, 0)]
    ),
    "weights a million apart": nurbs(
        3, clamped(3), [(0, 0), (3, 8), (7, -8), (10, 0)], weights=[1, 1e6, 1e-6, 1]
    ),
    "degree 9": nurbs(9, clamped(9), [(float(k), float(k % 2) * 4) for k in range(10)]),
    "a curve of a micrometre": nurbs(
        3, clamped(3), [(0, 0), (3e-4, 1e-3), (7e-4, -1e-3), (1e-3, 0)]
    ),
    "no length": moves([(0, 0), (5, 0), (5, 0), (5, 0), (5, 5), (5, 5)]),
    "nothing but no length": moves([(0, 0)] * 5) + "\nG2 X0 Y0 I0 J1 F600",
    "repeated points in a chain": moves(np.repeat(LOOP, 3, axis=0)),
    "below a step": moves([(k * 1e-5, 0) for k in range(1, 2000)]),
    "below a step, turning": moves(
        [(2e-4 * math.sin(k / 30), 2e-4 * math.cos(k / 30) - 2e-4) for k in range(1, 500)]
    ),
    "a saw of rounding": moves([(0.1 * k, (k % 2) * 1e-6) for k in range(1, 300)]),
    "a saw of a step": moves([(0.1 * k, (k % 2) * 0.005) for k in range(1, 300)]),
    "there and back": moves([(5, 0), (0, 0), (5, 0), (0, 0)]),
    "there and nearly back": moves([(5, 0), (0, 1e-4), (5, 2e-4), (0, 3e-4)]),
    "a star": moves([(10 * math.cos(k * 2.8) - 10, 10 * math.sin(k * 2.8)) for k in range(1, 40)]),
    "a closed loop": moves(LOOP),
    "a loop gone round thrice": moves(np.tile(LOOP, (3, 1))),
    "spikes": moves(SPIKES),
    "a long line and short ones": moves(
        [(100, 0), (100.001, 0), (100.001, 0.001), (200, 0.001), (200, 0.002)]
    ),
    "feed of 1e-6 mm/s": moves([(1e-6, 0)], 6e-5),
    "feed of 1e-6 mm/s on a curve": "G2 X0.000002 Y0 I0.000001 J0 F0.00006",
    "feed of 1e-6": moves([(1e-9, 0)], 1e-6) + "\nG1 X0.000001 F0.000001",
    "feed of 1e-6 on a curve": "G1 X0.00001 F0.01\nG2 X0.00001 Y0.00002 I0 J0.00001 F0.000001",
    "feed of 1e6": moves([(10, 0), (10, 10), (0, 10)], 1e6) + "\nG2 X0 Y0 I0 J-5 F1000000",
    "feeds that alternate": "\n".join(f"G1 X{k} F{(1, 30000)[k % 2]}" for k in range(1, 4)),
    "feeds that alternate in a chain": "\n".join(
        f"G1 X{0.1 * k:.1f} Y{0.01 * (k % 3):.2f} F{(600, 30000)[k % 2]}" for k in range(1, 200)
    ),
    "a circle of 1 um": "G2 X0 Y0 I0.0005 J0 F600",
    "an arc of 1 um": "G2 X0.001 Y0 R0.0007 F600",
    "a circle of 10 nm": "G2 X0 Y0 I0.000005 J0 F600",
    "an arc of 1 km": f"G2 X100 Y{-(1e6 - math.sqrt(1e12 - 1e4)):.9f} I0 J-1000000 F30000",
    "a full circle of 1 um with a rise of 10 mm": "G2 X0 Y0 Z10 I0.0005 J0 F600",
    "a helix of a hundred turns": "G2 X0 Y0 Z1 I0.1 J0 P100 F3000",
    "an arc that ends off its circle": "G2 X10.0004 Y0 I5 J0 F3000",
}

PREFIXES = {
    "exact": "G61",
    "exact stop": "G61.1",
    "G64": "G64",
    "tolerance 1e-6": "G64 P0.000001",
    "tolerance 10": "G64 P10",
}


def mill(
    *,
    along: tuple[float, float, float] | None = (2400.0, 4903.3, 48000.0),
    axis: tuple[float, float] | None = None,
    slow: tuple[float, float, float] = (1.0, 1.0, 1.0),
    **path: float,
) -> Machine:
    """Limits along the path (tangential, normal, jerk), of each axis (acceleration, jerk) times the
    axis's part of them, or both.
    """
    axes = {
        letter: Axis(
            steps_per_mm=100.0,
            max_velocity=500.0 * part,
            max_acceleration=axis[0] * part if axis else None,
            max_jerk=axis[1] * part if axis else None,
        )
        for letter, part in zip("xyz", slow, strict=True)
    }
    a, normal, jerk = along or (None, None, None)
    limits = PathLimits(
        max_feed=500.0,
        max_tangential_acceleration=a,
        max_normal_acceleration=normal,
        max_jerk=jerk,
        **path,
    )
    return Machine(axes=axes, path=limits, board=Board(max_step_rate=1e9))


MACHINES = {
    "path": mill(),
    "axes": mill(along=None, axis=(2400.0, 48000.0)),
    "both": mill(axis=(1000.0, 100_000.0)),
    "axes that differ": mill(along=None, axis=(3000.0, 60_000.0), slow=(1.0, 0.001, 1.0)),
    "tiny chord error": mill(chord_error=1e-6),
    "tinier chord error": mill(axis=(2400.0, 48000.0), chord_error=1e-9),
    "large chord error": mill(axis=(2400.0, 48000.0), chord_error=1.0, step_deviation=0.1),
    "short period": mill(axis=(2400.0, 48000.0), period=1e-4),
    "long period": mill(axis=(2400.0, 48000.0), period=1e-2),
    "little jerk": mill(axis=(2400.0, 100.0)),
    "much jerk": mill(axis=(2400.0, 1e9)),
    "tolerance 0": mill(axis=(2400.0, 48000.0), tolerance=0.0),
}
EVERYWHERE = ("path", "axes", "both")
UNUSUAL = [name for name in MACHINES if name not in EVERYWHERE]
SOME = (
    "a cusp",
    "spikes",
    "a star",
    "a closed loop",
    "knots thrice inside: a corner",
    "feed of 1e6",
    "a circle of 1 um",
    "below a step",
)

ALL = [
    (program, prefix, machine)
    for program in PROGRAMS
    for prefix in ("exact", "G64")
    for machine in EVERYWHERE
]
ALL += [
    (program, prefix, "axes")
    for program in SOME
    for prefix in PREFIXES
    if prefix not in ("exact", "G64")
]
ALL += [
    (program, prefix, machine)
    for program in SOME
    for prefix in ("exact", "G64")
    for machine in UNUSUAL
]
BENDS = [name for name in PROGRAMS if name.startswith("a cusp but for")]
QUICK = [
    (program, ("exact", "G64")[k % 2], EVERYWHERE[k % 3])
    for k, program in enumerate(name for name in PROGRAMS if name not in BENDS)
]
QUICK += [
    (SOME[k % len(SOME)], ("G64", "exact")[k % 2], machine) for k, machine in enumerate(UNUSUAL)
]
QUICK += [
    ("spikes", "G64", "axes that differ"),
    ("a star", "tolerance 10", "axes"),
    ("a star", "exact stop", "axes"),
]


class Elsewhere:
    """A process that checks programs; one that takes too long is ended, and the next begins in a
    new one.
    """

    def __init__(self) -> None:
        self.pool = None

    def examine(self, program: str, machine: Machine, folder: Path) -> Findings:
        if self.pool is None:
            self.pool = multiprocessing.get_context("spawn").Pool(1)
        try:
            return self.pool.apply_async(examine, (program, machine, folder)).get(LONGEST)
        except multiprocessing.TimeoutError:
            self.end()
            pytest.fail(f"no end within {LONGEST:g} s")

    def end(self) -> None:
        if self.pool is not None:
            self.pool.terminate()
            self.pool.join()
            self.pool = None


@pytest.fixture(scope="module")
def elsewhere(tmp_path_factory) -> Iterator[Elsewhere]:
    # Here, so that nothing is left to compile there: a process that is ended in the midst of that
    # would leave another one to do it.
    examine("G1 X1 F600\nM2\n", MACHINES["both"], tmp_path_factory.mktemp("first"))
    process = Elsewhere()
    yield process
    process.end()


@pytest.mark.parametrize(
    ("program", "prefix", "machine"), share(ALL, QUICK), ids=lambda part: part.replace(" ", "_")
)
def test_hard_input_is_planned_legally_or_refused(program, prefix, machine, elsewhere, tmp_path):
    found = elsewhere.examine(
        f"G21 G90 G94 G17\n{PREFIXES[prefix]}\n{PROGRAMS[program]}\nM2\n",
        MACHINES[machine],
        tmp_path,
    )
    assert found.refused == REFUSALS.get(program, ""), found.wrong
    if not found.refused:
        assert not found.wrong
        assert math.isfinite(found.duration)


def test_a_sharp_bend_takes_no_longer_than_a_cusp(elsewhere, tmp_path):
    """However sharp: its parts are looked at on the scale of its radius, and below that it is a
    stop.
    """
    for machine in share(EVERYWHERE, ("both",)):
        cusp, *nearly = (
            elsewhere.examine(
                f"G21 G90 G94 G17\nG61\n{PROGRAMS[name]}\nM2\n", MACHINES[machine], tmp_path
            )
            for name in ("a cusp", *BENDS)
        )
        assert not any(found.wrong for found in nearly)
        assert max(found.duration for found in nearly) < 2.0 * cusp.duration


@pytest.mark.parametrize("machine", share(EVERYWHERE, ["both"]))
def test_years_of_motion_are_planned_without_delay(machine, tmp_path):
    """Nothing is counted off period by period where nothing happens."""
    speed, scale = 1e-6, share(10.0, 0.1)
    file = tmp_path / "p.nc"
    file.write_text(
        f"G21 G90 G94 G17\nG64\nG1 X{6 * scale:g} Y{8 * scale:g} F{60 * speed:f}\n"
        f"G2 Y0 I0 J{-4 * scale:g}\nM2\n"
    )
    report = check(file, MACHINES[machine])
    assert report.ok
    length = (10.0 + 4.0 * math.pi) * scale
    # The turn between line and arc is rounded within the tolerance.
    assert report.duration_s == pytest.approx(length / speed, abs=0.005 / speed)


def test_a_part_below_a_tenth_of_a_nanometre_is_straight():
    """Weights up to 40 000 apart put a hairpin into a part of 7e-8 mm; its bends went unseen."""
    points = np.array(
        [[0, 0], [23, 9], [37, 33], [106, 107], [200, 163], [147, 146], [148, 78], [130, 87.0]]
    )
    block = NurbsFeed(
        "t.nc",
        1,
        2,
        np.array([0, 0, 0, 1, 2, 3, 4, 5, 6, 6, 6.0]),
        np.column_stack((points * 1e-5, np.zeros(8))),
        np.array([0.536561, 0.00982055, 5.80254, 0.0199827, 796.405, 0.100949, 0.764758, 0.884855]),
        1.0 / 60.0,
    )
    slow = mill_of(
        axis=(865.4356, 28489.99), tangential=50.36842, normal=119.245, jerk=1691.85, max_feed=359.0
    )
    ahead = LookAhead(slow)
    path = list(path_of([PathMode("t.nc", 1, "exact-path"), block]))
    assert min(float(chunk.length.min()) for chunk in path) < TINY
    end = list(ahead.plan(path))[-1]
    assert not ahead.audit.violations
    assert end.phase_s[-1] == pytest.approx(sum(float(chunk.length.sum()) for chunk in path))
