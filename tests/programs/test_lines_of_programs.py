"""Programs as lines: a reader of GRBL's language finds the motion of the program in them."""

import math
from collections.abc import Iterable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from cnc.api import start_position
from cnc.gcode.core.program import interpret
from cnc.gcode.reader.source_text import Text
from cnc.grbl_lines.board_limits import BoardLimits
from cnc.grbl_lines.grbl_timing import BoardTime
from cnc.grbl_lines.number_format import Move as PlannedMove
from cnc.grbl_lines.number_format import PlaneArc
from cnc.grbl_lines.translator import PREAMBLE, Translator
from cnc.grbl_lines.writer import LineWriter
from cnc.machine.load import load_machine
from cnc.machine.models import Machine
from cnc.model.blocks import Block, BoardCommand, NurbsFeed, PathMode
from cnc.model.diagnostics import GcodeError
from cnc.model.line_effects import ARCS, MOTIONS, LineKind, effects_of
from cnc.model.streams import GcodeLine, PackedLines
from cnc.path.build import build, exact_path
from cnc.path.chunk import PathChunk
from tests.support.boards.board_reader import Move, Reader
from tests.support.boards.line_reader import LineReader, lines_with_effects
from tests.support.deviation import dense, deviation, farthest, path_points
from tests.support.paths import ROOT
from tests.support.programs.random_programs import random_program
from tests.support.soak import share

FOLDER = ROOT / "programs"
LONG = ("bezier", "finishing", "pocket")
"""Shipped programs whose motion has many points."""
MILL = load_machine(None)
TOLERANCE = MILL.path.tolerance
ANYWHERE = {
    letter: axis.model_copy(update={"travel": None})
    for letter, axis in load_machine("grbl-uno").axes.items()
}
"""The axes of a router without travel."""


def blocks_of(program: str, machine: Machine = MILL) -> list[Block]:
    return list(
        interpret(
            Text.of_lines(program.splitlines(), "p.nc"),
            axes=machine.axis_names,
            start=start_position(machine),
        )
    )


def translated(
    blocks: Iterable[Block], machine: Machine = MILL, **options: object
) -> list[GcodeLine]:
    """Return the lines of a program."""
    translator = Translator(machine, **options)
    path = exact_path(blocks, axes=machine.axis_names, start=start_position(machine))
    lines = [line for item in path for line in translator.lines(item)]
    return lines + list(translator.end())


def exact(blocks: Iterable[Block], machine: Machine = MILL) -> np.ndarray:
    """Return points of the programmed path, with G61 throughout."""
    motion = (block for block in blocks if not isinstance(block, PathMode))
    path = build(motion, axes=machine.axis_names, start=start_position(machine))
    return np.concatenate([path_points(chunk) for chunk in path if isinstance(chunk, PathChunk)])


def read(lines: Iterable[GcodeLine], start: Iterable[float] = (0.0, 0.0, 0.0)) -> list[Move]:
    reader = Reader(at=dict(zip("XYZ", start, strict=True)))
    return [move for line in lines if (move := reader.read(line.text)) is not None]


def motion(moves: Iterable[Move]) -> np.ndarray:
    return np.concatenate([move.points for move in moves])


def texts(program: str, **options: object) -> list[str]:
    return [line.text for line in translated(blocks_of(program), **options)]


@pytest.mark.parametrize(
    "file",
    [
        file.stem
        for file in sorted(FOLDER.glob("*.nc"))
        if file.stem not in ("probing", "turned-thread", *share((), LONG))
    ][:: share(1, 2)],
)
def test_shipped_programs_are_the_same_motion(file):
    blocks = list(
        interpret(
            Text.of_file(FOLDER / f"{file}.nc"), axes=MILL.axis_names, start=start_position(MILL)
        )
    )
    assert deviation(motion(read(translated(blocks))), exact(blocks)) <= TOLERANCE


@settings(max_examples=share(300, 7))
@given(
    seed=st.integers(0, 10**6),
    offset=st.tuples(*[st.floats(-100, 100).map(lambda x: round(x, 3))] * 3),
)
def test_random_programs_are_the_same_motion_with_any_work_offset(seed, offset):
    blocks = blocks_of(random_program(seed))
    moves = read(translated(blocks, work_offset=offset), start=-np.array(offset))
    assert deviation(motion(moves) + offset, exact(blocks)) <= TOLERANCE


