"""The main program: start, then one line at a time (interface.md, "Grbl Response Messages")."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import replace

from cnc.simulators.grbl import report
from cnc.simulators.grbl.core import (
    BUSY,
    LONGEST_TEXT,
    STARTUP_LINES,
    Abandon,
    Abort,
    Core,
    Program,
    Wait,
)
from cnc.simulators.grbl.firmware_profile import TOOL_CHANGE_MODE
from cnc.simulators.grbl.line_check import NUMBER, Modes, Refused, check_line, sort_words
from cnc.simulators.grbl.motion import home, move_to, perform, within_travel, write_eeprom
from cnc.simulators.grbl.report import settings_list

# ``$`` commands (commands.md): settings, reports, jogs, homing, check mode, sleep.
#
# Each handler returns an error code, 0 for ok.

Answer = Generator[Wait, None, int]
REPORTS: dict[str, Callable[[Core], list[str]]] = {
    "#": report.parameters,
    "I": report.build_info,
    "N": report.startup_lines,
}
LARGEST_NUMBER = {"grbl": 255, "grblhal": 65535, "fluidnc": 255}
"""Largest number of a setting."""
MEASURING = (1, 2, 3)
"""Tool change modes that measure the tool; they are not modelled."""
JOG_COMMANDS = {"distance", "units", "other"}


def system_command(core: Core, text: str) -> Answer:
    """Carry out a line that begins with ``$``, in upper case without spaces."""
    body = text[1:]
    if body.startswith("J"):
        return (yield from _jog(core, body[1:]))
    if body == "$":
        if not core.profile.numbered_settings:
            return 3
        if core.state in ("Run", "Hold"):
            return 8
        return (yield from _print(core, report.settings_list(core)))
    if body in IN_ANY_STATE:
        return IN_ANY_STATE[body](core)
    if body[0] in "$GCX":
        return 3
    if core.state not in ("Idle", "Alarm"):
        return 8
    return (yield from _command_at_rest(core, body))


def _command_at_rest(core: Core, body: str) -> Answer:
    """Carry out a command that needs state Idle or Alarm."""
    if body == "ES" and core.profile.name == "grblhal":
        return (yield from _print(core, report.enumerated_settings(core)))
    if body == "I+" and core.profile.name == "grblhal":
        return (yield from _print(core, report.extended_info(core)))
    if body in REPORTS:
        return (yield from _print(core, REPORTS[body](core)))
    if body == "H":
        return (yield from _home(core))
    if body == "SLP":
        core.flags.sleep = True
        return 0
    if body.startswith("RST="):
        return (yield from _restore(core, body[4:]))
    if body.startswith("I="):
        if len(body) - 2 > LONGEST_TEXT:
            return 14
        yield from write_eeprom(core, lambda: core.eeprom.store_build_info(body[2:]))
        return 0
    if body[0] == "N" and "=" in body:
        return (yield from _startup_line(core, body[1:]))
    return (yield from _set(core, body))


def _print(core: Core, lines: list[str]) -> Answer:
    """Print line by line, each as soon as the ring has space."""
    for line in lines:
        core.say(line)
        yield BUSY
    return 0


def _help(core: Core) -> int:
    """``$``."""
    core.say(report.HELP)
    return 0


def _parser_state(core: Core) -> int:
    """``$G``."""
    core.say(report.parser_state(core))
    return 0


def _check_mode(core: Core) -> int:
    """``$C``: on in Idle; off, with a reset."""
    if core.state == "Check":
        core.say("[MSG:Disabled]")
        core.flags.reset = True
    elif core.state != "Idle":
        return 8
    else:
        core.state = "Check"
        core.say("[MSG:Enabled]")
    return 0


def _unlock(core: Core) -> int:
    """``$X``."""
    if core.state == "Alarm":
        if core.environment.door_open:
            return 13
        if core.must_home and core.profile.name == "grblhal":
            return 46
        core.say("[MSG:Caution: Unlocked]")
        core.state = "Idle"
    return 0


IN_ANY_STATE: dict[str, Callable[[Core], int]] = {
    "": _help,
    "G": _parser_state,
    "C": _check_mode,
    "X": _unlock,
}


def _home(core: Core) -> Answer:
    """``$H``, and the start-up lines after it."""
    if not core.setting[22]:
        return 5
    if core.environment.door_open:
        return 13
    yield from home(core)
    yield from run_startup_lines(core)
    return 0


def _restore(core: Core, part: str) -> Answer:
    """``$RST=``, which ends with a reset."""
    if part not in ("$", "#", "*"):
        return 3
    yield from write_eeprom(core, lambda: core.eeprom.restore(part))
    core.say("[MSG:Restoring defaults]")
    core.flags.reset = True
    return 0


def _set(core: Core, body: str) -> Answer:
    """``$x=value``."""
    if body[0] in "#INHSR":
        return 3
    number = NUMBER.match(body)
    if number is None:
        return 2
    rest = body[number.end() :]
    value = NUMBER.fullmatch(rest[1:])
    if not rest.startswith("=") or float(number.group()) not in range(
        LARGEST_NUMBER[core.profile.name] + 1
    ):
        return 3
    if value is None:
        return 2
    profile = core.profile
    try:
        written = core.eeprom.set(
            int(float(number.group())),
            float(value.group()),
            profile.max_step_rate_hz,
            profile.variable_spindle,
        )
    except Refused as refused:
        return refused.code
    yield from write_eeprom(core, lambda: written)
    return 0


def _startup_line(core: Core, body: str) -> Answer:
    """``$Nx=line``: run the line to check it, then store it."""
    index, _, text = body.partition("=")
    if not index.isdecimal() or not index.isascii() or int(index) >= STARTUP_LINES:
        return 3
    if core.state != "Idle":
        return 8
    if len(text) > LONGEST_TEXT:
        return 14
    code = yield from run_line(core, text)
    if not code:
        yield from write_eeprom(core, lambda: core.eeprom.store_startup(int(index), text))
    return code


def run_line(core: Core, text: str) -> Answer:
    """Check a line of the program, and carry it out."""
    try:
        line = check_line(text, core.modes, core.place)
    except Refused as refused:
        return refused.code
    if line.changes_tool and core.setting[TOOL_CHANGE_MODE] in MEASURING:
        # as in a build with a compatibility level of 2
        return 20
    yield from perform(core, line)
    return 0


def run_startup_lines(core: Core) -> Answer:
    """Run the stored start-up lines; each is echoed with its answer."""
    for text in core.eeprom.startup:
        if text:
            core.print(f">{text}:")
            code = yield from run_line(core, text)
            core.say(f"error:{code}" if code else "ok")
            yield BUSY
    return 0


def _jog(core: Core, body: str) -> Answer:
    """``$J=``: a motion that keeps the parser's modes. Errors 8, 15, 16, 22, those of words."""
    if core.state not in ("Idle", "Jog"):
        return 8
    if not body.startswith("="):
        return 3
    try:
        axes = set(core.profile.axes)
        words = sort_words(body[1:], core.profile.codes, core.profile.axes)
        if not set(words.values) & axes and not set(words.commands) - JOG_COMMANDS:
            return 26
        if not words.values.get("F"):
            return 22
        modes: Modes = replace(core.modes, motion="G1", feed_mode="G94")
        line = check_line(body[1:], modes, core.place)
        if set(words.values) & set("ST"):
            return 36
        if set(words.commands) - JOG_COMMANDS or words.commands.get("other", "G53") != "G53":
            return 16
    except Refused as refused:
        return refused.code
    if core.setting[20] and not within_travel(core, line.target):
        return 15
    yield from move_to(core, "jog", line.target, line, line.feed, 0)
    core.parsed = line.target
    core.start_cycle()
    return 0


