"""Execution of a checked line: motions, arcs, dwells, offsets, probes, homing.

Each generator yields the condition that it waits for.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator
from dataclasses import replace

from cnc.simulators.grbl.core import BUSY, Core, Program, Wait
from cnc.simulators.grbl.firmware_profile import ACCELERATIONS, RATES, TOOL_CHANGE_MODE, TRAVELS
from cnc.simulators.grbl.line_check import PLANES, CheckedLine, Modes
from cnc.simulators.grbl.planner import Move, Point, smallest_over_axes
from cnc.simulators.grbl.report import probe_report

# Arcs as chords whose middle is at most ``$12`` from the circle (settings.md, ``$12``).
#
# Sagitta e of a chord over the angle 2b on radius r: e = r (1 - cos b), so that
# chord^2 = 4 (2 r e - e^2).

FULL_TURN = 2.0 * math.pi
SAME_ANGLE = 5e-7
"""rad between start and end below which the arc is a full circle."""


def chords(
    start: Point,
    end: Point,
    center: tuple[float, float],
    plane: tuple[int, int, int],
    clockwise: bool,
    tolerance: float,
) -> list[Point]:
    """Return the ends of the chords of an arc or helix.

    Args:
        start: Start point, mm.
        end: End point, mm.
        center: Centre from the start along the two axes of the plane, mm.
        plane: First, second and normal axis.
        clockwise: Sense of the arc.
        tolerance: ``$12``, mm.
    """
    first, second, _ = plane
    i, j = center
    radius = math.hypot(i, j)
    middle = (start[first] + i, start[second] + j)
    begin = math.atan2(-j, -i)
    turn = math.atan2(end[second] - middle[1], end[first] - middle[0]) - begin
    if clockwise:
        while turn >= -SAME_ANGLE:
            turn -= FULL_TURN
        while turn < -FULL_TURN - SAME_ANGLE:
            turn += FULL_TURN
    else:
        while turn <= SAME_ANGLE:
            turn += FULL_TURN
        while turn > FULL_TURN + SAME_ANGLE:
            turn -= FULL_TURN
    half = 2.0 * radius * tolerance - tolerance * tolerance
    pieces = int(0.5 * abs(turn) * radius / math.sqrt(half)) if half > 0.0 else 0
    points: list[Point] = []
    for piece in range(1, pieces):
        share = piece / pieces
        point = [a + share * (b - a) for a, b in zip(start, end, strict=True)]
        point[first] = middle[0] + radius * math.cos(begin + share * turn)
        point[second] = middle[1] + radius * math.sin(begin + share * turn)
        points.append(tuple(point))
    points.append(end)
    return points


PLAN_TIME = 0.0021
"""Seconds that an AVR needs to plan a block. With its 30 us for a byte it takes 385 short lines/s.
"""
LEAST_FEED = 1.0 / 60.0
"""mm/s: lowest possible feed."""
IGNORED = 4
"""Tool change mode in which M6 does nothing."""
SEARCH, LOCATE = 1.5, 5.0
"""Homing looks for a switch over 1.5 travels, then over 5 pull-offs (interface.md, ALARM:9)."""


def synchronize(core: Core) -> Program:
    """Wait until all planned motion has ended."""
    core.start_cycle()
    yield Wait(lambda: not core.planner.blocks and not core.steppers.running)


def move_to(
    core: Core, kind: str, target: Point, line: CheckedLine, feed: float, number: int
) -> Program:
    """Put a straight motion into the planner as soon as there is space.

    Args:
        core: The board.
        kind: rapid, feed, jog, probe or home.
        target: Machine position, mm.
        line: The line that it belongs to.
        feed: mm/min, or 1/min for an inverse-time line.
        number: The N word of the line; 0 without.
    """
    if core.setting[20] and kind not in ("jog", "home") and not within_travel(core, target):
        yield from _soft_limit(core)
    if core.state == "Check":
        return
    end = core.on_grid(target)
    if end == core.planned:
        return
    core.work(PLAN_TIME)
    yield BUSY
    if not core.planner.free:
        core.start_cycle()
        yield Wait(lambda: core.planner.free > 0)
    # A cancelled jog may have moved the start meanwhile.
    start = core.planned
    delta = tuple(b - a for a, b in zip(start, end, strict=True))
    length = math.hypot(*delta)
    if length == 0.0:
        return
    core.planned = end
    unit = tuple(part / length for part in delta)
    rapid = smallest_over_axes(core.per_axis(RATES), unit) / 60.0
    programmed = rapid if kind == "rapid" else feed * (length if line.inverse else 1.0) / 60.0
    accelerations = core.per_axis(ACCELERATIONS)
    move = Move(
        kind,
        start,
        end,
        unit,
        length,
        max(smallest_over_axes(accelerations, unit), 1e-6),
        max(rapid, LEAST_FEED),
        max(programmed, LEAST_FEED),
        number,
        core.lines,
        # The beam is off in a traverse.
        (core.spindle_text[:2], 0.0 if core.setting[32] and kind == "rapid" else core.rpm),
    )
    core.planner.add(move, accelerations, core.setting[11])
    core.steppers.replan(core.now)


def within_travel(core: Core, target: Point) -> bool:
    """Return whether a machine position lies within the travel (``$130``..).

    grblHAL limits the axes that home, and keeps the pull-off from switches that are in use.
    """
    hal = core.profile.name == "grblhal"
    off = core.setting[27] if hal and core.setting[21] else 0.0
    places = list(zip(target, core.per_axis(TRAVELS), strict=True))[: 3 if hal else None]
    return all(off - travel <= value <= -off for value, travel in places)


def _soft_limit(core: Core) -> Program:
    """Brake, keep the position, raise the alarm; only a reset ends it."""
    if core.state in ("Run", "Idle") and core.steppers.running:
        core.soft_limit_stop = True
        core.state, core.hold_complete = "Hold", False
        core.steppers.hold(core.now)
        yield Wait(lambda: core.hold_complete)
    core.stop_dead()
    core.alarm(2)
    yield Wait(lambda: False)


def perform(core: Core, line: CheckedLine) -> Program:
    """Carry out a line that has passed the checks, in the order of the language's standard."""
    before, core.modes = core.modes, line.modes
    modes = line.modes
    check = core.state == "Check"
    if line.changes_tool and not check:
        yield from _change_tool(core)
    if not check:
        yield from _outputs(core, line, before, modes)
    if line.dwell is not None and not check:
        yield from _dwell(core, line.dwell)
    if line.length_offset is not None and line.length_offset != core.tool_length:
        yield from synchronize(core)
        core.tool_length, core.wco_counter = line.length_offset, 0
    if modes.coordinates != before.coordinates:
        yield from synchronize(core)
        core.wco_counter = 0
    yield from _act(core, line)
    if line.flow:
        yield from _end_or_pause(core, line.flow, check)


