"""Lines of programs with known geometry, carried out in GRBL's arithmetic: the same motion."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cnc.api import start_position
from cnc.gcode.core.program import interpret
from cnc.gcode.reader.source_text import Text
from cnc.grbl_lines.path_samples import MARGIN
from cnc.grbl_lines.translator import Translator
from cnc.machine.load import load_machine
from cnc.machine.models import Machine
from cnc.path.build import build, exact_path
from cnc.path.chunk import PathChunk
from tests.support.boards.grbl_replay import (
    PLANES,
    Refused,
    leash_of,
    parted_at,
    read_number,
    replayed,
    same_motion,
)
from tests.support.deviation import path_points
from tests.support.programs.geometry_programs import Geometry, geometry
from tests.support.soak import share

ROUTER = load_machine("grbl-uno")
FLOATS = 1e-4
"""mm: largest distance of the chords of the expected path from it."""


def with_travel(machine: Machine, spans: list[tuple[float, float] | None]) -> Machine:
    axes = {
        letter: axis.model_copy(update={"travel": span})
        for (letter, axis), span in zip(machine.axes.items(), spans, strict=True)
    }
    return machine.model_copy(update={"axes": axes})


ANYWHERE = with_travel(ROUTER, [None] * 3)


def lines_of(
    program: list[str], machine: Machine, tolerance: float = 0.01, **options: object
) -> list[str]:
    start = start_position(machine)
    blocks = interpret(
        Text.of_lines(program, "p.nc"), axes=machine.axis_names, start=start, dialect="auto"
    )
    translator = Translator(machine, tolerance, **options)  # type: ignore[arg-type]
    path = exact_path(blocks, axes=machine.axis_names, start=start)
    lines = [line for item in path for line in translator.lines(item)]
    return [line.text for line in (*lines, *translator.end())]


def compare(truth: np.ndarray, texts: list[str], leash: float, **board: object) -> None:
    played = np.array(replayed(texts, **board).points)
    assert same_motion(truth, played, leash), (
        f"{leash_of(truth, played)} mm apart at {parted_at(truth, played, leash)}"
    )


def short_moves(seed: int) -> np.ndarray:
    """Return the ends of short moves along a random curve, as a CAM system rounds them."""
    rng = np.random.default_rng(seed)
    count, step = 400, rng.choice([0.01, 0.03, 0.06, 0.15])
    turns = rng.normal(0.0, rng.choice([0.0, 0.01, 0.1, 0.6]), count)
    angle = np.cumsum(step * rng.choice([0.02, 0.3, 2.0]) * np.sin(np.arange(count) * 0.02)) + turns
    rise = step * rng.choice([0.0, 0.2]) * np.cos(np.arange(count) * 0.05)
    steps = np.column_stack((step * np.cos(angle), step * np.sin(angle), rise))
    return np.round(np.cumsum(steps, axis=0), 3)


@settings(max_examples=share(600, 7))
@given(seed=st.integers(0, 10**6), tolerance=st.sampled_from([0.01, 0.002, 0.05]))
def test_short_moves_are_the_same_motion_in_grbl(seed, tolerance):
    """Also where fewer lines and arcs replace them, because the board reads no faster."""
    points = short_moves(seed)
    program = ["G21 G90 G94", "G1 X0 Y0 Z0 F3000", *(f"X{x} Y{y} Z{z}" for x, y, z in points)]
    texts = lines_of([*program, "M2"], ANYWHERE, tolerance)
    compare(np.concatenate((np.zeros((1, 3)), points)), texts, tolerance + FLOATS)


OFFSETS = st.tuples(*[st.floats(-300, 300).map(lambda x: round(x, 3))] * 3)


@settings(max_examples=share(1000, 4))
@given(
    seed=st.integers(0, 10**6),
    offset=OFFSETS,
    tolerance=st.sampled_from([0.01, 0.01, 0.005, 0.002, 0.001, 0.05]),
    arc_tolerance=st.sampled_from([0.002, 0.002, 0.001, 0.005, 0.01]),
)
def test_random_programs_are_the_same_motion_in_grbl(seed, offset, tolerance, arc_tolerance):
    made = geometry(seed)
    texts = lines_of(
        made.lines, ANYWHERE, tolerance, work_offset=offset, arc_tolerance=arc_tolerance
    )
    compare(
        np.concatenate(made.points),
        texts,
        tolerance + FLOATS,
        offset=offset,
        arc_tolerance=arc_tolerance,
    )


@settings(max_examples=share(500, 3))
@given(
    seed=st.integers(0, 10**6), offset=OFFSETS, error=st.tuples(*[st.floats(-4.9e-4, 4.9e-4)] * 3)
)
def test_lines_stay_within_the_travel(seed, offset, error):
    """The travel ends at the program's path, and the reported offset of the board is rounded."""
    made = geometry(seed)
    truth = np.concatenate(made.points)
    spans = [
        (float(low), float(max(high, low + 0.01)))
        for low, high in zip(truth.min(axis=0), truth.max(axis=0), strict=True)
    ]
    machine = with_travel(ROUTER, [(low - 1e-9, high + 1e-9) for low, high in spans])
    texts = lines_of(made.lines, machine, work_offset=offset, margin=MARGIN)
    real = tuple(told + off for told, off in zip(offset, error, strict=True))
    compare(truth, texts, 0.01 + 2.5 * MARGIN, offset=real, travel=spans)


