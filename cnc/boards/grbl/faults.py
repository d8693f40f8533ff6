"""Faults of a GRBL board: its codes and their meanings, and BoardErrors with line and advice."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

from cnc.boards.grbl.messages import DOOR_SHUT, Firmware, Reply, Status
from cnc.boards.protocols import board_error
from cnc.model.blocks import AXIS_LETTERS
from cnc.model.diagnostics import BoardError, Diagnostic

# The error and alarm codes of GRBL: their meanings, and advice.
#
# Sources: "Grbl v1.1 Interface" (tables of error and alarm codes, csv files), grblHAL's list (its
# ``$EE`` and ``$EA``), FluidNC's (``$E``; Error.h and Protocol.cpp of its sources). grblHAL and
# FluidNC share errors up to 37 and alarms up to 9. Their higher codes have other meanings.


class Meaning(NamedTuple):
    """The meaning of a code, and advice."""

    fault: str
    advice: str


_OURS = (
    "the translator wrote a line that the board does not accept; please report the program and "
    "this message"
)
_LINK = (
    "bytes may have been lost: use a shorter USB cable without a hub, away from the spindle cable"
)
_SET = "correct the board's setting: cncrun boards lists the settings"
_YAML = "correct config.yaml; the board's messages at its start name the fault"

ERRORS: dict[int, Meaning] = {
    1: Meaning("a word does not begin with a letter", _LINK),
    2: Meaning("a number is missing or not a number", _LINK),
    3: Meaning(
        "the board does not know this $ command", "remove it, or update the board's firmware"
    ),
    4: Meaning("a value must not be negative", "correct the value in the program"),
    5: Meaning(
        "homing is switched off",
        "set $22=1 if the machine has homing switches; otherwise remove $H; cncrun unlock leaves "
        "an alarm without homing",
    ),
    6: Meaning("the step pulse is too short", "set $0 to 3 us or more"),
    7: Meaning(
        "the board could not read its memory; its settings are the defaults now",
        "restore the settings before anything moves",
    ),
    8: Meaning("this $ command needs a board at rest", "wait for the end of the motion"),
    9: Meaning(
        "the board is locked by an alarm",
        "home the machine (cncrun home), or unlock it if its position is right (cncrun unlock)",
    ),
    10: Meaning("soft limits need homing", "set $22=1 first, or leave $20=0"),
    11: Meaning("the line is too long for the board", _OURS),
    12: Meaning(
        "a setting needs a higher step rate than the board can make",
        "lower $100 to $102 or $110 to $112",
    ),
    13: Meaning("the safety door is open", "close it and start again"),
    14: Meaning("the text is too long for the board's memory", "shorten it"),
    15: Meaning("a jog leaves the travel", "jog a shorter distance"),
    16: Meaning("a jog command is malformed", _LINK),
    17: Meaning("laser mode needs a spindle output with PWM", "set $32=0"),
    20: Meaning("the board does not know a command of this line", _OURS),
    21: Meaning("two commands of this line exclude each other", _LINK),
    22: Meaning("no feed has been given", _OURS),
    23: Meaning("a number must be an integer", _LINK),
    24: Meaning("two commands of this line both need the axis words", _LINK),
    25: Meaning("a word occurs twice in a line", _LINK),
    26: Meaning("a command needs axis words and has none", _LINK),
    27: Meaning("a line number is out of range", "line numbers are 1 to 9999999"),
    28: Meaning("a command lacks a P or L word", _LINK),
    29: Meaning("the board has the coordinate systems G54 to G59 only", "use one of those"),
    30: Meaning("G53 is valid with G0 and G1 only", _OURS),
    31: Meaning("a line has axis words that no command uses", _LINK),
    32: Meaning("an arc has no axis word of its plane", _LINK),
    33: Meaning(
        "the target is invalid: the radii of an arc differ, or a probe is at its target already",
        _OURS,
    ),
    34: Meaning("the radius of an arc is too small", _OURS),
    35: Meaning("an arc has no centre", _LINK),
    36: Meaning("a line has words that no command uses", _LINK),
    37: Meaning("a tool length offset is valid for the Z axis only", "set the offset along Z"),
    38: Meaning("the tool number is too large for the board", "use a smaller T number"),
}
"""Errors 1 to 38 of GRBL 1.1; most of them are also those of grblHAL."""

ERRORS_HAL: dict[int, Meaning] = {
    6: Meaning("the step pulse is too short", "set $0 to 2 us or more"),
    18: Meaning("the reset input is active", "release the reset button"),
    19: Meaning("a value must be greater than 0", "correct the value"),
    38: Meaning("the tool is not in the board's table", "use a tool of the table"),
    39: Meaning("a value is out of range", "correct the value in the program"),
    40: Meaning("the board waits for the end of a tool change", "finish it, then start again"),
    41: Meaning("the spindle must turn for this move", "start it first"),
    42: Meaning("threading needs the plane G18", "select it"),
    43: Meaning(
        "the feed is higher than the board allows", "lower the feed, or raise $110 to $112"
    ),
    44: Meaning("the spindle can't turn at this speed", "correct S, or $30 and $31"),
    45: Meaning("a limit switch is active", "move off the switch, or home the machine"),
    46: Meaning("the machine has to be homed first", "home it (cncrun home)"),
    47: Meaning("the board does not know which tool is in the spindle", "set it with M61"),
    48: Meaning("two values of this line contradict each other", _LINK),
    49: Meaning("the board's self test failed", "switch it off and on"),
    50: Meaning("the emergency stop is pressed", "release it, then start again"),
    51: Meaning(
        "a motor driver reports a fault",
        "check the drivers and their power supply, then switch off and on",
    ),
    52: Meaning("a setting is out of range", _SET),
    53: Meaning("this board does not have that setting", _SET),
    54: Meaning("the retract position of a cycle is below its bottom", _OURS),
    55: Meaning("the homing settings contradict each other", _SET),
    56: Meaning("the coordinate system is locked", "unlock it on the board"),
    57: Meaning("a % is not expected here", "remove it"),
    58: Meaning("the board does not have that input or output", "use another one"),
    60: Meaning("the memory card can't be mounted", "check the card"),
    61: Meaning("a file on the board can't be read", "check the card"),
    62: Meaning("a folder on the board can't be opened", "check the card"),
    63: Meaning("there is no such folder on the board", "check the card"),
    64: Meaning("no memory card is mounted", "mount it"),
    65: Meaning("the board's file system is not mounted", "mount it"),
    66: Meaning("the board's file system can't be written", "check the card"),
    70: Meaning("Bluetooth did not start", "check the board's settings"),
    71: Meaning("an expression has an unknown operation", _OURS),
    72: Meaning("an expression divides by zero", _OURS),
    73: Meaning("an argument of an expression is out of range", _OURS),
    74: Meaning("an argument of an expression is wrong", _OURS),
    75: Meaning("an expression is malformed", _OURS),
    76: Meaning("an expression has no value", _OURS),
    77: Meaning("the board needs a password", "log in first"),
    78: Meaning("the board does not allow this", "log in as another user"),
    79: Meaning(
        "the board needs a reset before it continues",
        "remove the cause of the alarm, then start again",
    ),
    80: Meaning("flow control is valid only in macros on the board", _OURS),
    81: Meaning("flow control is malformed", _OURS),
    82: Meaning("flow control is nested too deep", _OURS),
    83: Meaning("the board ran out of memory", "switch it off and on"),
    84: Meaning("a file on the board can't be opened", "check the card"),
}
"""Errors of grblHAL that differ from GRBL's, or that GRBL lacks."""