def _change_tool(core: Core) -> Program:
    """Carry out M6: wait for the operator in state Tool. The line is answered at once.

    Source: "Manual tool change protocol" of grblHAL's wiki, and its settings ``$341``.
    """
    if core.setting[TOOL_CHANGE_MODE] == IGNORED:
        return
    yield from synchronize(core)
    core.note("tool", str(core.modes.tool))
    core.state = "Tool"


def _outputs(core: Core, line: CheckedLine, before: Modes, modes: Modes) -> Program:
    """Switch spindle and coolant after the motion before.

    Motion ends for another spindle mode, and for another speed while the spindle is on. In laser
    mode (``$32``) a line with a motion changes the power without that, but a lone S does not
    (settings.md, ``$32``, "Laser Mode").
    """
    in_motion = core.setting[32] and line.action in ("G0", "G1", "G2", "G3")
    if before.spindle != modes.spindle:
        yield from synchronize(core)
        core.set_spindle(modes.spindle, modes.speed)
    elif before.speed != modes.speed and modes.spindle != "M5":
        if not in_motion:
            yield from synchronize(core)
        core.set_spindle(modes.spindle, modes.speed)
    if (before.flood, before.mist) != (modes.flood, modes.mist):
        yield from synchronize(core)
        core.set_coolant(modes.flood, modes.mist)


