"""Five-axis machines, and their forward kinematics written anew with rotations of scipy."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from cnc.kinematics.five_axis import FiveAxis
from cnc.machine.models import Axis, Board, Machine, PathLimits

TYPES = (
    "xyzac",
    "xyzbc",
    "xyzac-head",
    "xyzbc-head",
    "xyzac-head-table",
    "xyzbc-head-table",
)
TABLE_POINTS = {"tilt_point": (3.0, -7.0, -60.0), "turn_point": (-2.0, 11.0, 4.0)}
HEAD_POINTS = {"tilt_point": (1.0, 0.5, 90.0), "turn_point": (-0.75, 0.25, 120.0)}
MIXED_POINTS = {"tilt_point": (1.0, 0.5, 90.0), "turn_point": (-2.0, 11.0, 4.0)}


def table_of(kind: str, reverse: tuple[str, ...] = ()) -> FiveAxis:
    """Return the kinematics of a type with points off the origin."""
    points = TABLE_POINTS
    if kind.endswith("-head"):
        points = HEAD_POINTS
    elif kind.endswith("-head-table"):
        points = MIXED_POINTS
    return FiveAxis(type=kind, reverse=reverse, **points)


def five_axis_machine(
    kind: str,
    rng: np.random.Generator | None = None,
    *,
    period: float = 1e-3,
    reverse: tuple[str, ...] = (),
) -> Machine:
    """Return a machine of a type; with ``rng`` its limits are random."""
    table = table_of(kind, reverse)

    def axis(speed: float) -> Axis:
        scale = 1.0 if rng is None else 10 ** rng.uniform(-0.7, 0.4)
        return Axis(
            steps_per_mm=200.0,
            max_velocity=speed * scale,
            max_acceleration=15.0 * speed * scale,
            max_jerk=300.0 * speed * scale,
        )

    axes = {letter: axis(250.0) for letter in ("x", "y", "z")}
    axes |= {letter: axis(120.0) for letter in (table.tilting, "c")}
    path = PathLimits(max_feed=300.0, tolerance=0.02, period=period)
    return Machine(
        name=kind, kinematics=table, axes=axes, path=path, board=Board(max_step_rate=1e9)
    )


def tip_of(
    kind: str, joints: np.ndarray, offset: np.ndarray, reverse: tuple[str, ...] = ()
) -> np.ndarray:
    """Return the tip (m, 3) on the part of joints (m, 5), plus the offset of the tool."""
    table = table_of(kind, reverse)
    tilt_sign, turn_sign = (-1.0 if letter in reverse else 1.0 for letter in (table.tilting, "c"))
    tilt_axis = "x" if table.tilting == "a" else "y"
    tilt = Rotation.from_euler(tilt_axis, tilt_sign * joints[:, 3:4], degrees=True)
    turn = Rotation.from_euler("z", turn_sign * joints[:, 4:5], degrees=True)
    c, q = np.array(table.tilt_point), np.array(table.turn_point)
    gauge, tool = joints[:, :3], np.broadcast_to(-offset, (len(joints), 3))
    if "head" in kind:
        tool = tilt.apply(tool - c) + c
    if kind.endswith("-head"):
        return gauge + turn.apply(tool - q) + q + offset
    point = gauge + tool
    if "head" not in kind:
        point = tilt.apply(point - c) + c
    return turn.apply(point - q) + q + offset
