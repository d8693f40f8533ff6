"""The main program: start, then one line at a time (interface.md, "Grbl Response Messages")."""

from __future__ import annotations

from cnc.boards.grbl.simulator.commands import Answer, run_line, run_startup_lines, system_command
from cnc.boards.grbl.simulator.core import BUSY, Abandon, Abort, Core, Program, Wait
from cnc.boards.grbl.simulator.report import settings_list

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