ERRORS_FLUID: dict[int, Meaning] = {
    5: Meaning("this is switched off in the board's configuration", _YAML),
    18: Meaning("no axis homes", "give the axes a homing cycle in config.yaml, or remove $H"),
    19: Meaning("the board does not home single axes", "home all axes"),
    38: Meaning("a number is too large for the board", "use a smaller number"),
    39: Meaning("a P word is too large for the board", "use a smaller P number"),
    40: Meaning("a control input is active", "release the button, then reset the board"),
    60: Meaning("the memory card can't be mounted", "check the card"),
    61: Meaning("a file on the board can't be read", "check the card"),
    62: Meaning("a folder on the board can't be opened", "check the card"),
    63: Meaning("there is no such folder on the board", "check the card"),
    64: Meaning("a file on the board is empty", "check the card"),
    65: Meaning("there is no such file on the board", "check the card"),
    66: Meaning("a file on the board can't be opened", "check the card"),
    67: Meaning("the board's file system is busy", "wait for the end of its job"),
    80: Meaning("a setting is out of range", _SET),
    81: Meaning("a setting has an invalid value", _SET),
    110: Meaning("the board needs a password", "log in first"),
    120: Meaning(
        "the board has a job from another connection",
        "end the job of the memory card or of the web page, then start again",
    ),
    130: Meaning("the jog was cancelled", "jog again"),
    150: Meaning("a pin in the board's configuration is invalid", _YAML),
    151: Meaning("the board does not have that setting", _YAML),
    152: Meaning("the board's configuration is invalid", _YAML),
    162: Meaning("that setting can't be changed", _YAML),
}
"""Errors of FluidNC that differ from GRBL's, or that GRBL lacks."""

