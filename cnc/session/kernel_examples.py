"""Examples that call the kernels of each job of :mod:`cnc.session.kernel_jobs`.

This module imports all of the program that has kernels, so only a process that compiles or loads
them imports it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from tempfile import NamedTemporaryFile

import numpy as np

from cnc.boards.klipper.sender import StepEncoder
from cnc.boards.stepper.segments import SegmentEncoder, split
from cnc.gcode import dialects
from cnc.gcode.core.line_steps import MANY_LINES, SHORTEST
from cnc.gcode.core.program import interpret
from cnc.gcode.reader.layout import formatted
from cnc.gcode.reader.lines import read_line
from cnc.gcode.reader.source_text import Text
from cnc.grbl_lines.board_limits import BoardLimits
from cnc.grbl_lines.grbl_timing import BoardTime
from cnc.grbl_lines.translator import Translator
from cnc.machine.models import Axis, Machine, PathLimits, Stock
from cnc.model.blocks import ArcFeed, AxisLetter, Block, NurbsFeed, PathMode, Polyline
from cnc.model.diagnostics import MotionLimitError
from cnc.model.operator_control import Control
from cnc.model.streams import PulseChunk
from cnc.path.build import build
from cnc.path.chunk import PathChunk, bounding_box
from cnc.path.kernels.bspline import nurbs_chord_ends
from cnc.path.kernels.curve import SPAN
from cnc.planner.audit import Audit
from cnc.planner.corner_hold import stop_inside
from cnc.planner.finished import ChainLeft
from cnc.planner.joints import joint_records
from cnc.planner.kernels.joint_records import ORDER, JointPieces
from cnc.planner.kernels.slowed_clock import pace_wanted
from cnc.planner.kernels.stopping import FAR, shortest_ramp
from cnc.planner.kernels.timed import timed_motion
from cnc.planner.known_path import KnownPath, junction_between
from cnc.planner.limits import Limits
from cnc.planner.lookahead import LookAhead
from cnc.planner.phases import plan_to_rest
from cnc.planner.plan import PlanChunk
from cnc.planner.slowing import copy_by_clock, ramp_by_clock
from cnc.pulses.reference_pulse import ReferencePulse
from cnc.pulses.sampled import Sampled
from cnc.session.pipeline import path_of
from cnc.stock.kernels.sweep import FLAT, Assembly, Cutter
from cnc.stock.simulation import Material
from cnc.view.collect import Collector, Sizes

AXES: tuple[AxisLetter, ...] = ("x", "y", "z")


def read() -> None:
    """Read straight moves, and a line alone."""
    _read(["G0 X1"] * SHORTEST)
    read_line("G0 X1", "ngc")


def write_anew() -> None:
    """Write a line in its form."""
    with NamedTemporaryFile() as file:
        file.write(b"G0 X1")
        file.flush()
        for _ in formatted(Path(file.name), dialects.load("linuxcnc"), "readable"):
            pass


def evaluate() -> None:
    """Read lines with expressions."""
    _read(["#1=1", "G0 X#1"] * MANY_LINES)
    _read(["#<a>=1", "G0 X#<a>"] * MANY_LINES)


def build_simple() -> None:
    """Build a path of a line, an arc and a spiral, and find its travel."""
    spiral = ArcFeed("", 3, "XY", (1.0, 1.0), np.array([1.0, 0.5, 0.0]), 1.0, 0.5, 1.0)
    for path in _path([_line(), _arc(), spiral]):
        bounding_box(path)


def build_nurbs() -> None:
    """Build a path of a NURBS, and chords of it."""
    points = np.array([[1.0, 2.0, 0.0], [2.0, 3.0, 0.0], [3.0, 1.0, 0.0], [4.0, 2.0, 0.0]])
    knots = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0])
    curve = NurbsFeed("", 3, 3, knots, points, np.ones(4), 1.0)
    for path in _path([_line(), _arc(), curve]):
        bounding_box(path)
    weighted = np.column_stack((points, np.ones(4)))
    nurbs_chord_ends(3, knots, weighted, np.array([0.0, 1.0]), 0.01, 0.1)


def fit() -> None:
    """Fit splines to straight moves, between and behind arcs too."""
    mode = PathMode("", 1, "blend", 0.01)
    for blocks in ([mode, _short_moves(), _arc()], [mode, _bends()], [mode, _arc(), _bends()]):
        for _ in path_of(blocks, _machine(), np.array([1.0, 0.0, 0.0])):
            pass


def plan() -> None:
    """Plan two traverses, in slices."""
    for _ in _plans([_traverses()]):
        pass
    _cross()


def plan_corner() -> None:
    """Plan a corner, and seek a stop there, where the motion rests already."""
    corner = [PathMode("", 1, "blend", 0.01), _traverses()]
    for _ in _plans(corner):
        pass
    (legs,) = _path(corner)
    stop_inside(ChainLeft(_at_rest(legs), len(legs), 0), legs, Limits.of(_machine()))


def place_joints() -> None:
    """Write a piece of a path with the columns of joints."""
    ends = np.zeros((1, 3)), np.ones((1, 3))
    metric = np.array([[3.0, 0.0, 1.0, 2.0]])
    one, form = np.ones(1), np.ones((1, ORDER, 3)) * np.linspace(0.0, 1.0, ORDER)[:, None]
    joint_records(JointPieces(np.array([SPAN]), 0.0 * one, one, metric, *ends, form))


def stop() -> None:
    """Come to rest on a curve, and slow there."""
    limits = Limits.of(_machine())
    known_path = KnownPath(limits)
    (path,) = _path([_line(), _arc()])
    end = known_path.add(path, None, None).end
    known = known_path.intervals(limits, 0.0, end)
    plan = plan_to_rest(0.0, known, 0.0, limits)[1][1:]
    shortest_ramp(plan, end, end, FAR, known, limits.arrays)
    ramp_by_clock(plan, known, known, limits.arrays)
    time = float(plan["duration"].sum())
    copy_by_clock(plan, time, known, limits.arrays, 0.5 * pace_wanted(plan, known))
    timed_motion(path.data, 0, np.ones((4, 3)), 1.0, 0.0, 0.0)


def audit() -> None:
    """Audit a motion. It is rejected, because it begins at speed."""
    with suppress(MotionLimitError):
        Audit(Limits.of(_machine())).check(_steady())


def step() -> None:
    """Make reference pulses."""
    interpolator = ReferencePulse([10.0, 10.0, 10.0], np.zeros(3))
    for _ in interpolator.pulses(_steady()):
        pass
    for _ in interpolator.settle():
        pass


def sample() -> None:
    """Make samples."""
    for _ in Sampled(0.1, np.zeros(3)).samples(_steady()):
        pass


def write_lines() -> None:
    """Write lines for a GRBL board."""
    translator, clock = Translator(_machine()), BoardTime(BoardLimits.of_machine(_machine()))
    for line in translator.lines(_steady().path):
        clock.add(line)
    for line in translator.end():
        clock.add(line)
    clock.end()


def cut_stock() -> None:
    """Cut a stock."""
    tool = Assembly(Cutter(FLAT, 1.0, 1.0, 0.0), np.inf, np.inf, 0.0)
    material = Material(Stock(x=(0.0, 4.0), y=(0.0, 4.0), z=(-1.0, 0.0)))
    for path in _path([_traverses()]):
        material.cut(path, np.arange(3), np.zeros(3), tool)


def encode() -> None:
    """Encode grid moves as segments of the stepper board."""
    moves = np.arange(1, 5, dtype=np.int64)
    encoder = SegmentEncoder(len(AXES))
    encoder.push(
        PulseChunk(moves * 100_000, np.ones((4, len(AXES)), np.int8), moves.astype(np.int32))
    )
    for _ in split(encoder.flush()):
        pass


def encode_runs() -> None:
    """Encode steps as runs for a Klipper board."""
    moves = np.arange(1, 5, dtype=np.int64)
    StepEncoder(80).encode(moves * 1600, np.ones(4, np.int8))


def draw() -> None:
    """Draw a motion."""
    picture = Collector(_machine(), Sizes(2, 2, 2), "", np.zeros(len(AXES)))
    picture.add(_steady())
    picture.picture()


def _read(lines: list[str]) -> None:
    for _ in interpret(Text.of_lines(lines, "")):
        pass


def _line() -> Polyline:
    points = np.array([[1.0, 0.0, 0.0]])
    return Polyline("", 1, points, np.array([1.0]), np.array([1], np.int32))


def _short_moves() -> Polyline:
    angle = np.linspace(0.0, 1.0, 41)[1:]
    ends = np.column_stack((np.sin(angle), np.cos(angle) - 1.0, 0.0 * angle))
    return Polyline("", 1, ends, np.full(40, 1.0), np.ones(40, np.int32))


def _bends() -> Polyline:
    """Return moves that go on in the direction of the arc, then turn in ever narrower bends.

    They are few: while a job compiles its kernels, those of the other jobs run as plain Python.
    """
    count = np.arange(50, 140)
    angle = np.pi + np.cumsum(1.5 * np.sin(count**1.5) * (count > 80) + 0.02)
    step = 0.02 * (2.0 + 1.9 * np.sin(1.7 * count))
    ends = np.cumsum(np.column_stack((step * np.cos(angle), step * np.sin(angle), 0.0 * angle)), 0)
    lines = np.full(len(ends), 3, np.int32)
    return Polyline("", 3, ends + [1.0, 2.0, 0.0], np.ones(len(ends)), lines)


def _arc() -> ArcFeed:
    return ArcFeed("", 2, "XY", (1.0, 1.0), np.array([1.0, 2.0, 0.0]), 1.0, 0.5, 1.0)


def _traverses() -> Polyline:
    ends = np.array([[1.0, 0.0, 0.0], [1.0, 1.0, 0.0]])
    return Polyline("", 1, ends, np.full(2, np.nan), np.array([1, 2], np.int32))


def _path(blocks: list[Block]) -> Iterator[PathChunk]:
    for item in build(blocks, axes=AXES, start=np.zeros(3)):
        assert isinstance(item, PathChunk)
        yield item


def _cross() -> None:
    """Cross the limit of two parts of a path."""
    (path,) = _path([_traverses()])
    # The motion does not stop there, as it does at the end of a program.
    before = replace(path, stop_after=np.zeros_like(path.stop_after))
    junction_between(before, path, Limits.of(_machine()))


def _plans(blocks: list[Block]) -> Iterator[object]:
    return LookAhead(_machine(), Control(), slice_s=0.01).plan(_path(blocks))


def _at_rest(path: PathChunk) -> PlanChunk:
    """Return a plan that rests at the start of a path."""
    piece_s = np.concatenate(([0.0], np.cumsum(path.length)))
    rest = np.zeros(2)
    return PlanChunk(path, piece_s, 0.0, 0.0, rest, rest, rest, rest, np.zeros(1))


def _steady() -> PlanChunk:
    """Return a motion along a line and an arc, at a steady speed from the first moment."""
    (path,) = _path([_line(), _arc()])
    piece_s = np.concatenate(([0.0], np.cumsum(path.length)))
    span = np.array([0.0, float(piece_s[-1])])
    return PlanChunk(path, piece_s, 0.0, 0.0, span, span, np.ones(2), np.zeros(2), np.zeros(1))


def _machine() -> Machine:
    axis = Axis(steps_per_mm=10.0, max_velocity=10.0, max_acceleration=100.0, max_jerk=1000.0)
    return Machine(axes=dict.fromkeys(AXES, axis), path=PathLimits(max_feed=10.0))