def _dwell(core: Core, seconds: float) -> Program:
    yield from synchronize(core)
    core.note("dwell", f"{seconds:g}")
    yield Wait(lambda: False, until=core.now + seconds)


def _act(core: Core, line: CheckedLine) -> Program:
    """Carry out the command that uses the axis words, after the values that are stored first."""
    action = line.action
    if line.before == "G92.1":
        yield from synchronize(core)
        core.shift, core.wco_counter = core.origin, 0
    elif line.before:
        yield from write_eeprom(core, lambda: core.eeprom.store(line.before[:3], core.parsed))
    if action in ("G0", "G1"):
        yield from move_to(
            core, "rapid" if action == "G0" else "feed", line.target, line, line.feed, line.number
        )
        core.parsed = line.target
    elif action in ("G2", "G3"):
        yield from _arc(core, line)
        core.parsed = line.target
    elif action.startswith("G38"):
        yield from _probe(core, line)
    elif action in ("G28", "G30"):
        yield from _go_home(core, line)
    elif action == "G10":
        yield from write_eeprom(core, lambda: core.eeprom.store(line.store, line.target))
        core.wco_counter = 0
    elif action == "G92":
        yield from synchronize(core)
        core.shift, core.wco_counter = _shifted(core, line), 0


def _arc(core: Core, line: CheckedLine) -> Program:
    ends = chords(
        core.parsed,
        line.target,
        line.center,
        PLANES[line.modes.plane],
        line.clockwise,
        core.setting[12],
    )
    feed = line.feed * len(ends) if line.inverse else line.feed
    for end in ends:
        yield from move_to(core, "feed", end, line, feed, line.number)


def _go_home(core: Core, line: CheckedLine) -> Program:
    """Carry out G28 or G30: move to the stored position.

    With axis words, move to these first; then only the named axes move to the stored position.
    """
    stored = core.eeprom.systems[line.action]
    if line.axes:
        yield from move_to(core, "rapid", line.target, line, 0.0, line.number)
    end = tuple(
        there if i in line.axes or not line.axes else here
        for i, (there, here) in enumerate(zip(stored, core.parsed, strict=True))
    )
    yield from move_to(core, "rapid", end, line, 0.0, line.number)
    core.parsed = end


def _shifted(core: Core, line: CheckedLine) -> Point:
    """Return the G92 offset with which the tool stands at the words."""
    system, shift = core.eeprom.systems[line.modes.coordinates], list(core.shift)
    for index in line.axes:
        length = core.tool_length if index == 2 else 0.0
        shift[index] = core.parsed[index] - system[index] - length - (line.words[index] or 0.0)
    return tuple(shift)


def _probe(core: Core, line: CheckedLine) -> Program:
    """Carry out G38.2 to G38.5 until the probe touches or lets go (ALARM:4, ALARM:5)."""
    towards, must = line.action in ("G38.2", "G38.3"), line.action in ("G38.2", "G38.4")
    yield from synchronize(core)
    if core.state == "Check":
        core.parsed = line.target
        return
    core.probe_succeeded = False
    if core.environment.touches(core.position) == towards:
        core.alarm(4)
        yield Wait()
        return
    core.probe_wanted = towards
    yield from move_to(core, "probe", line.target, line, line.feed, line.number)
    core.start_cycle()
    yield Wait(lambda: not core.planner.blocks and not core.steppers.running)
    core.probe_wanted = None
    if not core.probe_succeeded and must:
        # the contact position of the probe before stays
        core.alarm(5)
        yield Wait()
    elif not core.probe_succeeded:
        core.probe_position = core.position
    core.sync_position()
    core.say(probe_report(core))
    yield BUSY


