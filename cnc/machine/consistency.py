"""Contradictions between keys of a machine file, which each table alone does not show."""

from __future__ import annotations

from collections.abc import Iterator

from cnc.kinematics.five_axis import FiveAxis
from cnc.machine.models import Axis, Homing, Machine, switch_end
from cnc.machine.motors import gantry_inconsistencies
from cnc.model.blocks import ROTARY_LETTERS, AxisLetter
from cnc.model.section import Inconsistency

RATE_ROUNDING = 1e-12
"""Relative rounding error that the product of a speed and a resolution may have."""


def inconsistencies(machine: Machine) -> Iterator[Inconsistency]:
    """Yield the contradictions between keys; none for a machine that can run."""
    yield from _joint_names(machine)
    yield from _start(machine)
    for table, name, joint in _motors(machine):
        yield from _axis_limits(machine, table, name, joint)
        pull_off = (joint.homing or Homing()).pull_off
        towards = switch_end(name, joint.homing)
        yield from gantry_inconsistencies((table, name), joint.motors, towards * pull_off)
    if machine.diameters is not None and machine.kind != "lathe":
        yield Inconsistency(
            ("machine", "diameters"), f"the machine is a {machine.kind}", "remove the key"
        )
    for letter, axis in machine.axes.items():
        yield from _homing_position(machine, letter)
        if axis.wrap is not None and letter not in ROTARY_LETTERS:
            yield Inconsistency(
                ("axes", letter, "wrap"), f"{letter} is not a rotary axis", "remove the key"
            )
    for letter in (machine.homing.order or ()) if machine.homing is not None else ():
        if letter not in machine.axes:
            yield Inconsistency(
                ("homing", "order"),
                f"the machine has no axis {letter}",
                f"its axes are {', '.join(machine.axes)}",
            )
    if machine.board.klipper is not None:
        motors = {name: len(joint.motors) for name, joint in machine.joint_tables.items()}
        yield from machine.board.klipper.inconsistencies(motors)
    elif machine.board.kind == "klipper":
        yield Inconsistency(
            ("board", "kind"),
            "a Klipper board needs the pins of its motors",
            "write the tables [board.klipper.x], ...; cncrun boards lists the pins of a board",
        )
    if machine.stock is not None and not {"x", "y", "z"} <= machine.axes.keys():
        yield Inconsistency(
            ("stock",),
            "the machine does not have the axes x, y and z",
            "remove the table",
        )


def _motors(machine: Machine) -> Iterator[tuple[str, str, Axis]]:
    """Yield table, name and limits of each joint."""
    for name, joint in machine.joint_tables.items():
        yield "joints" if name in machine.kinematics.joints else "axes", name, joint


def _joint_names(machine: Machine) -> Iterator[Inconsistency]:
    """Compare the tables of the joints, and the axes, with those of the kinematics."""
    wanted, kind = machine.kinematics.joints, machine.kinematics.type
    hint = f"the joints of {kind} are {', '.join(wanted)}" if wanted else f"{kind} has none"
    moved = machine.kinematics.axes
    if isinstance(machine.kinematics, FiveAxis):
        moved = machine.kinematics.tip_axes
        for reversed_axis in machine.kinematics.reverse:
            if reversed_axis not in moved:
                message = f"{kind} has no axis {reversed_axis}"
                yield Inconsistency(("kinematics", "reverse"), message, "remove it")
    for letter in moved:
        if letter not in machine.axes:
            message = f"{kind} moves the axis {letter}, which the machine does not have"
            yield Inconsistency(("kinematics", "type"), message, f"add [axes.{letter}]")
    for name in machine.joints:
        if name not in wanted:
            yield Inconsistency(("joints", name), "there is no such joint", hint)
    for name in wanted:
        if name not in machine.joints:
            yield Inconsistency(("kinematics", "type"), f"[joints.{name}] is missing", hint)
        if name in machine.axes and name not in machine.kinematics.axes:
            message = f"the kinematics has a joint {name}, too"
            yield Inconsistency(("axes", name), message, "choose another kinematics or axis")


def _start(machine: Machine) -> Iterator[Inconsistency]:
    """Compare the start with the axes and joints, and with their travel."""
    tables = machine.axes | machine.joint_tables
    moved = [name for name in machine.start if name in machine.kinematics.axes]
    joints = [name for name in machine.start if name in machine.kinematics.joints]
    for name, place in machine.start.items():
        key = ("machine", "start", name)
        if name not in tables:
            hint = f"there are {', '.join(tables)}"
            yield Inconsistency(key, "there is no such axis or joint", hint)
            continue
        travel = tables[name].travel
        if travel is not None and not travel[0] <= place <= travel[1]:
            message = f"{place:g} is outside the travel, {travel[0]:g} to {travel[1]:g}"
            yield Inconsistency(key, message, "give a place within the travel")
    if moved and joints:
        message = f"the joints {', '.join(joints)} move {', '.join(moved)}"
        hint = "give places of the axes or of the joints, not of both"
        yield Inconsistency(("machine", "start"), message, hint)


def _axis_limits(machine: Machine, table: str, letter: str, axis: Axis) -> Iterator[Inconsistency]:
    most = machine.board.max_step_rate
    if axis.step_rate > most * (1 + RATE_ROUNDING):
        yield Inconsistency(
            (table, letter, "max_velocity"),
            f"{axis.max_velocity:g} mm/s at {axis.steps_per_mm:g} steps/mm is "
            f"{axis.step_rate:.7g} steps/s, but board.max_step_rate is {most:.7g}",
            f"lower it to {most / axis.steps_per_mm:g}, "
            "or raise board.max_step_rate if the board supports it",
        )
    path = machine.path
    if axis.max_acceleration is None and (
        path.max_tangential_acceleration is None or path.max_normal_acceleration is None
    ):
        yield Inconsistency(
            (table, letter, "max_acceleration"),
            "nothing limits the acceleration of this axis",
            f"set {table}.{letter}.max_acceleration, "
            "or path.max_tangential_acceleration and path.max_normal_acceleration",
        )
    if axis.max_jerk is None and path.max_jerk is None:
        yield Inconsistency(
            (table, letter, "max_jerk"),
            "nothing limits the jerk of this axis",
            f"set {table}.{letter}.max_jerk, or path.max_jerk",
        )


def _homing_position(machine: Machine, letter: AxisLetter) -> Iterator[Inconsistency]:
    axis = machine.axes[letter]
    position = None if axis.homing is None else axis.homing.position
    if position is None or axis.travel is None:
        return
    if not axis.travel[0] <= position <= axis.travel[1]:
        yield Inconsistency(
            ("axes", letter, "homing", "position"),
            f"{position:g} is outside the travel, {axis.travel[0]:g} to {axis.travel[1]:g} mm",
            f"give a coordinate within axes.{letter}.travel",
        )
