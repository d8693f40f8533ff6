"""Faults of a GRBL board: its codes and their meanings, and BoardErrors with line and advice."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Sequence
from importlib.resources import files
from typing import NamedTuple

from cnc.boards.grbl.messages import DOOR_SHUT, Firmware, Reply, Status
from cnc.boards.protocols import board_error
from cnc.model.blocks import AXIS_LETTERS
from cnc.model.diagnostics import BoardError, Diagnostic

# The error and alarm codes of GRBL, grblHAL and FluidNC: their meanings, and advice.


class Meaning(NamedTuple):
    """The meaning of a code, and advice."""

    fault: str
    advice: str


_TABLES = tomllib.loads(files(__package__).joinpath("codes.toml").read_text(encoding="utf-8"))
POSITION_LOST: str = _TABLES["advice"]["position-lost"]
"""Advice where the motors may have lost steps."""
_ADVICE: dict[str, str] = _TABLES["advice"] | {"home": f"remove the cause; {POSITION_LOST}"}
ERRORS, ALARMS = (
    {
        firmware: {
            int(code): Meaning(fault, _ADVICE.get(advice, advice))
            for code, (fault, advice) in _TABLES[kind][firmware.value].items()
        }
        for firmware in Firmware
    }
    for kind in ("errors", "alarms")
)
"""Meanings by the number of the code; those of other firmwares only where GRBL's do not hold."""
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
    meaning = ERRORS[firmware].get(code) or ERRORS[Firmware.GRBL].get(code)
    return meaning or Meaning("this code is not known", _ask(firmware, "error"))


def alarm_meaning(code: int, firmware: Firmware) -> Meaning:
    """Return the meaning of ``ALARM:code``."""
    meaning = ALARMS[firmware].get(code) or ALARMS[Firmware.GRBL].get(code)
    return meaning or Meaning("this code is not known", _ask(firmware, "alarm"))


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
