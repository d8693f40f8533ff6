"""Inputs and outputs: M62 to M68.

Source: LinuxCNC, "M-codes".
"""

from __future__ import annotations

from cnc.gcode.state.context import Context, Executor
from cnc.gcode.state.modal_groups import Code, Codes
from cnc.gcode.syntax.code_numbers import M
from cnc.gcode.syntax.words import LineWords, fault, not_negative, whole
from cnc.model.blocks import AnalogOutput, DigitalOutput, WaitInput, WaitMode
from cnc.model.parameter_numbers import INPUT_VALUE

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

    def __init__(self, context: Context, *, tilting: bool) -> None:
        super().__init__(context)
        self._tilting = tilting

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
            if self._tilting and channel == KINEMATICS_CHANNEL:
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
