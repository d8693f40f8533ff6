"""Probing: G38.2 to G38.5.

The program goes on from where contact was made (or lost), which only the board can tell; without
one it is the end of the move. Contact in program coordinates and units is left in #5061 to #5069,
and in #5070 whether there was any. Source: LinuxCNC 2.9, "G-codes", G38.n.
"""

from __future__ import annotations

import numpy as np

from cnc.gcode.codes.motion import Motion
from cnc.gcode.cycles.cycle_runner import refuse_axes, refuse_modes
from cnc.gcode.state.block_buffer import BlockBuffer
from cnc.gcode.state.modal_groups import Code, ModalState
from cnc.gcode.state.source_location import SourceLocation
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.parameters import Parameters
from cnc.gcode.syntax.words import LineWords, fault
from cnc.model.blocks import AXIS_LETTERS, ROTARY_LETTERS, Probe
from cnc.model.parameter_numbers import PROBE_CONTACT, PROBE_POSITION

PROBES = {
    G.G38_2: (True, True),
    G.G38_3: (True, False),
    G.G38_4: (False, True),
    G.G38_5: (False, False),
}
"""Of each code: whether towards the work, and whether it is an error to find nothing."""
LINEAR = "XYZUVW"


def register(
    motion: Motion,
    state: ModalState,
    here: SourceLocation,
    out: BlockBuffer,
    parameters: Parameters,
) -> None:
    """Let ``motion`` make G38.2 to G38.5."""
    made = Probing(motion, state, here, out, parameters)
    motion.handlers |= dict.fromkeys(PROBES, made.probe)


class Probing:
    """Makes the lines of G38.2 to G38.5."""

    def __init__(
        self,
        motion: Motion,
        state: ModalState,
        here: SourceLocation,
        out: BlockBuffer,
        parameters: Parameters,
    ) -> None:
        self._motion = motion
        self._state = state
        self._here = here
        self._out = out
        self._parameters = parameters

    def probe(self, words: LineWords, code: Code | None) -> None:
        """One probing move."""
        motion, state, here = self._motion, self._state, self._here
        assert state.motion is not None
        name = state.motion.written
        at = code.word if code else words.first()
        refuse_modes(motion, state, name, at, inverse_time=False)
        if state.feed_mode == "per-revolution":
            raise fault("probe-feed-mode", f"{name} under G95", at, "give G94 and F before")
        if not words.has_axis():
            raise fault(
                "axis-words-missing",
                f"{name} needs axis words",
                at,
                "give how far to probe at most, such as Z-10",
            )
        refuse_axes(words, name, LINEAR)
        end = motion.target(words, name, motion.position)
        towards, must = PROBES[state.motion]
        if must and end == motion.position:
            raise fault(
                "probe-length", f"{name} to where the probe is: nothing can be found on the way", at
            )
        feed = motion.feed(words, end, motion.distance(end), at)
        if (
            end == motion.position
        ):  # G38.3 and G38.5 may find nothing: loops that clear a probe begin where it is clear
            self._found((0.0, *end))
            motion.compensation.led_out()
            return
        block = Probe(here.file, here.line, np.array(end), feed, towards, must)
        self._out.ask(block, self._found)
        motion.compensation.led_out()

    def _found(self, answer: tuple[float, ...]) -> None:
        """Take in what the board (or nobody) answered: whether there was contact, and the machine
        position of it.
        """
        motion, values = self._motion, self._parameters.values
        motion.position = list(answer[1:])
        program = motion.coordinates.to_program(motion.position)
        for place, letter in enumerate(AXIS_LETTERS):
            number = 0.0
            if letter in motion.axes:
                number = program[motion.axes.index(letter)]
                number /= 1.0 if letter in ROTARY_LETTERS else self._state.scale
            values[PROBE_POSITION + place] = number
        values[PROBE_CONTACT] = answer[0]