@pytest.mark.parametrize("seed", [211, 595, 1045])
def test_rounding_along_a_helix_far_from_zero_is_small(seed):
    made = geometry(seed)
    compare(np.concatenate(made.points), lines_of(made.lines, ANYWHERE), 0.01)


def test_a_circle_that_touches_the_end_of_the_travel_raises_no_alarm():
    machine = with_travel(ROUTER, [(-100.0, 0.0), (-100.0, 0.0), (-50.0, 0.0)])
    program = [
        "G21 G90 G17",
        "G0 X-20 Y-10",
        "G2 I10 F900",
        "G0 Z-1 X-3",
        "G1 X0 Y-5",
        "G53 G0 Z0",
        "M2",
    ]
    turn = np.linspace(math.pi, -math.pi, 2000)
    circle = np.column_stack((-10 + 10 * np.cos(turn), -10 + 10 * np.sin(turn), np.zeros(2000)))
    truth = np.concatenate(
        ([[0, 0, 0], [-20, -10, 0]], circle, [[-3, -10, -1], [0, -5, -1], [0, -5, 0]])
    )
    offset = (-33.334, -20.0, -12.001)
    real = (-33.33352, -19.9996, -12.00055)
    texts = lines_of(program, machine, work_offset=offset, margin=MARGIN)
    compare(truth, texts, 0.01 + 2 * MARGIN, offset=real, travel=[(-100, 0), (-100, 0), (-50, 0)])


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1.5", 1.5),
        ("-0.0625", -0.0625),
        (".5", 0.5),
        ("-12", -12.0),
        ("123.45678", 123.45678),
        ("0", 0.0),
    ],
)
def test_replay_reads_numbers_as_grbl_does(text, value):
    assert read_number(text) == pytest.approx(value, rel=3e-7)


def test_replay_refuses_the_errors_of_grbl():
    begun = ["G21 G90", "G1 X10 F100"]
    for line in [
        "G2 X20 I4",
        "G2 I5",
        "G2 X20",
        "G1 Y5 I3",
        "G1 X1 X2",
        "X" + "1" * 79,
        "G2 X20 K5",
    ]:
        with pytest.raises(Refused):
            replayed([*begun, line])
    with pytest.raises(Refused, match="ALARM:2"):
        replayed([*begun, "G2 X20 I5"], travel=((-1.0, 100.0), (-1.0, 4.9), (-1.0, 1.0)))


def test_comparison_detects_another_order():
    """A motion to and fro and again is another motion, although its points are the same."""
    there = np.array([[0.0, 0, 0], [10, 0, 0]])
    again = np.array([[0.0, 0, 0], [6, 0, 0], [4, 0, 0], [10, 0, 0]])
    assert leash_of(there, again) == pytest.approx(1.0, abs=1e-3)
    assert leash_of(there, there[::-1]) == math.inf or leash_of(there, there[::-1]) >= 10.0 - 1e-3
    circle = np.column_stack(
        (np.cos(np.linspace(0, 6.28318, 500)), np.sin(np.linspace(0, 6.28318, 500)), np.zeros(500))
    )
    assert leash_of(circle, np.concatenate((circle, circle))) > 0.9
    assert leash_of(circle, circle + [0.0, 0.0, 0.01]) == pytest.approx(0.01, abs=1e-4)