def test_the_trident_needs_less_than_a_third_of_the_lines_of_chords():
    """Chords by halving, which takes 74; in equal steps of the parameter they are 107. We say 23
    lines.
    """
    (curve,) = (
        block
        for block in blocks_of((FOLDER / "trident.nc").read_text())
        if isinstance(block, NurbsFeed)
    )
    spline = BSpline(curve.knots, curve.control_points, curve.degree)

    def chords(a: float, b: float) -> int:
        points = spline(np.linspace(a, b, 201))
        if farthest(points, dense(points[[0, -1]], 0.01)) <= TOLERANCE:
            return 1
        return chords(a, 0.5 * (a + b)) + chords(0.5 * (a + b), b)

    many = sum(chords(a, a + 0.25) for a in (0.0, 0.25, 0.5, 0.75))
    ours = sum(
        move.mode != 0 for move in read(translated(blocks_of((FOLDER / "trident.nc").read_text())))
    )
    assert 70 <= many <= 80
    assert ours <= many / 3


def test_programmed_arcs_are_one_line_and_circles_two():
    program = """G21 G90 G94 G17 F600
G1 X20 Y0 Z0
G2 X20 Y0 I-5 J0 (a full circle)
G3 X10 Y10 Z-2 I-10 J0 (a helix)
G18 G2 X15 Z3 I5 K0
G19 G3 Y12 Z1 J0 K-2
M2
"""
    assert texts(program) == [
        PREAMBLE,
        "G1 X20 F600",
        "G2 X10 I-5",
        "X20 I5",
        "G3 X10 Y10 Z-2 I-10",
        "G18 G2 X15 Z3 I5",
        "G19 G3 Y12 Z1 K-2",
        "M2",
    ]


def turned(move: Move, before: np.ndarray, offset: np.ndarray) -> float:
    """Return the angle of an arc as GRBL's mc_arc computes it from the text, with 32-bit floats."""
    f = np.float32
    words = {word[0]: f(word[1:]) for word in move.text.split()}
    here = [f(f(value) + f(shift)) for value, shift in zip(before[:2], offset, strict=False)]
    there = [
        f(f(value) + f(shift)) for value, shift in zip(move.points[-1][:2], offset, strict=False)
    ]
    out = -words.get("I", f(0)), -words.get("J", f(0))
    end = [f(t - f(h - o)) for t, h, o in zip(there, here, out, strict=True)]
    angle = math.atan2(
        f(f(out[0] * end[1]) - f(out[1] * end[0])), f(f(out[0] * end[0]) + f(out[1] * end[1]))
    )
    if move.mode == 2:
        return angle - math.tau if angle >= -5e-7 else angle
    return angle + math.tau if angle <= 5e-7 else angle


@settings(max_examples=share(2000, 14))
@given(
    radius=st.floats(-2.5, 3.0).map(lambda x: 10.0**x),
    angle=st.floats(0.0, math.tau),
    sweep=st.one_of(st.just(math.tau), st.just(1e-4), st.floats(1e-3, math.tau)),
    clockwise=st.booleans(),
    offset=st.tuples(st.floats(-300, 300), st.floats(-300, 300)).map(
        lambda at: np.array([round(at[0], 3), round(at[1], 3), 0.0])
    ),
)
def test_arcs_turn_as_far_with_the_floats_of_a_board(radius, angle, sweep, clockwise, offset):
    """An arc never becomes a full circle, and a full circle never vanishes."""
    sweep = min(sweep, 50.0 / radius) * (-1.0 if clockwise else 1.0)
    center = offset[:2] + radius * np.array([math.cos(angle), math.sin(angle)])
    writer = LineWriter(offset.tolist(), 0.01, 115200, "XYZ", "XYZ", 0.002)
    writer.stands_at((*offset[:2].tolist(), 0.0))
    x, y = center - radius * np.array([math.cos(angle + sweep), math.sin(angle + sweep)])
    arc = PlaneArc(0, (float(center[0]), float(center[1])), sweep)
    move = PlannedMove((float(x), float(y), 0.0), arc, 0, 10.0, 10.0, line=1, rests=False)
    texts = [line.text for line in writer.move(move)]
    before, reader, total = np.zeros(3), Reader(), 0.0
    for text in texts:
        move = reader.read(text)
        assert move is not None
        if move.mode in (2, 3):
            found = turned(move, before, offset)
            assert abs(found) <= 0.8 * math.tau
            total += found
        before = move.points[-1]
    if all(" I" in text or " J" in text for text in texts) and texts:
        assert total * radius == pytest.approx(sweep * radius, abs=0.005)


