"""A machine as a session operates it, whatever its board: readings, jogs, offsets."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from cnc.boards.protocols import LineSink, PulseSink
from cnc.executor.run import Progress
from cnc.machine.models import Machine
from cnc.model.operator_control import Control
from cnc.operate.events import MachineState
from cnc.operate.jogging import JogMove

STATE_PERIOD = 0.1
"""Time between two states, s."""


@dataclass(frozen=True, slots=True)
class Readings:
    """Readings of a machine.

    Attributes:
        position: Machine position by axis, mm.
        state: Its state.
        homed: Whether each axis is homed; empty for a machine without homing.
        feed: mm/min; None if it is not reported.
        spindle: rev/min; None if it is not reported.
        inputs: Active inputs by name.
        overrides: Of feed, traverses and spindle, per cent; None if not reported.
    """

    position: dict[str, float] = field(default_factory=dict)
    state: MachineState = "idle"
    homed: dict[str, bool] = field(default_factory=dict)
    feed: float | None = None
    spindle: float | None = None
    inputs: dict[str, bool] = field(default_factory=dict)
    overrides: tuple[float, float, float] | None = None


class OperatedMachine(Protocol):
    """A machine at rest, and its jogs. All methods may raise BoardError.

    Attributes:
        board: The board.
        machine: The machine, with the travel of the board.
        rest: Time that a stop of a jog may take itself, s.
        pause: Time until the worker looks for a next task after a poll, s.
        stops_outputs: Whether spindle and coolant stop at the end of a program without M5 and M9.
    """

    @property
    def board(self) -> PulseSink | LineSink:
        """The board."""

    machine: Machine
    rest: float
    pause: float
    stops_outputs: bool

    def readings(self) -> Readings:
        """Return the present readings."""

    def of_progress(self, progress: Progress) -> Readings:
        """Return the readings during a run."""

    def poll(self) -> None:
        """Exchange reports with the board at rest, for at most some hundredths of a second."""

    def home(self, axes: Sequence[str], control: Control) -> None:
        """Home axes; all that have a switch if there are none."""

    def jog(self, move: JogMove, control: Control, on_report: Callable[[Readings], None]) -> None:
        """Jog until the end point, or until ``control`` holds; return at rest."""

    def offsets(self) -> dict[str, dict[str, float]]:
        """Return the offsets by name (G54 to G59.3, G92) and axis, mm."""

    def set_work_position(self, system: str, values: Mapping[str, float]) -> None:
        """Set the offset of a system so that the axes stand at work positions, mm."""

    def keep_shift(self, parameters: Mapping[int, float]) -> None:
        """Keep the shift of G92 that an entered line has left, by the parameters at its end."""

    def revive(self) -> None:
        """Make the board ready for the next activity."""

    def unlock(self, *, at_switch: bool) -> None:
        """Leave an alarm without homing; ``at_switch``: also where a limit switch is pressed."""

    def for_jogs(self) -> Machine:
        """Return the machine with the limits that hold for a jog."""