@settings(max_examples=share(300, 3))
@given(seed=st.integers(0, 10**6))
def test_lines_are_a_program_in_the_dialect_of_grbl(seed):
    """The lines are a program in GRBL's dialect alone, with the same path."""
    made = geometry(seed)
    again = interpret(
        Text.of_lines(lines_of(made.lines, ANYWHERE), "again.nc"),
        axes=ANYWHERE.axis_names,
        dialect="grbl",
    )
    path = build(again, axes=ANYWHERE.axis_names, start=np.zeros(3))
    points = np.concatenate(
        [np.zeros((1, 3)), *(path_points(chunk) for chunk in path if isinstance(chunk, PathChunk))]
    )
    truth = np.concatenate(made.points)
    assert same_motion(truth, points, 0.01 + FLOATS), leash_of(truth, points)


@settings(max_examples=share(300, 3))
@given(seed=st.integers(0, 10**6))
def test_feeds_respect_acceleration_and_line_rate(seed):
    """Centripetal acceleration is at most that of two axes together; a board reads 385 lines/s.

    F words may be left out within a twentieth of the feed.
    """
    replay = replayed(lines_of(geometry(seed).lines, ANYWHERE))
    points, feeds = np.array(replay.points), np.array(replay.feeds) / 60.0
    assert not (feeds[1:] <= 0.0).any()
    pull = 250.0 * math.sqrt(2.0) * 1.05**2 * 1.05
    for line, plane, radius in replay.arcs:
        chord = np.flatnonzero(np.array(replay.sources) == line)
        ways = points[chord] - points[chord - 1]
        level = (
            np.linalg.norm(np.delete(ways, PLANES[plane][2], axis=1), axis=1).sum()
            / np.linalg.norm(ways, axis=1).sum()
        )
        assert (feeds[chord[0]] * level) ** 2 / radius <= pull
    ends = np.flatnonzero(np.diff(replay.sources, append=-1))
    seconds = np.add.reduceat(
        np.linalg.norm(np.diff(points, axis=0, prepend=points[:1]), axis=1)
        / np.nan_to_num(feeds, nan=1.0),
        [0, *ends[:-1] + 1],
    )
    ahead = 15
    for first in range(len(seconds) - 2 * ahead):
        assert seconds[first : first + 2 * ahead].sum() >= 0.95 * ahead / 385.0


def chords(points: np.ndarray, tolerance: float) -> int:
    """Return the number of chords along a curve, each as long as the tolerance allows."""
    count, begin, last = 0, 0, len(points) - 1
    while begin < last:
        good, reach = begin + 1, 2
        while begin + reach <= last and straight(points[begin : begin + reach + 1], tolerance):
            good = begin + reach
            reach = math.ceil(1.05 * reach) + 1
        begin, count = good, count + 1
    return count


def straight(points: np.ndarray, tolerance: float) -> bool:
    way = points[-1] - points[0]
    length = np.linalg.norm(way)
    if not length:
        return False
    unit = way / length
    out = points - points[0]
    return bool(np.linalg.norm(out - np.outer(out @ unit, unit), axis=1).max() <= tolerance)


@pytest.mark.parametrize("degree", [2, 3, 4, 5])
def test_splines_take_fewer_lines_than_chords(degree):
    """Random splines in a plane need at most six tenths of the lines that chords need.

    Weights and knots are of all kinds. The chords have the same tolerance, end on the curve, and
    are as long as possible.
    """
    ours = theirs = 0
    for seed in range(share(40, 2)):
        made = Geometry(np.random.default_rng(seed))
        made.points.append(np.zeros((1, 3)))
        made.lines += ["G21 G90 G94 G17", "G0 X0 Y0 Z0"]
        made.nurbs(degree, flat=True)
        ours += sum(text[0] in "XYGIJ" for text in lines_of([*made.lines, "M2"], ANYWHERE)[1:])
        theirs += chords(np.concatenate(made.points), 0.01)
    assert ours <= 0.6 * theirs