POSITION_LOST = (
    "its position is lost: home the machine (cncrun home); where it does not home, unlock it "
    "(cncrun unlock), move the tool to the zero of the part, set it there (cncrun zero X Y Z), and "
    "confirm that with --trust-position"
)
"""Advice where the motors may have lost steps."""
_HOME = f"remove the cause; {POSITION_LOST}"

ALARMS: dict[int, Meaning] = {
    1: Meaning("a limit switch was hit", _HOME),
    2: Meaning(
        "the target lies outside the travel of the board's settings",
        "check the work offset and $130 to $132; the position is kept",
    ),
    3: Meaning("the board was reset during motion", _HOME),
    4: Meaning(
        "the probe was not in its rest state before the move",
        "check the probe, its wire and $6; the position is kept",
    ),
    5: Meaning(
        "the probe made no contact",
        "check the probe and the length of the probing move; the position is kept",
    ),
    6: Meaning("a reset ended homing", "home again"),
    7: Meaning("the safety door ended homing", "close it and home again"),
    8: Meaning(
        "homing could not clear the limit switch", "raise $27, or check the wire of the switch"
    ),
    9: Meaning(
        "homing found no limit switch", "check the switches, $23 and the travel $130 to $132"
    ),
    10: Meaning(
        "homing found no second limit switch of an axis with two motors",
        "check that switch and its wire",
    ),
}
"""Alarms 1 to 10 of GRBL 1.1; 1 to 9 are also those of grblHAL."""

ALARMS_HAL: dict[int, Meaning] = {
    10: Meaning("the emergency stop is pressed", "release it, then home the machine"),
    11: Meaning("the machine has to be homed first", "home it (cncrun home)"),
    12: Meaning("a limit switch is active", "move off the switch, or home the machine"),
    13: Meaning(
        "the probe was touched outside a probing move",
        "move off, then unlock the board (cncrun unlock)",
    ),
    14: Meaning("the spindle did not reach its speed in time", "check the spindle and its drive"),
    15: Meaning(
        "homing found no second limit switch of an axis with two motors",
        "check that switch and its wire",
    ),
    16: Meaning("the board's self test failed", "switch it off and on"),
    17: Meaning(
        "a motor driver reports a fault",
        "check the drivers and their power supply; the position is lost",
    ),
    18: Meaning("the homing settings contradict each other", _SET),
    19: Meaning("the spindle's drive does not answer", "check its Modbus wires and settings"),
    20: Meaning("an input and output module does not answer", "check its wires"),
    21: Meaning("the board's memory failed", "restore the settings before anything moves"),
}
"""Alarms that GRBL lacks, or that differ from GRBL's."""


