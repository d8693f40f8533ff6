"""Reports of the board: status, parser state, parameters, settings, build info."""

from __future__ import annotations

from cnc.model.units import MM_PER_INCH
from cnc.simulators.grbl.core import SYSTEMS, Core, setting_text
from cnc.simulators.grbl.planner import Point

MOVING = ("Run", "Hold", "Jog", "Home", "Door")
OFFSET_REFRESH = {True: 30, False: 10}
OVERRIDE_REFRESH = {True: 20, False: 10}
"""Reports from one WCO (Ov) field to the next, with and without motion."""
NAMES = {
    0: ("Step pulse time", "microseconds"),
    11: ("Junction deviation", "millimeters"),
    12: ("Arc tolerance", "millimeters"),
    22: ("Homing cycle", ""),
    30: ("Maximum spindle speed", "RPM"),
    110: ("X-axis maximum rate", "mm/min"),
    341: ("Tool change mode", ""),
    376: ("Rotary axes", ""),
}
"""Name and unit of some settings, as grblHAL prints them."""
HELP = "[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]"


def status_report(core: Core) -> str:
    """Return the answer to ``?``, with the fields that come at intervals."""
    position, speed = core.steppers.state(core.now)
    wanted = int(core.setting[10])
    offset = core.offset
    if wanted & 1:
        fields = [_state(core), f"MPos:{_lengths(core, position)}"]
    else:
        fields = [_state(core), f"WPos:{_lengths(core, _minus(position, offset))}"]
    if wanted & 2:
        fields.append(
            f"Bf:{core.planner.free},{core.profile.rx_capacity - len(core.receiver.ring)}"
        )
    blocks = core.planner.blocks
    if core.profile.line_numbers and blocks and blocks[0].number and blocks[0].kind != "jog":
        fields.append(f"Ln:{blocks[0].number}")
    rate = speed * 60.0 / (MM_PER_INCH if core.setting[13] else 1.0)
    feed = f"{rate:.1f}" if core.setting[13] else f"{rate:.0f}"
    measured = f",{core.rpm:.0f}" if core.profile.measured_speed else ""
    fields.append(
        f"FS:{feed},{core.rpm:.0f}{measured}" if core.profile.variable_spindle else f"F:{feed}"
    )
    pins = _pins(core, position)
    if pins:
        fields.append(f"Pn:{pins}")
    moving = core.state in MOVING
    if core.wco_counter > 0:
        core.wco_counter -= 1
    else:
        core.wco_counter = OFFSET_REFRESH[moving] - 1
        core.override_counter = max(core.override_counter, 1)
        fields.append(f"WCO:{_lengths(core, offset)}")
    if core.override_counter > 0:
        core.override_counter -= 1
    else:
        core.override_counter = OVERRIDE_REFRESH[moving] - 1
        fields.append(
            f"Ov:{core.planner.feed_override},{core.planner.rapid_override},{core.spindle_override}"
        )
        accessories = _accessories(core)
        if accessories:
            fields.append(f"A:{accessories}")
    return f"<{'|'.join(fields)}>"


def _state(core: Core) -> str:
    """Return the state with its sub-state."""
    if core.state == "Hold":
        return "Hold:0" if core.hold_complete else "Hold:1"
    if core.state == "Door":
        if core.resuming:
            return "Door:3"
        if not core.hold_complete:
            return "Door:2"
        return "Door:1" if core.environment.door_open else "Door:0"
    return core.state


def _pins(core: Core, position: Point) -> str:
    """Return the active inputs; limit switches are wired where hard limits or homing are on."""
    limits = core.environment.tripped(position) if core.setting[21] or core.setting[22] else ""
    environment = core.environment
    doors = "D" * environment.door_open + "E" * environment.stop_pressed
    return "P" * environment.touches(position) + limits + doors


def _accessories(core: Core) -> str:
    spindle = {"M3": "S", "M4": "C"}.get(core.spindle_text[:2], "")
    return spindle + "F" * ("M8" in core.coolant_text) + "M" * ("M7" in core.coolant_text)


def parser_state(core: Core) -> str:
    """Return the answer to ``$G``."""
    modes = core.modes
    coolant = " ".join(word for word, on in (("M7", modes.mist), ("M8", modes.flood)) if on) or "M9"
    # All reported numbers follow $13 (settings.md); FluidNC leaves the feed in mm.
    inches = bool(core.setting[13])
    feed = modes.feed / (MM_PER_INCH if inches and core.profile.name != "fluidnc" else 1.0)
    words = f"{modes.motion} {modes.coordinates} {modes.plane} {modes.units} {modes.distance}"
    values = f"T{modes.tool} F{feed:.{1 if inches else 0}f} S{modes.speed:.0f}"
    return f"[GC:{words} {modes.feed_mode} {modes.spindle} {coolant} {values}]"


def parameters(core: Core) -> list[str]:
    """Return the answer to ``$#``."""
    lines = [f"[{name}:{_lengths(core, core.eeprom.systems[name])}]" for name in SYSTEMS]
    lines.append(f"[G92:{_lengths(core, core.shift)}]")
    lines.append(f"[TLO:{_length(core, core.tool_length)}]")
    lines.append(probe_report(core))
    return lines


def probe_report(core: Core) -> str:
    """Return the position of the last probe contact, and whether there was one."""
    return f"[PRB:{_lengths(core, core.probe_position)}:{int(core.probe_succeeded)}]"


def settings_list(core: Core) -> list[str]:
    """Return the answer to ``$$``."""
    return [setting_text(number, value) for number, value in core.setting.items()]


def enumerated_settings(core: Core) -> list[str]:
    """Return grblHAL's answer to ``$ES``: number, group, name, unit, type, format, limits."""
    return [
        f"[SETTING:{number}|0|{NAMES[number][0]}|{NAMES[number][1]}|6|##0.000|||0|0]"
        for number in core.setting
        if number in NAMES
    ]


def startup_lines(core: Core) -> list[str]:
    """Return the answer to ``$N``."""
    return [f"$N{index}={text}" for index, text in enumerate(core.eeprom.startup)]


def build_info(core: Core) -> list[str]:
    """Return the answer to ``$I``."""
    return extended_info(core)[: 2 if core.profile.short_info else None]


def extended_info(core: Core) -> list[str]:
    """Return the answer to ``$I+``: version, options with the sizes of both buffers, more lines."""
    profile = core.profile
    sizes = f",{profile.planner_blocks},{profile.rx_reported}" if profile.sizes_reported else ""
    more = f",{len(profile.axes)},0" if profile.name == "grblhal" else ""
    return [
        f"[VER:{profile.version}:{core.eeprom.build_info}]",
        f"[OPT:{profile.options}{sizes}{more}]",
        *profile.build_lines,
    ]


def _length(core: Core, value: float) -> str:
    return f"{value / MM_PER_INCH:.4f}" if core.setting[13] else f"{value:.3f}"


def _lengths(core: Core, point: Point) -> str:
    """Return the values of the axes; rotary ones are in degrees in any case."""
    return ",".join(
        f"{value:.3f}" if axis in core.rotary else _length(core, value)
        for axis, value in enumerate(point)
    )


def _minus(a: Point, b: Point) -> Point:
    return tuple(x - y for x, y in zip(a, b, strict=True))