def _end_or_pause(core: Core, flow: str, check: bool) -> Program:
    """M0 waits for a cycle start. M1 does nothing. M2 and M30 set modes and outputs back."""
    if flow == "M0":
        yield from synchronize(core)
        if not check:
            core.note("pause")
            core.flags.hold = True
            yield Wait()
    elif flow in ("M2", "M30"):
        yield from synchronize(core)
        modes = core.modes
        core.modes = replace(
            modes,
            motion="G1",
            plane="G17",
            distance="G90",
            feed_mode="G94",
            coordinates="G54",
            spindle="M5",
            flood=False,
            mist=False,
        )
        core.planner.feed_override = core.planner.rapid_override = core.spindle_override = 100
        core.wco_counter = core.override_counter = 0
        if not check:
            core.outputs_on()
        core.note("end", flow)
        core.say("[MSG:Pgm End]")
        yield BUSY


def write_eeprom(core: Core, write: Callable[[], int]) -> Program:
    """Write with all motion at rest; bytes that arrive meanwhile may be lost."""
    yield from synchronize(core)
    written = write()
    if written and core.profile.eeprom_blinds:
        core.note("eeprom", str(written))
        core.cpu_free = core.receiver.blind(written, core.now)
        yield BUSY


def home(core: Core) -> Program:
    """Home Z, X, Y: fast to the switch, off it, slowly to it, off it. ALARM:8, ALARM:9."""
    core.state = "Home"
    line = CheckedLine(Modes())
    for axis in (2, 0, 1):
        sign = -1.0 if int(core.setting[23]) >> axis & 1 else 1.0
        off = core.setting[27]
        for feed, search in (
            (core.setting[25], SEARCH * core.setting[TRAVELS + axis]),
            (core.setting[24], LOCATE * off),
        ):
            if not (yield from _until_switch(core, axis, sign * search, feed, line)):
                yield from _homing_failed(core, 9)
            yield Wait(lambda: False, until=core.now + core.setting[26] / 1000.0)
            yield from _stroke(core, axis, -sign * off, core.setting[25], line, "home")
            yield Wait(lambda: False, until=core.now + core.setting[26] / 1000.0)
            if "XYZ"[axis] in core.environment.tripped(core.position):
                yield from _homing_failed(core, 8)
        here = list(core.position)
        there = -off if sign > 0.0 else off - core.setting[TRAVELS + axis]
        shift = list(core.environment.offset)
        shift[axis] += here[axis] - there
        here[axis] = there
        core.environment.offset = (shift[0], shift[1], shift[2])
        core.steppers.position = tuple(here)
        core.sync_position()
    core.homed = True
    core.state = "Idle"


def _homing_failed(core: Core, code: int) -> Program:
    """Raise an alarm and reset."""
    core.stop_dead()
    core.flags.reset = True
    core.alarm(code)
    yield Wait(lambda: False)


def _until_switch(
    core: Core, axis: int, distance: float, feed: float, line: CheckedLine
) -> Generator[Wait, None, bool]:
    """Move one axis towards its switch, and return whether it was found."""
    yield from _stroke(core, axis, distance, feed, line, "home")
    return "XYZ"[axis] in core.environment.tripped(core.position)


def _stroke(
    core: Core, axis: int, distance: float, feed: float, line: CheckedLine, kind: str
) -> Program:
    """Move one axis by ``distance`` mm while homing."""
    target = list(core.position)
    target[axis] += distance
    core.sync_position()
    yield from move_to(core, kind, tuple(target), line, feed, 0)
    core.steppers.start(core.now)
    yield Wait(lambda: not core.planner.blocks and not core.steppers.running)
    core.sync_position()
