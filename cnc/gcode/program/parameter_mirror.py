"""The parameters of a program as arrays, for compiled code (:mod:`cnc.kernels.gcode.program`)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.gcode.syntax.parameters import LOCAL, Parameters
from cnc.kernels.gcode.evaluation import Parameters as Values
from cnc.kernels.gcode.program_text import Changes, Frames
from cnc.kernels.gcode.statements import LAST_PARAMETER

_SET, _OF_INTERPRETER = 1, 2
"""Flags: compiled code has set the parameter; it must not, because a function shows it."""


class ParameterMirror:
    """Copies parameters into arrays, and changed ones back. Names have slots in an array."""

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self._calls = parameters.calls
        self._names: list[str] = []
        self._slots: dict[str, int] = {}
        self._left_alone: set[str] = set()
        self._named = np.full(64, math.nan)
        self._numbered = np.zeros(LAST_PARAMETER + 1)
        self._changes = Changes(
            np.zeros(LAST_PARAMETER + 1, np.uint8), np.zeros(len(self._named), np.uint8)
        )
        # A place that is no parameter.
        self._numbered[0], self._changes.numbered[0] = math.nan, _OF_INTERPRETER
        # All others are 0.
        for number in parameters.known_numbers(LAST_PARAMETER):
            self._read(number)
        parameters.changed = set()

    def slots(self, found: list[tuple[str, bool]]) -> NDArray[np.int32]:
        """Return the slot of each name; new names get new slots.

        Args:
            found: The names, and whether compiled code may set each.
        """
        names, known = [name for name, _ in found], self._slots
        new = [name for name in dict.fromkeys(names) if name not in known]
        begin = len(self._names)
        known.update(zip(new, range(begin, begin + len(new)), strict=True))
        self._names += new
        while len(self._named) < len(self._names):
            self._grow()
        for name in self._parameters.known_among(new):
            self._read(name)
        for name, may_set in found:
            if not may_set:
                self._left_alone.add(name)
                self._changes.named[known[name]] = _OF_INTERPRETER
        return np.fromiter(map(known.__getitem__, names), np.int32, len(names))

    def load(self, slots: NDArray[np.int32]) -> tuple[Values, Changes]:
        """Return the values of all parameters.

        Args:
            slots: Slots of the names of the text.
        """
        parameters = self._parameters
        changed = parameters.changed
        assert changed is not None
        if parameters.calls != self._calls:
            self._calls = parameters.calls
            changed.update(range(1, LOCAL + 1))
            changed.update(name for name in self._names if not name.startswith("_"))
        for key in changed:
            if isinstance(key, str) or key <= LAST_PARAMETER:
                self._read(key)
        changed.clear()
        return Values(self._numbered, self._named, slots), self._changes

    def local_slots(self, slots: NDArray[np.int32]) -> NDArray[np.int32]:
        """Return the slots of the names that belong to their call."""
        known = np.unique(slots).tolist()
        return np.array([slot for slot in known if self._names[slot][0] != "_"], np.int32)

    def restore(self, frames: Frames, depth: int) -> None:
        """Copy the local parameters of a caller back, before its call is entered."""
        flags, values = frames.numbered_changes[depth], frames.numbered[depth]
        for number in np.flatnonzero(flags == _SET).tolist():
            self._parameters.store_value(number, float(values[number]))
        flags, values = frames.named_changes[depth], frames.named[depth]
        for place in np.flatnonzero(flags == _SET).tolist():
            name = self._names[int(frames.slot[place])]
            self._parameters.store_value(name, float(values[place]))

    def store(self) -> None:
        """Copy the parameters that compiled code has set back."""
        store, names = self._parameters.store_value, self._names
        numbered, named = self._changes
        for number in np.flatnonzero(numbered == _SET).tolist():
            store(number, float(self._numbered[number]))
        numbered[numbered == _SET] = 0
        found = np.flatnonzero(named == _SET)
        self._parameters.store_names(
            [names[slot] for slot in found.tolist()], self._named[found].tolist()
        )
        named[found] = 0

    def _read(self, key: int | str) -> None:
        """Copy one parameter."""
        values, flags, place = self._numbered, self._changes.numbered, key
        if isinstance(place, str):
            values, flags = self._named, self._changes.named
            if place not in self._slots:
                return
            place = self._slots[place]
        values[place] = self._parameters.stored_value(key)
        is_left = self._parameters.is_bound(key) or key in self._left_alone
        flags[place] = _OF_INTERPRETER if is_left else 0

    def _grow(self) -> None:
        more = len(self._named)
        self._named = np.concatenate((self._named, np.full(more, math.nan)))
        self._changes = Changes(
            self._changes.numbered, np.concatenate((self._changes.named, np.zeros(more, np.uint8)))
        )
