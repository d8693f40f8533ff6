"""Jog of a pulse board: one straight plan to an end point, which a hold ends earlier.

    start ──────────────────────┐ hold
      plan at the limits         └─ the plan comes to rest on the path; the jog ends here

The plan keeps the limits of velocity, acceleration and jerk, as that of a program does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from cnc.boards.protocols import PulseSink
from cnc.executor.run import Outcome, Progress, execute
from cnc.machine.models import Machine
from cnc.model.blocks import Block, Held, Polyline
from cnc.model.operator_control import Control
from cnc.path.build import build
from cnc.planner.joints import Joints
from cnc.planner.lookahead import LookAhead
from cnc.planner.plan import PlanChunk
from cnc.planner.window import SLICE
from cnc.pulses.reference_pulse import ReferencePulse

FILE = "jog"
"""The file name of a jog's block, which belongs to no program."""


def jog(
    board: PulseSink,
    machine: Machine,
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    feed: float,
    *,
    control: Control,
    on_progress: Callable[[Progress], None] | None = None,
) -> Outcome:
    """Move in a straight line, until the end point or until ``control`` holds.

    Args:
        board: The board, idle.
        machine: The machine.
        start: Present position (axes,), mm.
        end: End point (axes,), mm.
        feed: Speed, mm/s.
        control: Its hold or its stop brings the motion to rest, and ends the jog.
        on_progress: Called with the progress.

    Returns:
        The outcome, with the position of the board at rest.

    Raises:
        BoardError: The board failed.
        MotionLimitError: The plan breaks a limit.
    """
    joints = Joints(machine)
    fastest = min(machine.board.max_step_rate, board.capabilities.max_step_rate)
    planner = LookAhead(machine, control, slice_s=board.capabilities.slice_s or SLICE)
    block = Polyline(FILE, 0, end[None, :], np.array([feed]), np.zeros(1, np.int32))
    line = build([block], axes=machine.axis_names, start=start)
    path = joints.path(line, start, certain=False)
    pulses = ReferencePulse(
        joints.machine.steps_per_mm,
        joints.at(start),
        1e9 / fastest,
        tip_columns=joints.tip_columns,
        algorithm="crossings" if board.capabilities.separate_axes else None,
        separate_axes=board.capabilities.separate_axes,
    )
    # A jog that has failed by here leaves nothing behind for the next motion.
    if (known := board.known_steps) is not None and board.capabilities.limit_switches:
        # Without homing the machine counts from the assumed start, as in a program.
        board.prepare_next_start(
            watched=[not closed for closed in board.switches],
            known=[steps is not None or not machine.can_home for steps in known],
        )
    # A joint may be faster than the tool.
    board.prepare_jog(math.inf if machine.kinematics.joints else feed)
    return execute(
        _until_held(planner.plan(path)),
        board,
        pulses,
        control=control,
        on_progress=on_progress,
        ramp_down=planner.ramp_down,
    )


def _until_held(planned: Iterable[PlanChunk | Block]) -> Iterator[PlanChunk | Block]:
    """Yield a plan until it rests in a hold."""
    for item in planned:
        if isinstance(item, Held):
            return
        yield item
