"""Outputs of a Klipper board: spindle, coolant, motor drivers; repeated while they are on.

The board switches an output off by itself when it hears nothing of it for MAX_DURATION_S. So each
output that is on is repeated, and a computer that dies leaves no spindle running. For the same
reason nothing is sent more than AHEAD_S before its time: a change that belongs to later motion is
kept back until that motion is played.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from cnc.boards.klipper.connection import Connection
from cnc.boards.klipper.layout import MAX_DURATION_S, Layout, OutputObject
from cnc.boards.protocols import Action
from cnc.boards.pulse_board import OutputState
from cnc.machine.klipper import KlipperBoard

AHEAD_S = 0.1
"""Time from a command to the change of an output."""
LEAST_AHEAD_S = 0.02
"""Time from a late repetition to its effect."""
REPEAT_S = 0.25 * MAX_DURATION_S
"""Time between two repetitions."""


def actions(table: KlipperBoard | None) -> frozenset[Action]:
    """Return the actions that a board with these pins supports between moves."""
    possible: set[Action] = set()
    if table is not None and table.spindle is not None:
        possible.add("spindle")
        if table.spindle.backward is not None:
            possible.add("spindle backward")
    if table is not None and table.flood is not None:
        possible.add("flood")
    if table is not None and table.mist is not None:
        possible.add("mist")
    return frozenset(possible)


def share_of(state: OutputState, output: OutputObject) -> float:
    """Return the share of full power of an output in a state."""
    match output.name:
        case "spindle":
            on = state.spindle != "off"
            return (state.share if output.pwm else 1.0) if on else 0.0
        case "backward":
            return float(state.spindle == "ccw")
        case "enable":
            return float(state.enabled)
        case name:
            return float(getattr(state, name))


class Outputs:
    """Schedules the outputs.

    Args:
        connection: The connection.
        layout: The objects of the board.
        on_entry: Called with the clock of each entry in the board's queue.

    Attributes:
        state: State after everything that was set.
    """

    def __init__(
        self, connection: Connection, layout: Layout, on_entry: Callable[[int], None]
    ) -> None:
        self.state = OutputState()
        self._connection = connection
        self._outputs = layout.outputs
        self._on_entry = on_entry
        self._values: dict[int, int | None] = {each.oid: None for each in layout.outputs}
        self._at: dict[int, int] = dict.fromkeys(self._values, 0)
        self._later: deque[tuple[int, OutputState]] = deque()

    @property
    def waits(self) -> bool:
        """Whether a state waits for its motion."""
        return bool(self._later)

    def set(self, state: OutputState, clock: int) -> None:
        """Schedule a state at a clock, and discard those that wait."""
        self._later.clear()
        self.state = state
        self._schedule_all(state, clock)

    def set_in_motion(self, state: OutputState, time_ns: int) -> None:
        """Set a state when the board plays the motion at a time of the program, ns."""
        self.state = state
        self._later.append((time_ns, state))

    def release(self, clock_of: Callable[[int], int]) -> None:
        """Schedule the states whose motion is played soon; ``clock_of``: clock of a time, ns."""
        ticks = self._connection.board_clock
        now = ticks.at(self._connection.clock.now())
        while self._later:
            time_ns, state = self._later[0]
            clock = clock_of(time_ns)
            if clock > now + round(AHEAD_S * ticks.frequency):
                return
            self._later.popleft()
            self._schedule_all(state, max(clock, now + round(LEAST_AHEAD_S * ticks.frequency)))

    def _schedule_all(self, state: OutputState, clock: int) -> None:
        for output in self._outputs:
            value = output.value(share_of(state, output))
            if value != self._values[output.oid]:
                self._repeat_until(output, clock)
                self._schedule(output, value, clock)

    def forget(self) -> None:
        """Forget the values, because the board has set its outputs itself."""
        self._later.clear()
        self.state = OutputState()
        for oid in self._values:
            self._values[oid] = None

    def repeat(self) -> None:
        """Repeat the outputs that are on and are due."""
        ticks = self._connection.board_clock
        clock = ticks.at(self._connection.clock.now()) + round(AHEAD_S * ticks.frequency)
        for output in self._outputs:
            self._repeat_until(output, clock)

    def _repeat_until(self, output: OutputObject, clock: int) -> None:
        value = self._values[output.oid]
        if not output.limited or value is None or value == output.value(0.0):
            return
        ticks = self._connection.board_clock
        period = round(REPEAT_S * ticks.frequency)
        # After a standstill of this computer, the time of a repetition may be over.
        soon = ticks.at(self._connection.clock.now()) + round(LEAST_AHEAD_S * ticks.frequency)
        while clock - self._at[output.oid] > period:
            self._schedule(output, value, max(self._at[output.oid] + period, soon))

    def _schedule(self, output: OutputObject, value: int, clock: int) -> None:
        at = max(clock, self._at[output.oid] + 1)
        self._values[output.oid], self._at[output.oid] = value, at
        if output.pwm:
            self._connection.send("queue_pwm_out", oid=output.oid, clock=at % 2**32, value=value)
        else:
            self._connection.send(
                "queue_digital_out", oid=output.oid, clock=at % 2**32, on_ticks=value
            )
        self._on_entry(at)
