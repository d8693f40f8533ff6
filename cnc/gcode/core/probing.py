"""Probing moves: G38.2 to G38.5, and G31 of FANUC, Haas and Mach3.

The program continues from the contact (or its loss), which only the board reports; without a board,
from the end of the move. The contact in program coordinates and units is stored in #5061 to #5069,
and in #5070 whether there was one. G31 is a G38.3 that is not modal: without contact the program
goes on from the end of the move. Haas' M78 and M79, in its line or a later one, are alarms at a
contact and without one. Source: LinuxCNC 2.9, "G-codes", G38.n; FANUC Series 0i, "Skip function
(G31)"; "Using Mach3Mill", G31; Haas, "Mill Operator's Manual", M78 and M79.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cnc.gcode.core.cycle_runner import refuse_axes, refuse_modes
from cnc.gcode.core.modal_groups import Code
from cnc.gcode.core.motion import Motion, MotionCodes
from cnc.gcode.reader.words import G, LineWords, M, fault
from cnc.model.blocks import AXIS_LETTERS, ROTARY_LETTERS, Probe
from cnc.model.parameter_numbers import PROBE_CONTACT, PROBE_POSITION

PROBES = {
    G.G31: (True, False),
    G.G38_2: (True, True),
    G.G38_3: (True, False),
    G.G38_4: (False, True),
    G.G38_5: (False, False),
}
"""For each code: whether it moves towards the workpiece, and whether no contact is an error."""
LINEAR = "XYZUVW"


class Probing(MotionCodes):
    """Execution of probing moves: the handlers of G38.2 to G38.5 and G31, and their alarms."""

    def __init__(self, motion: Motion) -> None:
        super().__init__(motion)
        self._copies = self._dialect.variables.contact
        self._ends_motion = self._dialect.home.probe_ends_motion
        self._alarm: Callable[[], None] | None = None
        motion.handlers |= dict.fromkeys(PROBES, self.probe)

    def probe(self, words: LineWords, code: Code | None) -> None:
        """Make one probing move."""
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
                "give the end of the probing move, such as Z-10",
            )
        refuse_axes(words, name, LINEAR)
        end = motion.target(words, name, motion.position)
        towards, must = PROBES[state.motion]
        if state.motion == G.G31:
            # In FANUC's group 00 the code before it stays. Others' manuals do not say.
            state.motion = None if self._ends_motion else motion.motion_before
        if must and end == motion.position:
            raise fault(
                "probe-length", f"{name} has no length: its end is the present position", at
            )
        feed = motion.feed(words, end, motion.distance(end), at)
        # G38.3 and G38.5 may end without contact: a loop that clears the probe starts clear.
        if end == motion.position:
            self._found((0.0, *end))
            motion.compensation.led_out()
            return
        block = Probe(here.file, here.line, np.array(end), feed, towards, must)
        self._out.ask(block, self._found)
        motion.compensation.led_out()

    def _found(self, answer: tuple[float, ...]) -> None:
        """Store the answer of the board: whether there was contact, and its machine position."""
        motion, values = self._motion, self._parameters.values
        motion.position = list(answer[1:])
        program = motion.coordinates.to_program(motion.position)
        for place, letter in enumerate(AXIS_LETTERS):
            number = 0.0
            if letter in motion.axes:
                number = program[motion.axes.index(letter)]
                number /= 1.0 if letter in ROTARY_LETTERS else self._state.scale
            values[PROBE_POSITION + place] = number
            if self._copies:
                values[self._copies + place] = number
        values[PROBE_CONTACT] = answer[0]
        if alarm := self._alarm:
            self._alarm = None
            alarm()

    def alarm(self, code: Code) -> None:
        """Execute M78 or M79: stop if the last move made contact, or if it made none.

        In the line of the move this waits for the board. An assumed answer stops nothing.
        """
        out, values, here = self._out, self._parameters.values, self._here
        at_contact = code.number == M.M78
        contact, hint = "no", "check the end point of the move, and whether a workpiece is there"
        if at_contact:
            contact, hint = "a", "see what the probe touched; clear it before the next run"
        error = fault(
            "probe-alarm", f"{code.word.written}: the probe made {contact} contact", code.word, hint
        ).at(file=here.file, line=here.line, text=here.text)

        def check() -> None:
            if not out.assumed and (values.get(PROBE_CONTACT, 0.0) != 0.0) == at_contact:
                raise error

        if out.unanswered:
            self._alarm = check
        else:
            check()
