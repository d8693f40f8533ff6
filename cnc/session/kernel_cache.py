"""Compilation of the kernels before the first run, in two processes in parallel.

Each process compiles kernels by calling them. One reads text, builds curves, makes pulses, samples
and lines, and audits a plan; the other plans. Compiled code is kept on disk
(:mod:`cnc.kernels.jit`), so each process finds the code of the other. A marker file beside it
records that these kernels are compiled.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress

import numpy as np

from cnc.gcode.program.line_steps import MANY_LINES
from cnc.gcode.program.plain_lines import SHORTEST
from cnc.gcode.program.program import interpret
from cnc.gcode.syntax.source_text import Text
from cnc.grbl_lines.translator import Translator
from cnc.kernels.jit import compiled_mark
from cnc.machine.models import Axis, Machine, PathLimits
from cnc.model.blocks import ArcFeed, AxisLetter, NurbsFeed, PathMode, Polyline
from cnc.model.diagnostics import MotionLimitError
from cnc.model.operator_control import Control
from cnc.path.bounds import bounding_box
from cnc.path.build import build
from cnc.path.chunk import PathChunk
from cnc.planner.audit import Audit
from cnc.planner.limits import Limits
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from cnc.pulses.reference_pulse import ReferencePulse
from cnc.pulses.sampled import Sampled

AXES: tuple[AxisLetter, ...] = ("x", "y", "z")


def ensure_compiled(on_compiling: Callable[[], None] | None) -> None:
    """Compile the kernels unless this computer has them; ``on_compiling`` is called before."""
    mark = compiled_mark()
    if mark is None or mark.exists():
        return
    if on_compiling is not None:
        on_compiling()
    other = subprocess.Popen(
        [sys.executable, "-m", "cnc.session.kernel_cache"],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        compile_language()
        compile_curves()
        if other.wait() == 0:
            with suppress(OSError):
                mark.touch()
    finally:
        # After Ctrl-C the child has no use.
        other.kill()
        other.communicate()


def compile_language() -> None:
    """Compile the kernels of the reader: read a straight move."""
    for _ in interpret(Text.of_lines(["G0 X1"] * SHORTEST, "")):
        pass
    for _ in interpret(Text.of_lines(["#1=1", "G0 X#1"] * MANY_LINES, "")):
        pass


def compile_curves() -> None:
    """Compile the kernels of curves, pulses, samples, lines and the audit.

    One curve of each kind and a fitted one are built, then pulses, samples and lines along each.
    """
    corner, end = np.array([[1.0, 0.0, 0.0]]), np.array([1.0, 2.0, 0.0])
    points = np.array([[1.0, 2.0, 0.0], [2.0, 3.0, 0.0], [3.0, 1.0, 0.0], [4.0, 2.0, 0.0]])
    blocks = [
        PathMode("", 1, "blend", 0.01),
        Polyline("", 1, corner, np.array([1.0]), np.array([1], np.int32)),
        ArcFeed("", 2, "XY", (1.0, 1.0), end, 1.0, 0.5, 1.0),
        NurbsFeed(
            "", 3, 3, np.array([0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0]), points, np.ones(4), 1.0
        ),
    ]
    for path in build(blocks, axes=AXES, start=np.zeros(3)):
        assert isinstance(path, PathChunk)
        bounding_box(path)
        piece_s = np.concatenate(([0.0], np.cumsum(path.length)))
        length = float(piece_s[-1])
        still, steady = np.zeros(2), np.ones(2)
        plan = PlanChunk(
            path,
            piece_s,
            0.0,
            0.0,
            np.array([0.0, length]),
            np.array([0.0, length]),
            steady,
            still,
            np.zeros(1),
        )
        for _ in ReferencePulse([10.0, 10.0, 10.0], np.zeros(3)).pulses(plan):
            pass
        for _ in Sampled(0.1, np.zeros(3)).samples(plan):
            pass
        for _ in Translator(_machine()).lines(plan):
            pass
        with suppress(MotionLimitError):
            # The audit rejects this motion, because it begins at speed.
            Audit(Limits.of(_machine())).check(plan)


def compile_planner() -> None:
    """Compile the kernels of the planner: plan two traverses and a corner blend, in slices."""
    ends = np.array([[1.0, 0.0, 0.0], [1.0, 1.0, 0.0]])
    lines = Polyline("", 1, ends, np.full(2, np.nan), np.array([1, 2], np.int32))
    chunks = build([PathMode("", 1, "blend", 0.01), lines], axes=AXES, start=np.zeros(3))
    for _ in LookAhead(_machine(), Control(), slice_s=0.01).plan(chunks):
        pass


def _machine() -> Machine:
    axis = Axis(steps_per_mm=10.0, max_velocity=10.0, max_acceleration=100.0, max_jerk=1000.0)
    return Machine(axes=dict.fromkeys(AXES, axis), path=PathLimits(max_feed=10.0))


def exit_with_parent() -> None:
    """End this process when its parent has ended, which closes the standard input.

    The file descriptor is read, because the lock of ``sys.stdin`` would block the exit.
    """
    while os.read(0, 1):
        pass
    os._exit(1)


if __name__ == "__main__":
    threading.Thread(target=exit_with_parent, daemon=True).start()
    compile_planner()