LINE_TIME_A_BYTE = 30e-6
"""Seconds that an AVR needs for a byte of a line.

A check run of 26-byte lines is then limited by the wire, and a short line is answered in 0.8 ms.
"""
LINE_ENDS = b"\r\n"
STORED = "settings"


class LineBuffer:
    """Assembles lines: no spaces, no comments, capitals; ``overflowed``: the line was too long."""

    def __init__(self, capacity: int, pairs: bool) -> None:
        self._capacity = capacity
        self._pairs = pairs
        self._end = 0
        self.clear()

    def clear(self) -> None:
        """Begin a line."""
        self.text = ""
        self.overflowed = False
        self.bytes = 0
        self._comment = ""

    def feed(self, byte: int) -> bool:
        """Take one byte, and return whether the line is complete."""
        self.bytes += 1
        if byte in LINE_ENDS:
            if self._pairs and self.bytes == 1 and self._end not in (0, byte):
                self._end = self.bytes = 0
                return False
            self._end = byte
            return True
        self._end = 0
        character = chr(byte)
        if self._comment:
            if character == ")" and self._comment == "(":
                self._comment = ""
        elif character in "(;":
            self._comment = character
        elif byte > 0x20 and character != "/":
            if len(self.text) >= self._capacity:
                self.overflowed = True
            else:
                self.text += character.upper()
        return False