def test_feeds_on_small_arcs_keep_acceleration_and_jerk():
    """Centripetal acceleration v^2 / r and its change v^3 / r^2, at most one axis' limits."""
    machine = load_machine("grbl-uno")
    program = (
        "G21 G90 G17\nG1 X20 F1500\nG3 X20.4 Y0.4 I0 J0.4\nG1 Y20 F900\nX21\n"
        "G2 X21.2 I0.1 J0 F1900\nG2 X33.2 I6 J0\nM2\n"
    )
    feeds = [move.feed for move in read(translated(blocks_of(program, machine), machine))]
    limits = [
        60.0 * min(math.sqrt(250.0 * radius), math.cbrt(10000.0 * radius * radius))
        for radius in (0.4, 0.1)
    ]
    expected = [1500.0, limits[0], 900.0, 900.0, limits[1], 1900.0]
    assert feeds == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("scale", [0.3, 1.0, 4.0])
def test_feeds_on_a_curve_keep_acceleration_and_jerk(scale):
    """Along a spline of scipy, v^2 |q''| and v^3 |q'''| by arc length, for each axis."""
    machine = load_machine("grbl-uno")
    points = scale * np.array([[0, 0], [6, 9], [12, -9], [15, 12], [21, 0], [30, 3.0]])
    knots = [0, 0, 0, 0, 1, 2, 3, 3, 3, 3]
    curve = NurbsFeed(
        "p.nc", 1, 3, np.array(knots, float), np.pad(points, ((0, 0), (0, 1))), np.ones(6), 30.0
    )
    spline = BSpline(knots, points, 3)
    u = np.linspace(0.0, 3.0, 30001)
    speed = np.linalg.norm(spline(u, 1), axis=1)
    s = np.concatenate(([0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(u))))
    tangent = spline(u, 1) / speed[:, None]
    bend = np.gradient(tangent, s, axis=0)
    cap = np.minimum(
        np.sqrt(250.0 / np.abs(bend).max(axis=1)),
        np.cbrt(10000.0 / np.abs(np.gradient(bend, s, axis=0)).max(axis=1)),
    )
    here = 0.0
    for move in read(translated([curve], machine)):
        first, here = here, here + np.linalg.norm(np.diff(move.points, axis=0), axis=1).sum()
        inside = (s >= first - 0.02) & (s <= here + 0.02)
        most = min(30.0, float(cap[inside].max()))
        assert move.feed is not None
        assert 0.7 * min(30.0, float(cap[inside].min())) <= move.feed / 60.0 <= 1.08 * most


def test_straight_moves_of_the_program_keep_its_feed():
    """The board itself slows down at the corners; a sender that plans them too is slower."""
    steps = np.random.default_rng(5).normal(0.15, 0.1, (400, 2))
    points = np.cumsum(steps, axis=0)
    program = "G21 G90\nF1200\n" + "".join(f"G1 X{x:.3f} Y{y:.3f}\n" for x, y in points) + "M2\n"
    machine = load_machine("grbl-uno")
    moves = read(translated(blocks_of(program, machine), machine))
    assert {move.feed for move in moves if move.mode == 1} == {1200.0}


@pytest.mark.parametrize("seed", range(4)[:: share(1, 2)])
def test_short_moves_take_no_longer_than_as_they_stand(seed):
    """The time on the board, by the model of its planner, is that of the program's own lines."""
    generator = np.random.default_rng(seed)
    turns = generator.normal(0.0, 0.05 * 3.0**seed, 1500)
    angles = np.cumsum(turns) * 0.5
    points = np.cumsum(0.2 * np.column_stack((np.cos(angles), np.sin(angles))), axis=0)
    own = ["G21 G90 F1800", *(f"G1 X{x:.3f} Y{y:.3f}" for x, y in points)]
    machine = load_machine("grbl-uno").model_copy(update={"axes": ANYWHERE})
    ours = [line.text for line in translated(blocks_of("\n".join(own), machine), machine)]
    times = []
    for lines in (own, ours):
        clock = BoardTime(BoardLimits.of_machine(machine))
        for line in lines_with_effects(lines):
            clock.add(line)
        clock.end()
        times.append(clock.seconds)
    assert times[1] <= 1.01 * times[0]


def assert_effects_match(lines: list[GcodeLine]) -> None:
    """Each line carries the effect that its text has, to the last bit."""
    assert lines
    reader = LineReader()
    for line in lines:
        found, expected = line.effect, reader.read(line.text, line.line).effect
        assert found is not None
        assert expected is not None
        assert found.kind == expected.kind
        assert found.seconds == expected.seconds
        if found.kind in MOTIONS:
            np.testing.assert_array_equal(found.target, expected.target)
            assert found.kind is LineKind.RAPID or found.feed == expected.feed
        if found.kind in ARCS:
            assert (found.plane, found.center) == (expected.plane, expected.center)


