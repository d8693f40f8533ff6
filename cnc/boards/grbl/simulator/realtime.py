"""Real-time commands (commands.md, "Realtime commands").

Each is noted as its byte arrives, and carried out when the main program next serves them.

Idle --queued motion--> Run --!--> Hold:1 --at rest--> Hold:0 --~--> Run or Idle
any of these --0x84--> Door:2 --at rest--> Door:0 (Door:1 while the door is open)
Door:0 --~--> Door:3 --> Run or Idle
Idle --M6 (grblHAL)--> Tool --~--> Idle
Jog --! or 0x85--> at rest, the queue dropped --> Idle
"""

from __future__ import annotations

from cnc.boards.grbl.simulator.core import CRITICAL, Core
from cnc.boards.grbl.simulator.report import parser_state, status_report

RESET = 0x18
PRINTABLE = {ord("?"): "status", ord("~"): "start", ord("!"): "hold"}
EXTENDED = {0x84: "door", 0x85: "jog_cancel"}
HAL = {0x80: "status", 0x81: "start", 0x82: "hold", 0x87: "status"}
"""grblHAL's second set, for hosts that do not send printable characters."""
MODES_TOO = 512
FEED = {0x90: 0, 0x91: 10, 0x92: -10, 0x93: 1, 0x94: -1}
RAPID = {0x95: 100, 0x96: 50, 0x97: 25}
SPINDLE = {0x99: 0, 0x9A: 10, 0x9B: -10, 0x9C: 1, 0x9D: -1}
SPINDLE_STOP, FLOOD, MIST = 0x9E, 0xA0, 0xA1
LEAST, LARGEST = 10, 200
"""Per cent of a feed or spindle override."""
SPINDLE_DELAY, COOLANT_DELAY = 4.0, 1.0
"""Seconds for spindle and coolant before motion resumes after a door or a spindle stop."""


def is_realtime(core: Core, byte: int) -> bool:
    """Return whether a byte is taken out of the stream: the printable ones, and all above ASCII."""
    if byte in PRINTABLE:
        return core.profile.printable_anywhere or not core.commanding
    return byte == RESET or byte >= 0x80


def receive(core: Core, byte: int) -> None:
    """Note a real-time command; a reset stops the machine at once."""
    flags = core.flags
    if byte == RESET:
        reset(core)
        return
    name = (
        PRINTABLE.get(byte)
        or EXTENDED.get(byte)
        or (HAL.get(byte) if core.profile.name == "grblhal" else None)
    )
    if name == "jog_cancel":
        _note_jog_cancel(core)
    elif name is not None:
        setattr(flags, name, True)
    elif byte in FEED or byte in RAPID or byte in SPINDLE or byte in (SPINDLE_STOP, FLOOD, MIST):
        flags.overrides.append(byte)


def _note_jog_cancel(core: Core) -> None:
    """Note a jog cancel.

    GRBL ignores one that arrives before the jog has begun. grblHAL drops the bytes that it has not
    read, so that their lines get no answer.
    """
    if core.profile.jog_cancel_flushes:
        core.receiver.ring.clear()
        core.flushed = core.flags.jog_cancel = True
    elif core.state == "Jog":
        core.flags.jog_cancel = True


def reset(core: Core) -> None:
    """Switch outputs off and stop motion, with an alarm if there was motion (0x18)."""
    if core.flags.reset or core.environment.stop_pressed:
        return
    core.flags.reset = True
    core.note("reset", core.state)
    if core.steppers.running or core.state == "Home":
        core.alarm(6 if core.state == "Home" else 3)
    core.stop_dead()


def serve(core: Core) -> None:
    """Carry out the commands that have been noted."""
    flags = core.flags
    if flags.alarm:
        code, flags.alarm = flags.alarm, 0
        core.state = "Alarm"
        core.note("alarm", str(code))
        core.say(f"ALARM:{code}")
        core.locking = code in CRITICAL or code == core.profile.estop_alarm
        core.work(core.profile.alarm_s)
        if core.now < core.cpu_free:
            return
    if core.locking:
        # a reset that came while the alarm was printed is ignored
        core.say("[MSG:Reset to continue]")
        core.locking, core.locked, flags.reset = False, True, False
        return
    if core.locked:
        flags.status = False
        if not flags.reset:
            return
        core.locked = False
    if flags.reset:
        core.aborted = True
        return
    if core.state == "Home":
        _serve_homing(core)
        return
    if flags.status:
        flags.status = False
        core.say(status_report(core))
        _push_modes(core)
    # A hold that arrives together with a cycle start prevails.
    core.flags.start &= not (core.flags.hold or core.flags.jog_cancel or core.flags.door)
    _serve_holds(core)
    _serve_start(core)
    for byte in flags.overrides:
        _override(core, byte)
    flags.overrides.clear()


