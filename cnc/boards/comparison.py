"""Comparison of a board with what the machine file and its firmware say of it."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from cnc.machine.models import Machine
from cnc.model.diagnostics import Diagnostic


@runtime_checkable
class ComparesItself(Protocol):
    """A board that knows where it differs from what is said of it."""

    def unlike(self, machine: Machine) -> list[Diagnostic]:
        """Return warnings where the board differs from the machine file, or from its firmware."""
