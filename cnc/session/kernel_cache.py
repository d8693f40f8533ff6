"""The first run ever: the kernels are compiled, in two processes at once, before the program is
looked at.

What each half needs is found by using it: one reads text, builds curves, makes pulses, samples and
lines of them and audits, the other plans. Compiled code is kept on disk (:mod:`cnc.kernels.jit`),
where the one process finds what the other made; a file beside it says that this was done for these
kernels.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress

import numpy as np

from cnc.gcode import dialects
from cnc.gcode.program.interpreter import Interpreter
from cnc.gcode.program.plain_lines import StraightLane
from cnc.gcode.syntax.parameters import Parameters
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


def ensure_compiled(tell: Callable[[], None] | None) -> None:
    """Compile the kernels if that has not been done on this machine; ``tell`` is called first if
    so.
    """
    mark = compiled_mark()
    if mark is None or mark.exists():
        return
    if tell is not None:
        tell()
    other = subprocess.Popen(
        [sys.executable, "-m", "cnc.session.kernel_cache"],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        use_language()
        use_curves()
        if other.wait() == 0:
            with suppress(OSError):
                mark.touch()
    finally:
        # A child that is left over, as after Ctrl-C, has nobody to compile for.
        other.kill()
        other.communicate()


def use_language() -> None:
    """Read a straight move."""
    window = Text.of_lines(["G0 X1"], "").window(1)
    assert window is not None
    StraightLane(
        Interpreter("", AXES, dialects.load("auto"), [0.0] * len(AXES), Parameters(), None)
    ).run(window, 0)


def use_curves() -> None:
    """Build one curve of each kind and a fitted one, and make pulses, samples and lines along each;
    audit that motion.
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
            # a motion that begins at speed
            Audit(Limits.of(_machine())).check(plan)


def use_planner() -> None:
    """Plan two traverses, with which nothing is fitted, and cut the corner between them, in slices
    as for an operator.
    """
    ends = np.array([[1.0, 0.0, 0.0], [1.0, 1.0, 0.0]])
    lines = Polyline("", 1, ends, np.full(2, np.nan), np.array([1, 2], np.int32))
    chunks = build([PathMode("", 1, "blend", 0.01), lines], axes=AXES, start=np.zeros(3))
    for _ in LookAhead(_machine(), Control(), slice_s=0.01).plan(chunks):
        pass


def _machine() -> Machine:
    axis = Axis(steps_per_mm=10.0, max_velocity=10.0, max_acceleration=100.0, max_jerk=1000.0)
    return Machine(axes=dict.fromkeys(AXES, axis), path=PathLimits(max_feed=10.0))


def end_with_parent() -> None:
    """End this process as soon as the one that started it is gone, in whatever way: then nobody
    holds the other end of its input.
    """
    # not by sys.stdin, whose lock the other thread would wait for at its end
    while os.read(0, 1):
        pass
    os._exit(1)


if __name__ == "__main__":
    threading.Thread(target=end_with_parent, daemon=True).start()
    use_planner()