class Firmware:
    """The program of the processor. ``run`` never ends; a reset raises Abort in it."""

    def __init__(self, core: Core) -> None:
        self.core = core
        self.buffer = LineBuffer(core.profile.line_length, core.profile.pairs_line_ends)
        self.reading = False
        self.complete = False
        """Whether a byte that was fed while :attr:`reading` has ended a line."""

    def run(self) -> Program:
        """Power up, then start again after every reset."""
        core = self.core
        core.homed = False
        if core.must_home:
            core.state = "Alarm"
        if STORED in core.eeprom.damaged:
            core.eeprom.damaged.clear()
            core.eeprom.restore("*")
            core.say("error:7")
            for line in settings_list(core):
                core.say(line)
                yield BUSY
        while True:
            try:
                yield from self._start()
                yield from self._lines()
            except Abort:
                continue

    def _start(self) -> Program:
        """Set all but position and memory as after power-up, and print the welcome."""
        core = self.core
        self.reading = False
        core.force_reset()
        core.receiver.ring.clear()
        self.buffer.clear()
        core.outputs_off()
        for message in core.profile.start_messages:
            core.say(message)
        core.say("")
        core.say(core.profile.banner)
        core.note("start")
        yield BUSY
        if core.setting[21] and core.environment.tripped(core.position):
            core.say("[MSG:Check Limits]")
        if core.environment.stop_pressed and core.profile.estop_alarm is not None:
            core.state = "Alarm"
            core.say(f"ALARM:{core.profile.estop_alarm}")
            core.say("[MSG:Emergency stop - clear, then reset to continue]")
            return
        if core.must_home and core.profile.lock_alarm is not None:
            core.say(f"ALARM:{core.profile.lock_alarm}")
        if core.state in ("Alarm", "Sleep"):
            core.say("[MSG:'$H'|'$X' to unlock]")
            core.state = "Alarm"
            return
        core.state = "Idle"
        if core.environment.door_open:
            core.flags.door = True
            yield Wait()
        yield from run_startup_lines(core)

    def _lines(self) -> Program:
        """Read lines, and answer them."""
        core, ring, buffer = self.core, self.core.receiver.ring, self.buffer
        while True:
            if core.state == "Tool":
                # No line is read until a cycle start ends the tool change.
                yield Wait(lambda: core.state != "Tool")
                continue
            if core.flushed and not self.complete:
                core.flushed = False
                buffer.clear()
            complete = False
            while ring and not complete:
                complete = buffer.feed(ring.popleft())
            if not complete:
                core.start_cycle()
                self.reading = True
                yield Wait(lambda: bool(ring) or self.complete or core.flushed)
                self.reading = False
                if not self.complete:
                    continue
                self.complete = False
            core.lines += 1
            core.work(buffer.bytes * LINE_TIME_A_BYTE)
            yield BUSY
            yield Wait()
            text, overflowed = buffer.text, buffer.overflowed
            buffer.clear()
            yield from self._answer(text, overflowed)

    def _answer(self, text: str, overflowed: bool) -> Program:
        """Carry out a line and reply. A reset meanwhile causes a late ok."""
        core = self.core
        core.note("line", text)
        core.answering = True
        core.commanding = text.startswith("$")
        if core.forced_error:
            code, core.forced_error = core.forced_error, 0
        elif overflowed:
            code = 11
        else:
            try:
                code = yield from self._execute(text)
            except Abort:
                core.reply(0)
                raise
            except Abandon:
                code = 0
        if text[:1] != "$" or not code:
            core.last_error = code
        # an alarm that came too late to end this line must not end another one
        core.answering = core.abandoned = core.commanding = False
        core.reply(code)
        yield BUSY

    def _execute(self, text: str) -> Answer:
        core = self.core
        if not text:
            core.last_error = 0
            return 0
        if text.startswith("$"):
            return (yield from system_command(core, text))
        if core.state in ("Alarm", "Jog"):
            return 9
        if core.profile.repeats_error and core.last_error:
            return core.last_error
        return (yield from run_line(core, text))
