"""Codes without motion: speed, tool, spindle, coolant, overrides, dwell, path control, stop.

Source: LinuxCNC, "M-codes" and "Other codes"; G4, G64, G96 and G97 in "G-codes".
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from cnc.compiled.jit import interpreted
from cnc.gcode.core.context import Context, Executor
from cnc.gcode.core.modal_groups import SPINDLE_STATES, Code, Codes, ModalState
from cnc.gcode.core.tool_table import MAX_TOOL
from cnc.gcode.kernels import rules
from cnc.gcode.reader.words import G, LineWords, M, Word, fault, not_negative, positive, whole
from cnc.model.blocks import (
    AnalogOutput,
    Coolant,
    DigitalOutput,
    Dwell,
    End,
    Orient,
    PathControl,
    PathMode,
    Spindle,
    Stop,
    Tool,
    WaitInput,
    WaitMode,
)
from cnc.model.parameter_numbers import INPUT_VALUE
from cnc.model.units import MM_PER_INCH

_speed_waits, _spindle_after = interpreted(rules.speed_waits), interpreted(rules.spindle_after)
_keeps_motion, _rpm_of = interpreted(rules.keeps_motion), interpreted(rules.rpm_of)
_coolants_after = interpreted(rules.coolants_after)
_DIRECTIONS = ("shortest", "cw", "ccw")
_OVERRIDE_SWITCHES: dict[G | M, str] = {
    M.M50: "feed_override",
    M.M51: "speed_override",
    M.M52: "adaptive_feed",
    M.M53: "feed_stop",
}


class MachineCodes(Executor):
    """Execution of codes without motion.

    The methods are called in the standard order of execution.
    """

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._laser = context.policy.laser
        self._passed_over = False

    # Speed, tool, spindle

    def speed_and_tool(self, words: LineWords, codes: Codes) -> None:
        """Execute S and T. An S word of G96 or G97 is left to them."""
        state = self._state
        dwell = (code := codes.get("non-modal")) is not None and code.number == G.G4
        is_time = dwell and "S" in (*self._dialect.dwell.units, *self._dialect.dwell.turns)
        if self._dialect.turning.lathe and code is not None and code.number == G.G92:
            self._limit_speed(words, codes, "S")
        elif "LIMS" in words.rest:
            self._limit_speed(words, codes, "LIMS")
        if (
            "S" in words.rest
            and "spindle-mode" not in codes
            and not is_time
            and (word := words.take("S", "S"))
        ):
            state.speed = self._speed(word)
            # A tool change stops the spindle.
            change = "spindle" in codes or "tool-change" in codes
            turning = SPINDLE_STATES.index(state.spindle)
            if _speed_waits(word.number, turning, M.M5 if change else -1):
                self._unused_words.note(word)
            elif turning and not change:
                self._spindle(with_motion=self._laser)
        if self._dialect.turning.lathe:
            return
        if word := words.take("T", "T"):
            state.tool = whole(word, "the tool number", 0, MAX_TOOL)
            if self._policy.lathe and self._dialect.flavour == "siemens":
                self._turn_turret(codes)
            elif M.M6 in self._dialect.m:
                self._unused_words.note(word)

    def _turn_turret(self, codes: Codes) -> None:
        """Change to the tool of a T word, which on SINUMERIK's lathes turns the turret.

        Source: Siemens, "SINUMERIK 840D sl/828D Programming Manual, Fundamentals", "Tool change
        with T command".
        """
        state, here = self._state, self._here
        if "tool-change" not in codes and state.tool not in (None, state.loaded):
            state.loaded = state.tool
            self._out.add(Tool(here.file, here.line, state.tool))

    def _speed(self, word: Word) -> float:
        """Speed of an S word: rpm, or mm/s from metres or feet a minute under G96."""
        number = not_negative(word, "the spindle speed")
        if not self._state.constant_surface:
            return number
        return number * (1000.0 if self._state.feed_scale == 1.0 else 12.0 * MM_PER_INCH) / 60.0

    def _limit_speed(self, words: LineWords, codes: Codes, letter: str) -> None:
        """S of a lathe's G50 (G92 in systems B and C) or LIMS: the highest speed under G96, rpm.

        SINUMERIK's LIMS limits G97 too. Source: Siemens, "SINUMERIK 840D sl/828D Programming
        Manual, Fundamentals", "Constant cutting rate (G96, G961, G97, LIMS)".
        """
        word = words.take(letter, "the limit of the spindle speed")
        if word is None:
            return
        state = self._state
        state.most_rpm = not_negative(word, "the highest speed")
        if state.constant_surface and state.spindle != "off" and "spindle" not in codes:
            self._spindle()

    def limit_range(self, code: str, rpm: float) -> None:
        """Execute SINUMERIK's G25 or G26 with S: the lowest or the highest speed in every mode."""
        state = self._state
        lowest, highest = state.rpm_range
        state.rpm_range = (rpm, highest) if code == "G25" else (lowest, rpm)
        if state.spindle != "off":
            self._spindle()

    def tool_change(self, words: LineWords, codes: Codes) -> None:
        """Execute M6 or M61."""
        code = codes.get("tool-change")
        if code is None:
            return
        state, here = self._state, self._here
        if code.number == M.M61:
            word = words.take("Q", "M61")
            if word is None:
                raise fault(
                    "tool-not-chosen",
                    "M61 needs a Q word",
                    code.word,
                    "give Q and the number of the tool in the spindle",
                )
            state.loaded = whole(word, "the tool number", 0, MAX_TOOL)
            self._out.add(Tool(here.file, here.line, state.loaded, change=False))
            return
        if state.tool is None and self._dialect.lenient:
            message = "M6 without a tool chosen by a T word: it stops for a change by hand"
            hint = "give T and the tool's number"
            here.report_warning("tool-change-by-hand", message, code.word, hint)
            self._spindle_off()
            self._out.add(Stop(here.file, here.line))
            return
        if state.tool is None:
            raise fault(
                "tool-not-chosen",
                "M6 without a tool chosen by a T word",
                code.word,
                "give T and the tool's number",
            )
        self._unused_words.mark_used("T")
        self._spindle_off()
        state.loaded = state.tool
        self._out.add(Tool(here.file, here.line, state.tool))

    def spindle(self, words: LineWords, codes: Codes) -> None:
        """Execute G96 or G97, then M3, M4, M5 or M19."""
        state = self._state
        mode, code = codes.get("spindle-mode"), codes.get("spindle")
        if mode:
            self._spindle_mode(words, mode)
        if code is None:
            if mode and state.spindle != "off":
                self._spindle()
        elif code.number == M.M19:
            self._orient(words)
        else:
            before = SPINDLE_STATES.index(state.spindle)
            after = _spindle_after(before, code.number)
            if after:
                self._take_power(words, code)
                # The beam of a laser gets its power from the S of each move.
                if state.speed is None and not self._laser:
                    message = f"{code.word.written} before any S word: the spindle does not turn"
                    self._here.report_warning("spindle-speed-missing", message, code.word, "give S")
                self._unused_words.mark_used("S")
            state.spindle = SPINDLE_STATES[after]
            in_motion = self._laser and _keeps_motion(before, after, code.number)
            self._spindle(with_motion=in_motion)

    def _take_power(self, words: LineWords, code: Code) -> None:
        """Take the power of the spindle in per cent, whose speed only the machine knows."""
        letter = self._dialect.spindle.power
        if letter and (word := words.take(letter, code.word.written)):
            message = f"{word.written} (power of the spindle in per cent) has no effect here"
            hint = f"give the speed with S beside {code.word.written}"
            self._here.report_warning("word-idle", message, word, hint)

    def _spindle_mode(self, words: LineWords, code: Code) -> None:
        """G96 D S: constant surface speed, at most D rpm. G97 S: rpm."""
        state = self._state
        state.constant_surface = code.number == G.G96
        most = words.take("D", "G96") if state.constant_surface else None
        keeps_limit = self._dialect.turning.lathe or self._dialect.flavour == "siemens"
        if most or not keeps_limit:
            state.most_rpm = not_negative(most, "the highest speed") if most else 0.0
        word = words.take("S", code.word.written)
        # These controls take the S of a later line, if the spindle stands till then.
        if word is None and state.constant_surface and (not keeps_limit or state.spindle != "off"):
            raise fault(
                "spindle-speed-missing",
                f"{code.word.written} needs a speed",
                code.word,
                "give S in m/min (under G20 in feet/min)",
            )
        # A surface speed gives no rpm, so without S under G97 the speed is unknown.
        state.speed = self._speed(word) if word else None

    def _spindle(self, *, with_motion: bool = False) -> None:
        state, here = self._state, self._here
        turning = SPINDLE_STATES.index(state.spindle)
        if self._dialect.flavour == "siemens" and state.most_rpm and not state.constant_surface:
            state.speed = min(state.speed or 0.0, state.most_rpm)
        if state.constant_surface and turning:
            self._out.add(state.surface_speed(here.file, here.line))
        else:
            speed = _rpm_of(turning, state.rpm)
            self._out.add(
                Spindle(here.file, here.line, state.spindle, speed, with_motion=with_motion)
            )

    def _spindle_off(self) -> None:
        if self._state.spindle != "off":
            self._state.spindle = "off"
            self._spindle()

    def _orient(self, words: LineWords) -> None:
        letters = self._dialect.spindle.orient_angle
        angle = next((word for letter in letters if (word := words.take(letter, "M19"))), None)
        timeout = direction_word = None
        if self._dialect.spindle.orient_settings:
            timeout, direction_word = words.take("Q", "M19"), words.take("P", "M19")
        degrees = 0.0 if angle is None else angle.number
        if angle and not 0.0 <= degrees <= 360.0:
            message = f"{angle.written}: the angle must be from 0 to 360 degrees"
            raise fault("value-out-of-range", message, angle)
        if timeout:
            positive(timeout, "the time-out")
        direction: Any = (
            _DIRECTIONS[whole(direction_word, "the direction", 0, 2)]
            if direction_word
            else "shortest"
        )
        self._state.spindle = "off"
        self._out.add(
            Orient(
                self._here.file,
                self._here.line,
                degrees,
                direction,
                timeout.number if timeout else 0.0,
            )
        )

    # Coolant, overrides

    def coolant(self, codes: Codes) -> None:
        """Execute M7, M8, both, or M9."""
        state, given = self._state, codes.get("coolant")
        if given is None:
            return
        for code in (given, codes.get("second-coolant", given)):
            state.mist, state.flood = _coolants_after(state.mist, state.flood, code.number)
        self._coolant()

    def _coolant(self) -> None:
        self._out.add(
            Coolant(self._here.file, self._here.line, self._state.mist, self._state.flood)
        )

    def overrides(self, words: LineWords, codes: Codes) -> None:
        """Execute M48 to M53. P0 switches off; P1 or no P switches on."""
        code = codes.get("overrides")
        if code is None:
            return
        state = self._state
        if code.number in (M.M48, M.M49):
            state.feed_override = state.speed_override = code.number == M.M48
        else:
            word = words.take("P", code.word.written)
            on = word is None or not_negative(word, "the switch") != 0.0
            setattr(state, _OVERRIDE_SWITCHES[code.number], on)
        self.context.add_overrides()

    # Path control

    def path_control(self, words: LineWords, code: Code) -> None:
        """Execute G61, G61.1 or G64. P0 is the exact path.

        Q of G64, a tolerance for merging straight moves, has no effect: P serves both.
        """
        control: PathControl = "blend"
        tolerance = 0.0
        if code.number != G.G64:
            control = "exact-stop" if code.number == G.G61_1 else self._dialect.motion.path_stop
        else:
            for letter in sorted(self._dialect.motion.path_words):
                if word := words.take(letter, "G64"):
                    value = not_negative(word, "the tolerance") * self._state.scale
                    if letter == "P":
                        control, tolerance = "blend" if value > 0.0 else "exact-path", value
        self._state.path, self._state.tolerance = control, tolerance
        self._path()

    def stop_exactly(self, *, on: bool) -> None:
        """Begin or end the exact stop of one line (G9)."""
        if self._state.path == "exact-stop":
            return
        if on:
            self._out.add(PathMode(self._here.file, self._here.line, "exact-stop", 0.0))
        else:
            self._path()

    def _path(self) -> None:
        self._out.add(
            PathMode(self._here.file, self._here.line, self._state.path, self._state.tolerance)
        )

    # State, stop

    def save(self) -> ModalState:
        """Return the modal state, for :meth:`restore`."""
        return replace(self._state)

    def restore(self, saved: ModalState) -> None:
        """Restore a saved state (M72). Blocks report each change outside the interpreter.

        Motion mode, tool, compensation and scaling stay.
        """
        before = self._state
        state = self.context.state = replace(
            saved,
            motion=before.motion,
            radius_increments=before.radius_increments,
            tool=before.tool,
            loaded=before.loaded,
            compensation=before.compensation,
            scaled=before.scaled,
        )
        reports: tuple[tuple[tuple[str, ...], Any], ...] = (
            (("spindle", "speed", "constant_surface", "most_rpm", "rpm_range"), self._spindle),
            (("mist", "flood"), self._coolant),
            (
                ("feed_override", "speed_override", "adaptive_feed", "feed_stop"),
                self.context.add_overrides,
            ),
            (("path", "tolerance"), self._path),
        )
        for names, report in reports:
            if any(getattr(state, name) != getattr(before, name) for name in names):
                report()

    def stop(self, code: Code) -> bool:
        """Execute M0, M1, M60, M2 or M30. The last two also stop spindle and coolant.

        Returns:
            Whether the program ends.
        """
        here, state = self._here, self._state
        if code.number in (M.M0, M.M1, M.M60):
            optional = code.number == M.M1 and not self._policy.optional_stop
            if optional and not self._passed_over:
                self._passed_over = True
                message = "M1 does not stop: the optional stop is off"
                here.report_note(
                    "optional-stop-off", message, code.word, "--optional-stop turns it on"
                )
            self._out.add(
                Stop(here.file, here.line, optional=optional, pallet=code.number == M.M60)
            )
            return False
        self._spindle_off()
        if state.mist or state.flood:
            state.mist = state.flood = False
            self._coolant()
        self._out.add(End(here.file, here.line))
        return True