ALARMS_FLUID: dict[int, Meaning] = {
    10: Meaning("the spindle did not reach its speed in time", "check the spindle and its drive"),
    11: Meaning(
        "a control input is active",
        "release the button, or correct its pin in config.yaml, then start again",
    ),
    12: Meaning(
        "a limit switch is active, and homing can't tell which end it is",
        "move the axis off its switch by hand, then home again",
    ),
    13: Meaning("the board was stopped by its emergency stop or a fault input", _HOME),
    14: Meaning("the machine has to be homed first", "home it (cncrun home)"),
    15: Meaning(
        "the board is locked after its start",
        "home the machine (cncrun home), or unlock it if its position is right (cncrun unlock)",
    ),
}
"""Alarms that GRBL lacks, or that differ from GRBL's."""

OWN_ERRORS = {Firmware.HAL: ERRORS_HAL, Firmware.FLUID: ERRORS_FLUID}
OWN_ALARMS = {Firmware.HAL: ALARMS_HAL, Firmware.FLUID: ALARMS_FLUID}

STARTUP_ALARMS = {
    Firmware.GRBL: frozenset((11,)),
    Firmware.HAL: frozenset((11,)),
    Firmware.FLUID: frozenset((14, 15)),
}
"""Alarms that a board raises when it starts and has to be homed or unlocked first.

GRBL has no 11, but grblHAL may greet as GRBL (compatibility level above 0).
"""
ABRUPT = {
    Firmware.GRBL: frozenset((1, 3)),
    Firmware.HAL: frozenset((1, 3, 10, 17)),
    Firmware.FLUID: frozenset((1, 3, 13)),
}
"""Alarms that stop the motors during a move, without a ramp."""
NOT_HOMED = {
    Firmware.GRBL: frozenset((6, 7, 8, 9, 10)),
    Firmware.HAL: frozenset((6, 7, 8, 9, 11, 15, 18)),
    Firmware.FLUID: frozenset((6, 7, 8, 9, 12, 14)),
}
"""Alarms of a homing cycle that did not reach its end, or that is due."""


def stops_motors(code: int, firmware: Firmware) -> bool:
    """Return whether ``ALARM:code`` stops the motors during a move, without a ramp."""
    return code in ABRUPT[firmware]


def loses_position(code: int, firmware: Firmware) -> bool:
    """Return whether the reported position is unreliable after ``ALARM:code``."""
    return code in ABRUPT[firmware] | NOT_HOMED[firmware]


def error_meaning(code: int, firmware: Firmware) -> Meaning:
    """Return the meaning of ``error:code``."""
    own = OWN_ERRORS.get(firmware, {}).get(code)
    return own or ERRORS.get(code) or Meaning("this code is not known", _ask(firmware, "error"))


def alarm_meaning(code: int, firmware: Firmware) -> Meaning:
    """Return the meaning of ``ALARM:code``."""
    own = OWN_ALARMS.get(firmware, {}).get(code)
    return own or ALARMS.get(code) or Meaning("this code is not known", _ask(firmware, "alarm"))


def _ask(firmware: Firmware, kind: str) -> str:
    """Return where the codes of a firmware are listed; ``kind``: error or alarm."""
    commands = {Firmware.HAL: f"$E{kind[0].upper()}", Firmware.FLUID: f"${kind[0].upper()}"}
    if command := commands.get(firmware):
        return f"send {command} to the board for its own list of codes"
    return f"look up the {kind} code in the manual of the board's firmware"


CABLE = (
    "use a better cable (short, shielded, no hub); check the part, it may be wrong since this line"
)
STOP_IT = (
    "if the machine still moves, press its emergency stop; check the power supply and the cable, "
    "then home it"
)
PROBE_ALARMS = (4, 5)
_PASSED_ON = re.compile(r"M0*(?![0-9]$|30$|6[2-8]$)[0-9]+", re.IGNORECASE)
"""An M-code that only the program can have: it is passed on by ``[program.codes]``."""
_PASS_ON_LESS = (
    "the program's code is passed on to the board, which lacks it: change its effect under "
    "[program.codes] in the machine file"
)


def refused(reply: Reply, text: str, line: int, firmware: Firmware) -> BoardError:
    """Return the fault of a line that the board refuses with an error."""
    meaning = error_meaning(reply.error, firmware)
    hint = _PASS_ON_LESS if _PASSED_ON.fullmatch(text.strip()) else meaning.advice
    shown = f"error: {reply.text}" if reply.text else f"error:{reply.error}: {meaning.fault}"
    return board_error(
        "board-error",
        f"the board refuses {text!r} with {shown}",
        line=line,
        hint=hint,
    )


