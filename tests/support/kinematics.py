"""Machines with joints, and the geometry of each written anew: rods, elbows."""

from __future__ import annotations

import numpy as np

from cnc.kinematics.delta import Delta, RotaryDelta
from cnc.kinematics.planar import CoreXY, CoreXZ, Polar, Scara
from cnc.machine.kinematics import KinematicsTable
from cnc.machine.models import Axis, Board, Machine, PathLimits

TABLES: dict[str, KinematicsTable] = {
    "corexy": CoreXY(type="corexy"),
    "corexz": CoreXZ(type="corexz"),
    "polar": Polar(type="polar"),
    "scara": Scara(type="scara", arms=(140.0, 120.0)),
    "scara-right": Scara(type="scara", arms=(140.0, 120.0), elbow="right"),
    "delta": Delta(type="delta", radius=150.0, rod=310.0),
    "rotary-delta": RotaryDelta(
        type="rotary-delta", base=120.0, platform=40.0, arm=110.0, rod=260.0
    ),
}
MIDDLE = {
    "corexy": (30.0, 20.0, 0.0),
    "corexz": (30.0, 20.0, 5.0),
    "polar": (60.0, 45.0, 0.0),
    "scara": (110.0, 70.0, 0.0),
    "scara-right": (110.0, 70.0, 0.0),
    "delta": (10.0, -15.0, -40.0),
    "rotary-delta": (5.0, -10.0, -230.0),
}
"""A tip in the middle of the reach of each machine, mm; 30 mm about it are in reach."""
COUNTER_CLOCKWISE = np.exp(1j * np.radians([210.0, 330.0, 90.0]))


def misfit(name: str, joints: np.ndarray, tip: np.ndarray) -> float:
    """Return by how much joints (m, joints) and tip (m, 3) do not fit together, mm."""
    table = TABLES[name]
    a, b = joints.T[:2]
    x, y, z = tip.T
    place = x + 1j * y
    if isinstance(table, CoreXZ):
        off = [a - (x + z), b - (x - z)]
    elif isinstance(table, CoreXY):
        off = [a - (x + y), b - (x - y)]
    elif isinstance(table, Polar):
        off = [np.abs(a * np.exp(1j * np.radians(b)) - place)]
    elif isinstance(table, Scara):
        first, second = table.arms
        elbow = first * np.exp(1j * np.radians(a))
        off = [np.abs(elbow + second * np.exp(1j * np.radians(a + b)) - place)]
        side = 1.0 if table.elbow == "left" else -1.0
        off.append(np.where(side * ((place / elbow).imag) > 0.0, 0.0, np.inf))
    elif isinstance(table, Delta):
        towers = table.radius * COUNTER_CLOCKWISE
        off = [
            np.hypot(np.abs(place - tower), height - z) - table.rod
            for tower, height in zip(towers, joints.T, strict=True)
        ]
        off.append(np.where(joints.min(axis=1) > z, 0.0, np.inf))
    else:
        assert isinstance(table, RotaryDelta)
        off = []
        for direction, angle in zip(COUNTER_CLOCKWISE, np.radians(joints.T), strict=True):
            elbow = direction * (table.base + table.arm * np.cos(angle))
            end = place + table.platform * direction
            off.append(np.hypot(np.abs(end - elbow), z + table.arm * np.sin(angle)) - table.rod)
    return float(np.max(np.abs(off)))


def machine_of(
    name: str, rng: np.random.Generator | None = None, *, period: float = 1e-3
) -> Machine:
    """Return a machine with this kinematics; with ``rng`` its limits are random."""
    table = TABLES[name]

    def joint() -> Axis:
        scale = 1.0 if rng is None else 10 ** rng.uniform(-1.0, 0.5)
        return Axis(
            steps_per_mm=100.0,
            max_velocity=200.0 * scale,
            max_acceleration=3000.0 * scale,
            max_jerk=60_000.0 * scale,
        )

    axes = {letter: joint() for letter in ("x", "y", "z")}
    joints = {joint_name: joint() for joint_name in table.joints}
    # The nearest position to zero is where programs begin: not at a singular pose.
    if isinstance(table, Polar):
        axes["y"] = axes["y"].model_copy(update={"travel": (0.5, 500.0)})
    elif isinstance(table, Scara):
        bent = (30.0, 170.0) if table.elbow == "left" else (-170.0, -30.0)
        joints["b"] = joints["b"].model_copy(update={"travel": bent})
    path = PathLimits(max_feed=300.0, tolerance=0.02, period=period)
    board = Board(max_step_rate=1e9)
    return Machine(name=name, kinematics=table, axes=axes, joints=joints, path=path, board=board)
