"""Programs that are certain never to end, because their whole state comes back.

A program without an answer of the board does the same from the same state. So a state that comes
back at the same line comes back for ever. The states are compared by Brent's method: one state is
kept for twice as many samples each time.
"""

from __future__ import annotations

from dataclasses import replace

from cnc.gcode.program.call_stack import Flow

FIRST_LINES = 8192
"""Repeated lines before the first state is kept: most loops end before."""

_State = tuple[object, ...]


class RepeatedStates:
    """Compares the states of a program at its lines, from time to time."""

    def __init__(self, flow: Flow) -> None:
        self._flow = flow
        self._line = 0
        self._kept: _State = ()
        self._samples, self._most = 0, 1

    def comes_back(self, line: int) -> bool:
        """Return whether the state before a line is one that the program had there before."""
        flow = self._flow
        if flow.executed - flow.new < FIRST_LINES or flow.interpreter.out.asked:
            return False
        if line == self._line and self._kept == self._state():
            return True
        self._samples += 1
        if self._samples >= self._most:
            self._line, self._kept = line, self._state()
            self._samples, self._most = 0, 2 * self._most
        return False

    def _state(self) -> _State:
        """Everything that decides how the program goes on."""
        flow = self._flow
        interpreter = flow.interpreter
        calls = [
            (id(frame.listing), frame.scope, id(frame.caller), frame.return_line,
             frame.rounds, dict(frame.counts))
            for frame in (*flow.frames, flow.frame)
        ]  # fmt: skip
        position, coordinates = list(interpreter.motion.position), interpreter.coordinates
        low, high = [0.0] * len(position), [1.0] * len(position)
        return (
            id(flow.listing),
            calls,
            flow.value,
            [(section.first, section.repeats_left) for section in flow.sections],
            flow.parameters.state(),
            replace(interpreter.modal),
            position,
            # Offsets, rotations and scales in effect.
            [coordinates.to_program(place) for place in (position, low, high)],
            list(interpreter.tool_codes.table),
        )