def alarmed(code: int, line: int, firmware: Firmware, *, probing: bool = False) -> BoardError:
    """Return the fault of ``ALARM:code``; ``probing``: during a probing move."""
    meaning = alarm_meaning(code, firmware)
    name = "probe-no-contact" if probing and code in PROBE_ALARMS else "board-alarm"
    return board_error(
        name,
        f"the board stopped with ALARM:{code}: {meaning.fault}",
        line=line,
        hint=meaning.advice,
    )


def offset_differs(offset: Sequence[float], line: int) -> BoardError:
    """Return the fault of a board that adds another offset, mm, than that of its G54."""
    shown = ", ".join(f"{value:g}" for value in offset)
    message = f"the board uses another offset than its G54: {shown} mm"
    hint = "a start-up line ($N) may set it; use G54 to G59 for offsets"
    return board_error("offset-differs", message, line=line, hint=hint)


def offset_not_kept(name: str, wanted: Sequence[float], kept: Sequence[float]) -> BoardError:
    """Return the fault of an offset, mm, that is not the one that was written."""
    message = f"{name} was to be {shown(wanted)} mm; the board has {shown(kept)}"
    hint = "read the offsets again, and compare the steps/mm of the board"
    return board_error("offset-not-kept", message, hint=hint)


def laser_mode_off() -> BoardError:
    """Return the fault of a board that is not in laser mode."""
    message = "the machine is a laser, but the board is not in laser mode ($32=0)"
    return board_error("laser-mode-off", message, hint="switch it on: cncrun settings 32=1")


def alarmed_unheard(line: int) -> BoardError:
    """Return the fault of a board that is in alarm without a message."""
    hint = f"check its switches and its display; {POSITION_LOST}"
    return board_error(
        "board-alarm",
        "the board is in alarm; its message with the cause was lost",
        line=line,
        hint=hint,
    )


def restarted(line: int) -> BoardError:
    """Return the fault of a board that restarts during a run."""
    return board_error(
        "board-restarted",
        "the board has restarted by itself",
        line=line,
        hint=f"check its reset button and its power supply; {POSITION_LOST}",
    )


def locked(line: int) -> BoardError:
    """Return the fault of a board that was in alarm before."""
    hint = (
        "home the machine (cncrun home, --home before the program, or a program that begins with "
        "$H), or unlock the board if its position is right (cncrun unlock)"
    )
    return board_error("board-locked", "the board is locked by an alarm", line=line, hint=hint)


def at_door(status: Status) -> BoardError:
    """Return the fault of a board that waits at its safety door."""
    shut = status.phase == DOOR_SHUT and "D" not in status.pins
    message = "was opened" if shut else "is open"
    hint = "start again" if shut else "close it, then start again"
    return board_error(
        "board-busy", f"the board is not ready: its safety door {message}", hint=hint
    )


def at_switch(axes: str) -> BoardError:
    """Return the fault of a board that locks itself again: limit switches are pressed."""
    names = " and ".join(axes)
    first = axes[0]
    hint = (
        f"move {first} off its switch by hand; or jog it off without hard limits (cncrun settings "
        f"21=0), unlocked (cncrun unlock), away from the switch (cncrun jog {first}-2 --unhomed), "
        "and switch them on again (cncrun settings 21=1)"
    )
    message = f"the board stays locked: the limit switch of {names} is pressed"
    return board_error("board-locked", message, hint=hint)


def lost(after: int, until: int) -> BoardError:
    """Return the fault of answers that do not match the lines."""
    where = f"between line {after} and line {until}" if after < until else f"near line {until}"
    return board_error(
        "reply-lost",
        f"a line or its answer was lost between computer and board, {where}",
        line=until,
        hint=CABLE,
    )


def question_lost(line: int) -> BoardError:
    """Return the fault of a mark that is not answered."""
    message = f"the board accepted line {line}, but does not answer after it: bytes were lost"
    return board_error("reply-lost", message, line=line, hint=CABLE)


