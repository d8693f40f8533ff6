"""Nuts with backlash between two motions: their motors push them up.

A board counts the steps of a motor, not the side of its nut. So each motion ends with the take-up
of the nuts that are pushed down: their motors move up by the backlash, and the tool rests. Then a
count alone says where the tool is, to the next program, to the display, and after a new start.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cnc.boards.protocols import PulseSink
from cnc.machine.models import Machine
from cnc.model.blocks import Polyline
from cnc.model.diagnostics import BoardError
from cnc.planner.joints import Joints
from cnc.planner.lookahead import LookAhead
from cnc.pulses.reference_pulse import ReferencePulse
from cnc.session.pipeline import path_of
from cnc.session.run_pulses import Outcome, execute

FILE = "backlash"
"""The file name of the take-up, which belongs to no program."""
PUSHED_UP = 1.0 - 1e-6
"""Side of a nut that counts as pushed up."""


def push_nuts_up(
    board: PulseSink, machine: Machine, joints: Joints, pulses: ReferencePulse, outcome: Outcome
) -> Outcome:
    """Let the motors push all nuts up, after a motion that has come to rest.

    Args:
        board: The board, idle or stopped.
        machine: The machine.
        joints: Its joints.
        pulses: The interpolator of the motion.
        outcome: Of the motion.

    Returns:
        The outcome with the steps and the position of the take-up. A board that takes no more
        motion after a stop has lost its position; its nuts stay.

    Raises:
        BoardError: The board failed.
    """
    end = pulses.end
    if not joints.has_play or end is None:
        return outcome
    sides = joints.sides_at(end)
    scale = joints.machine.steps_per_mm
    here = board.position_steps / scale
    target = joints.at(joints.tip_on(here, sides))
    moved = np.rint(target * scale) != board.position_steps
    for column, side in sides.items():
        moved[column] &= side < PUSHED_UP
    if not moved.any():
        return outcome
    if not outcome.finished:
        try:
            board.revive()
        except BoardError:
            return outcome
    counted = board.known_steps
    if counted is not None and board.capabilities.limit_switches:
        board.prepare_next_start(
            watched=[not closed for closed in board.switches],
            known=[steps is not None or not machine.can_home for steps in counted],
        )
    fastest = min(machine.board.max_step_rate, board.capabilities.max_step_rate)
    target = np.where(moved, target, here)
    block = Polyline(FILE, 0, target[None], np.array([np.nan]), np.zeros(1, np.int32))
    planner = LookAhead(joints.machine)
    separate = board.capabilities.separate_axes
    made = execute(
        planner.plan(path_of([block], joints.machine, here)),
        board,
        ReferencePulse(
            scale,
            here,
            1e9 / fastest,
            algorithm="crossings" if separate else None,
            separate_axes=separate,
        ),
        ramp_down=planner.ramp_down,
    )
    return replace(outcome, position_steps=made.position_steps, steps=outcome.steps + made.steps)
