"""Faults of an open board: the first one ends its use, those of a thread are raised by a call."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from cnc.boards.errors import board_error
from cnc.boards.loopback import Loopback
from cnc.boards.protocols import MotionState
from cnc.model.diagnostics import BoardError
from cnc.model.operator_control import Control


class PulseSupervisor(ABC):
    """An open board, whose every message is checked.

    Args:
        checks: Checks of all pulses before they are sent, and their counts.

    Attributes:
        checks: The checks.
        active: A program runs, so that alarms and resets are faults.
        probing: An armed input may end the motion.
        stopped_short: The board is elsewhere than the pulses sent lead to.
        fault: The fault that ended the use of the board.
        pending_fault: A fault of the background thread, not raised yet.
        control: Requests of the operator.
    """

    def __init__(self, checks: Loopback) -> None:
        self.checks = checks
        self.active = self.probing = self.stopped_short = False
        self.fault: BoardError | None = None
        self.pending_fault: BoardError | None = None
        self.control: Control | None = None

    @property
    @abstractmethod
    def confirmed_line(self) -> int:
        """Source line that the board has reached for certain."""

    @property
    @abstractmethod
    def grid_point(self) -> NDArray[np.int64]:
        """Grid point at the end of what was sent (axes,), or where the board stopped."""

    @property
    @abstractmethod
    def known_steps(self) -> tuple[int | None, ...]:
        """Grid point of each axis, None where it is not known."""

    @property
    @abstractmethod
    def motion_state(self) -> MotionState:
        """State of the motion."""

    @abstractmethod
    def pump(self, seconds: float) -> object:
        """Send, receive, and raise all faults; wait at most ``seconds`` for bytes."""

    @abstractmethod
    def halt(self) -> None:
        """Come to rest on the path, and take over the position."""

    @abstractmethod
    def close_port(self) -> None:
        """Close the port."""

    def pump_in_background(self) -> None:
        """Exchange bytes between calls; a fault ends a hold and is raised by the next call."""
        if self.fault is None:
            try:
                self.pump(0.0)
            except BoardError as error:
                self.pending_fault = error
                if self.control is not None:
                    self.control.stop()  # A thread that waits for the end of a hold must wake up.

    def raise_pending(self) -> None:
        """Raise a fault of the background thread."""
        if self.pending_fault is not None:
            error, self.pending_fault = self.pending_fault, None
            raise error

    def refuse_after_fault(self) -> None:
        """Raise a pending fault, and refuse calls after a fault."""
        self.raise_pending()
        if self.fault is not None:
            raise board_error("board-stopped", "the board has been stopped", hint="open it again")

    def fail(self, error: BoardError) -> BoardError:
        """End the use of the board by a fault, and return the fault."""
        if self.fault is None:
            self.fault = error
        self.checks.abort()
        self.active = False
        return error
