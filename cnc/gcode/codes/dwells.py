"""G4: a dwell, in seconds, milliseconds or turns of the spindle by the dialect."""

from __future__ import annotations

from cnc.gcode.state.context import Context, Executor
from cnc.gcode.state.modal_groups import Code
from cnc.gcode.syntax.words import LineWords, Word, fault, not_negative
from cnc.kernels.gcode import rules
from cnc.kernels.jit import interpreted
from cnc.model.blocks import Dwell

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
        word, letters = code.word, self._dialect.dwell_units(words)
        times = [
            (letter, time)
            for letter in (*letters, *self._dialect.dwell_turns)
            if (time := words.take(letter, "G4"))
        ]
        if not times:
            raise fault(
                "dwell-time-missing",
                f"{word.written} needs a time",
                word,
                f"give {' or '.join((*letters, *self._dialect.dwell_turns))}",
            )
        if len(times) > 1:
            raise fault("word-wanted-twice", f"{word.written} takes one time only", times[1][1])
        letter, time = times[0]
        seconds = self._turns(time) if letter in self._dialect.dwell_turns else self.seconds(time)
        self._out.add(Dwell(self._here.file, self._here.line, seconds))

    def seconds(self, time: Word) -> float:
        """Return the time of a word, s. A long one is reported, and a short one in milliseconds.

        Raises:
            GcodeError: ``decimal-point-needed``, ``decimal-point-place``, ``value-out-of-range``.
        """
        unit = self._dialect.dwell.get(time.letter, 1.0)
        if "." in time.written:
            unit = self._unit_with_point(time, self._dialect.dwell_point.get(time.letter, unit))
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
        if (self._dialect.flavour == "macro-b" and is_short) or is_hundredths:
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
        return not_negative(word, "the turns") * 60.0 / state.speed