# Inputs and outputs: M62 to M68.
#
# Source: LinuxCNC, "M-codes".

MAX_CHANNEL = 63
"""Highest number of an input or output."""
KINEMATICS_CHANNEL = 3
"""Analog output that selects the kinematics in LinuxCNC's five-axis configurations."""
_WAIT_MODES: tuple[WaitMode, ...] = ("immediate", "rise", "fall", "high", "low")


class InputOutputCodes(Executor):
    """Execution of the codes of inputs and outputs.

    Args:
        here: the current line.
        out: takes the blocks.
        parameters: takes the answers of inputs.
        tilting: whether the machine has tool-tip control, which an output would select.
    """

    def execute(self, words: LineWords, codes: Codes) -> None:
        """Execute M62 to M68."""
        code = codes.get("input-output")
        if code is None:
            return
        here, number = self._here, code.number
        if number == M.M66:
            self._wait(words, code)
        elif number in (M.M67, M.M68):
            channel, value = self._channel(words, code, "E"), words.take("Q", code.word.written)
            if value is None:
                raise fault(
                    "output-value-missing",
                    f"{code.word.written} needs a Q word",
                    code.word,
                    "give Q and the value",
                )
            if self._policy.tool_tip and channel == KINEMATICS_CHANNEL:
                raise fault(
                    "code-not-supported",
                    f"{code.word.written} E3 selects the kinematics of a LinuxCNC machine",
                    code.word,
                    "give M428 for tool-tip control, M429 for the bare axes",
                )
            self._out.add(
                AnalogOutput(here.file, here.line, channel, value.number, number == M.M67)
            )
        else:
            self._out.add(
                DigitalOutput(
                    here.file,
                    here.line,
                    self._channel(words, code, "P"),
                    number in (M.M62, M.M64),
                    number in (M.M62, M.M63),
                )
            )

    def _channel(self, words: LineWords, code: Code, letter: str) -> int:
        word = words.take(letter, code.word.written)
        if word is None:
            raise fault(
                "channel-missing",
                f"{code.word.written} needs a {letter} word",
                code.word,
                f"give {letter} and the channel's number",
            )
        return whole(word, "the channel", 0, MAX_CHANNEL)

    def _wait(self, words: LineWords, code: Code) -> None:
        here, analog = self._here, "E" in words.rest
        if analog and "P" in words.rest:
            raise fault(
                "channel-missing",
                "M66 takes P or E, not both",
                words.rest["P"],
                "P is a digital input, E an analog one",
            )
        channel = self._channel(words, code, "E" if analog else "P")
        word = words.take("L", "M66")
        mode = _WAIT_MODES[whole(word, "the mode", 0, 4)] if word else "immediate"
        limit = words.take("Q", "M66")
        if word and mode != "immediate":
            if analog:
                raise fault(
                    "wait-analog",
                    f"{word.written}: M66 can't wait for an analog input",
                    word,
                    "give L0",
                )
            if limit is None or limit.number <= 0.0:
                raise fault(
                    "wait-time-missing",
                    f"M66 {word.written} needs a time",
                    limit or word,
                    "give Q and the longest time in seconds",
                )
        seconds = not_negative(limit, "the time") if limit else 0.0
        self._out.ask(
            WaitInput(here.file, here.line, channel, analog, mode, seconds), self._answered
        )

    def _answered(self, answer: tuple[float, ...]) -> None:
        self._parameters.values[INPUT_VALUE] = answer[0]