def unanswered(line: int) -> BoardError:
    """Return the fault of a board at rest with an unanswered line."""
    message = (
        f"the board is at rest and has not answered line {line}: the line, or its answer, was lost"
    )
    return board_error("reply-missing", message, line=line, hint=CABLE)


def stuck(seconds: float, line: int) -> BoardError:
    """Return the fault of a board that reports Run and does not move."""
    hint = "check the machine, then switch the board off and on"
    return board_error(
        "board-stuck",
        f"the board reports Run, but has not moved for {seconds:g} s",
        line=line,
        hint=hint,
    )


def off_path(position: Sequence[float], off: float, line: int) -> BoardError:
    """Return the fault of a board beside its moves; ``off``: distance in mm."""
    message = (
        f"the board is at {shown(position)}, {off:.3g} mm off its toolpath: bytes of line {line}, "
        "or of a line soon after, were lost"
    )
    return board_error("off-path", message, line=line, hint=CABLE)


def elsewhere(position: Sequence[float], off: float, line: int) -> BoardError:
    """Return the fault of a board that rests beside the end of its moves."""
    message = (
        f"the board stands at {shown(position)}, {off:.3g} mm from the end of line {line}: bytes "
        "were lost"
    )
    return board_error("position-differs", message, line=line, hint=CABLE)


def too_old(name: str, version: str, report: str = "") -> BoardError:
    """Return the fault of a board with an older GRBL; ``report``: what showed its version."""
    shown = f" (it reports {report!r})" if report else ""
    return board_error(
        "board-too-old",
        f"the board at {name} runs Grbl {version}{shown}, which has another protocol",
        hint="flash GRBL 1.1 or grblHAL",
    )


class OtherFirmware(BoardError):
    """A device that sends text, but is no GRBL board."""


def not_grbl(name: str, received: Sequence[str]) -> BoardError:
    """Return the fault of a port without the welcome of a GRBL board.

    Args:
        name: Name of the port.
        received: The lines that came, and the begin of another one.
    """
    if any(not (text.isascii() and text.isprintable()) for text in received):
        return board_error(
            "board-not-grbl",
            f"the device at {name} sends unreadable bytes: its baud rate is another one",
            hint="GRBL 1.1 has 115200, older ones 9600: give --baud, or board.baud in the machine "
            "file",
        )
    if received:
        message = f"the board at {name} is not a GRBL board: it sends {received[0][:60]!r}"
        hint = "name the port of a board with GRBL 1.1 or grblHAL, or flash this board"
        return OtherFirmware(Diagnostic("board-not-grbl", message, hint=hint))
    hint = "check that it is switched on, the port (cncrun boards lists the ports) and board.baud"
    return board_error("no-answer", f"no board answers at {name}", hint=hint)


def emergency(name: str) -> BoardError:
    """Return the fault of a board that cannot start, because its emergency stop is pressed."""
    message = f"the board at {name} does not start: its emergency stop is pressed"
    return board_error("board-alarm", message, hint="release it, then start again")


def silent(name: str) -> BoardError:
    """Return the fault of a board that does not answer ``?``."""
    return board_error("board-silent", f"the board at {name} no longer answers", hint=STOP_IT)


def not_stopped(name: str) -> BoardError:
    """Return the fault of a board without a welcome after a reset."""
    return board_error(
        "board-silent", f"the board at {name} does not confirm that it has stopped", hint=STOP_IT
    )


def followed_by(first: BoardError, second: BoardError) -> BoardError:
    """Return two faults as one, with the advice of the second."""
    one, two = first.diagnostic, second.diagnostic
    return type(first)(
        Diagnostic(one.code, f"{one.message}; then: {two.message}", line=one.line, hint=two.hint)
    )


def shown(position: Sequence[float]) -> str:
    """Return a position as text, such as ``X1.000 Y2.000 Z0.000``."""
    return " ".join(
        f"{letter.upper()}{value:.3f}"
        for letter, value in zip(AXIS_LETTERS, position, strict=False)
    )