def _push_modes(core: Core) -> None:
    """Report the modes behind a status report if they have changed (bit 9 of grblHAL's ``$10``)."""
    if core.profile.name == "grblhal" and int(core.setting[10]) & MODES_TOO:
        modes = parser_state(core)
        if modes != core.pushed_modes:
            core.pushed_modes = modes
            core.say(modes)


def _serve_homing(core: Core) -> None:
    """Serve the door, and on FluidNC a status report: there is nothing else during homing."""
    if core.flags.status and core.profile.reports_homing:
        core.flags.status = False
        core.say(status_report(core))
    if core.flags.door:
        core.flags.door = False
        core.stop_dead()
        core.flags.reset = True
        core.alarm(7)
        serve(core)


def _serve_holds(core: Core) -> None:
    """Serve hold, jog cancel, door and sleep."""
    flags, state = core.flags, core.state
    if flags.hold or flags.jog_cancel:
        jogging = state == "Jog" and not core.jog_cancelling
        if jogging:
            _cancel_jog(core)
        elif flags.hold and state in ("Idle", "Run"):
            core.state = "Hold"
            core.note("hold")
            core.hold_complete = not core.steppers.running
            core.steppers.hold(core.now)
        flags.hold = flags.jog_cancel = False
    if flags.door:
        flags.door = False
        if state not in ("Alarm", "Check", "Sleep"):
            _open_door(core)
    if flags.sleep:
        flags.sleep = False
        core.outputs_off()
        core.state = "Sleep"
        core.say("[MSG:Sleeping]")


def _cancel_jog(core: Core) -> None:
    """Brake, then drop the queue."""
    core.note("hold")
    if core.steppers.running:
        core.jog_cancelling = True
        core.steppers.hold(core.now)


def _open_door(core: Core) -> None:
    """Serve the safety door: as a hold, with the outputs off at rest."""
    core.say("[MSG:Check Door]")
    core.note("door")
    if core.state == "Jog":
        _cancel_jog(core)
    core.state = "Door"
    core.resuming = False
    core.hold_complete = not core.steppers.running
    core.steppers.hold(core.now)
    if core.hold_complete:
        core.outputs_off()


def _serve_start(core: Core) -> None:
    """Serve cycle start and resume."""
    if not core.flags.start:
        return
    core.flags.start = False
    if core.state == "Idle":
        core.start_cycle()
    elif core.state == "Tool":
        core.note("resume")
        core.state = "Idle"
    elif core.state == "Hold" and core.hold_complete and not core.resuming:
        if core.spindle_stopped:
            core.spindle_stopped = False
            core.outputs_on()
            core.resuming = True
            core.at(core.now + SPINDLE_DELAY, lambda: _resume(core))
        else:
            _resume(core)
    elif (
        core.state == "Door"
        and core.hold_complete
        and not core.resuming
        and not core.environment.door_open
    ):
        core.spindle_stopped = False
        modes = core.modes
        delay = (SPINDLE_DELAY if modes.spindle != "M5" else 0.0) + (
            COOLANT_DELAY if modes.flood or modes.mist else 0.0
        )
        core.outputs_on()
        core.resuming = True
        core.at(core.now + delay, lambda: _resume(core))


def _resume(core: Core) -> None:
    """Resume after a hold."""
    core.note("resume")
    core.resuming = core.hold_complete = False
    core.steppers.holding = False
    core.state = "Idle"
    if core.planner.blocks:
        core.state = "Run"
        core.steppers.resume(core.now)


def _override(core: Core, byte: int) -> None:
    """Serve overrides of feed, rapid and spindle, and toggles of spindle and coolants."""
    planner = core.planner
    before = (planner.feed_override, planner.rapid_override, core.spindle_override)
    if byte in FEED:
        planner.feed_override = _scaled(planner.feed_override, FEED[byte])
    elif byte in RAPID:
        planner.rapid_override = RAPID[byte]
    elif byte in SPINDLE:
        core.spindle_override = _scaled(core.spindle_override, SPINDLE[byte])
        if core.spindle_text[:2] != "M5":
            core.set_spindle(core.modes.spindle, core.modes.speed)
    elif byte == SPINDLE_STOP and core.state == "Hold" and core.modes.spindle != "M5":
        core.spindle_stopped = not core.spindle_stopped
        core.set_spindle("M5" if core.spindle_stopped else core.modes.spindle, core.modes.speed)
    elif (byte == FLOOD or (byte == MIST and "M7" in core.profile.codes)) and core.state in (
        "Idle",
        "Run",
        "Hold",
    ):
        core.toggle_coolant(mist=byte == MIST)
    if before != (planner.feed_override, planner.rapid_override, core.spindle_override):
        core.override_counter = 0
        core.note(
            "override", f"{planner.feed_override},{planner.rapid_override},{core.spindle_override}"
        )
        core.steppers.replan(core.now)


def _scaled(percent: int, change: int) -> int:
    """Return a new override; a change of 0 sets it to 100."""
    return min(max(percent + change, LEAST), LARGEST) if change else 100