@settings(max_examples=share(300, 7))
@given(
    seed=st.integers(0, 10**6),
    offset=st.tuples(*[st.floats(-100, 100).map(lambda x: round(x, 3))] * 3),
)
def test_lines_of_random_programs_carry_the_effects_of_their_text(seed, offset):
    blocks = blocks_of(random_program(seed))
    assert_effects_match(translated(blocks, work_offset=offset, moving="xyz"))


@pytest.mark.parametrize("file", ["pocket", "drilling", "probing", "thread-mill", "bezier"])
def test_lines_of_shipped_programs_carry_the_effects_of_their_text(file):
    blocks = interpret(
        Text.of_file(FOLDER / f"{file}.nc"), axes=MILL.axis_names, start=start_position(MILL)
    )
    assert_effects_match(translated(blocks))


def test_packed_lines_are_the_same_lines():
    lines = translated(blocks_of("G21 G90\nG1 X10 F500\nG2 X20 I5\nG4 P2\nM3 S100\nM2\n"))
    lines.append(GcodeLine("$X", 9))
    packed = PackedLines.of(lines)
    assert len(packed) == len(lines)
    assert packed.text == "".join(line.text + "\n" for line in lines)
    assert str(list(effects_of(packed.rows))) == str([(line.line, line.effect) for line in lines])


def test_axes_without_a_known_position_are_not_named_before_an_arc():
    blocks = blocks_of("G21 G90\nG0 X10\nG2 X20 I5 F500\nM2\n")
    arc = next(k for k, block in enumerate(blocks) if block.line == 3)
    blocks.insert(arc, BoardCommand("p.nc", 3, "$G"))
    lines = [line.text for line in translated(blocks, moving="xy")]
    assert lines == [PREAMBLE, "G0 X10", "$G", "G1 X10 Y0 Z0 F500", "G2 X20 I5", "M2"]


def test_every_line_names_its_source_line():
    lines = translated(blocks_of("G21 G90\nG1 X10 F500\nG2 X20 I5\nG1 Y5\nM3 S100\nM5\nM2\n"))
    assert [line.line for line in lines[1:]] == [2, 3, 4, 5, 6, 7]


@pytest.mark.parametrize(
    ("block", "expected"),
    [
        ("G4 P2.5", ["G4 P2.5"]),
        ("G4 P7000", ["G4 P3000", "G4 P3000", "G4 P1000"]),
        ("M3 S1000\nM3 S1500\nM4\nM5\nM5", ["M3 S1000", "S1500", "M4 S1500", "M5"]),
        ("M8\nM8\nM9", ["M8", "M9"]),
        ("M3 S1\nT3 M6", ["M3 S1", "M5", "M0 (MSG, put in tool 3, then resume)"]),
        ("M0", ["M0"]),
        ("M1", ["M1"]),
        ("(MSG, Ready? Go! ~ 5%)", ["(MSG, Ready. Go. - 5)"]),
        ("(MSG, größer)", ["(MSG, gr..er)"]),
    ],
)
def test_commands(block, expected):
    assert texts(f"G21\n{block}\nM2\n") == [PREAMBLE, *expected, "M2"]


@pytest.mark.parametrize(
    "block",
    [
        "M7",
        "M62 P1",
        "M68 E1 Q2",
        "M66 P1 L0",
        "M19 R90",
        "G96 D1000 S100\nM3",
        "M3 S100\nG33 Z-1 K1",
    ],
)
def test_unsupported_commands_are_refused_at_their_line(block):
    with pytest.raises(GcodeError) as caught:
        texts(f"G21 G90\n{block}\nM2\n")
    assert caught.value.diagnostic.code == "not-on-board"
    assert caught.value.diagnostic.line >= 2


def test_exact_stops_bring_the_board_to_rest():
    assert texts("G21 G90 G61.1\nG1 X10 F600\nG1 X20\nG61 G1 X20 Y10\nM2\n") == [
        PREAMBLE, "G1 X10 F600", "G4 P0", "X20", "G4 P0", "Y10", "M2",
    ]  # fmt: skip


def test_the_line_after_a_probe_names_all_axes():
    assert texts("G21 G90\nG0 X5 Y5\nG38.2 Z-5 F100\nG0 Z2\nM2\n") == [
        PREAMBLE,
        "G0 X5 Y5",
        "G38.2 Z-5 F100",
        "M0 (MSG, the probe of line 3 was not made: go on in a dry run only)",
        "G0 X5 Y5 Z2",
        "M2",
    ]