# G4: a dwell, in seconds, milliseconds or turns of the spindle by the dialect.

_SHORT = 0.1
"""s. A shorter dwell in milliseconds may be meant in seconds."""
_MILLISECOND = 0.001
_HUNDREDTH = 0.01
_dwell_of = interpreted(rules.dwell_of)


class Dwells(Executor):
    """Times of dwells: those of G4, and of cycles."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._hundredths_reported = False

    def execute(self, words: LineWords, code: Code) -> None:
        """Execute G4."""
        word, letters = code.word, self._dialect.dwell.units_in(words)
        times = [
            (letter, time)
            for letter in (*letters, *self._dialect.dwell.turns)
            if (time := words.take(letter, "G4"))
        ]
        if not times:
            raise fault(
                "dwell-time-missing",
                f"{word.written} needs a time",
                word,
                f"give {' or '.join((*letters, *self._dialect.dwell.turns))}",
            )
        if len(times) > 1:
            raise fault("word-wanted-twice", f"{word.written} takes one time only", times[1][1])
        letter, time = times[0]
        seconds = self._turns(time) if letter in self._dialect.dwell.turns else self.seconds(time)
        self._out.add(Dwell(self._here.file, self._here.line, seconds))

    def seconds(self, time: Word) -> float:
        """Return the time of a word, s. A long one is reported, and a short one in milliseconds.

        Raises:
            GcodeError: ``decimal-point-needed``, ``decimal-point-place``, ``value-out-of-range``.
        """
        unit = self._dialect.dwell.units.get(time.letter, 1.0)
        if "." in time.written:
            unit = self._unit_with_point(time, self._dialect.dwell.point.get(time.letter, unit))
        seconds, status = _dwell_of(time.number, unit)
        if status == rules.DWELL_WITHOUT_UNIT:
            message = (
                f"{time.written} without a decimal point is {time.number / 1000:g} s for FANUC"
            )
            raise fault("decimal-point-needed", message, time, f"write {time.written}. for seconds")
        not_negative(time, "the time")
        if status == rules.DWELL_TOO_LONG:
            raise fault(
                "value-out-of-range",
                f"{time.written}: a dwell of {seconds:g} s is more than eleven days",
                time,
            )
        is_short = unit == _MILLISECOND and 0.0 < seconds < _SHORT
        is_hundredths = unit == _HUNDREDTH and seconds > 0.0 and not self._hundredths_reported
        self._hundredths_reported |= is_hundredths
        if (self._dialect.dwell.short_is_doubtful and is_short) or is_hundredths:
            message = (
                f"{time.written} is {seconds:g} s here; controls that count seconds "
                f"take {time.number:g} s"
            )
            hint = f"write {time.letter}{time.number / unit:g} if seconds are meant"
            self._here.report_warning("dwell-short", message, time, hint)
        if status == rules.DWELL_LONG and unit == 1.0 and "." not in time.written:
            message = (
                f"{time.written} is {seconds:g} s here; controls that count milliseconds "
                f"take {seconds / 1000.0:g} s"
            )
            hint = f"write {time.written}. if seconds are meant"
            self._here.report_warning("dwell-long", message, time, hint)
        return seconds

    def _unit_with_point(self, time: Word, unit: float) -> float:
        """Return the unit of a time with a decimal point, s; 0 is a unit that allows no point."""
        if unit:
            return unit
        message = f"{time.written} has a decimal point, which FANUC allows in X only"
        hint = "write whole milliseconds, or name the --dialect"
        if not self._dialect.lenient:
            raise fault("decimal-point-place", message, time, hint)
        self._here.report_warning("dwell-point", f"{message}: it is read as seconds", time, hint)
        return 1.0

    def _turns(self, word: Word) -> float:
        """Return the time of a number of turns of the spindle, s."""
        state = self._state
        if state.spindle == "off" or not state.speed or state.constant_surface:
            message = f"{word.written} counts turns of the spindle, which has no known speed"
            raise fault("spindle-stopped", message, word, "give S and M3, or seconds with F")
        return not_negative(word, "the turns") * 60.0 / state.rpm
