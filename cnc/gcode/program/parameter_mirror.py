"""The parameters of a program as arrays, for compiled code (:mod:`cnc.kernels.gcode.program`)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cnc.gcode.reader.lines import names_space
from cnc.gcode.syntax.parameters import LOCAL, Parameters
from cnc.kernels.gcode.evaluation import Parameters as Values
from cnc.kernels.gcode.program_text import Changes, Frames
from cnc.kernels.gcode.statements import LAST_PARAMETER, Names, add_names

_SET, _OF_INTERPRETER = 1, 2
"""Flags: compiled code has set the parameter; it must not, because a function shows it."""
_FEW_NAMES, _FEW_BYTES = 64, 1024
_GLOBAL = ord("_")


class ParameterMirror:
    """Copies parameters into arrays, and changed ones back. Names have slots in an array.

    The names that compiled code has set are copied back when the interpreter asks for a name. Every
    name that the interpreter knows has a slot, so a new name of a text has no value yet.
    """

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self._calls = parameters.calls
        self._known = names_space(_FEW_NAMES)
        self._text = np.empty(_FEW_BYTES, np.uint8)
        self._slots: dict[str, int] = {}
        self._named = np.full(_FEW_NAMES, math.nan)
        self._left_alone = np.zeros(_FEW_NAMES, np.bool_)
        self._numbered = np.zeros(LAST_PARAMETER + 1)
        self._changes = Changes(
            np.zeros(LAST_PARAMETER + 1, np.uint8), np.zeros(_FEW_NAMES, np.uint8)
        )
        # A place that is no parameter.
        self._numbered[0], self._changes.numbered[0] = math.nan, _OF_INTERPRETER
        # All others are 0.
        for number in parameters.known_numbers(LAST_PARAMETER):
            self._read(number)
        for name in parameters.known_names():
            self._read(name)
        parameters.changed = set()

    def slots(
        self, text: bytes, names: Names, left_alone: list[bool] | None = None
    ) -> NDArray[np.int32]:
        """Return the slot of each name; new names get new slots.

        Args:
            text: A text with the names.
            names: Their places in it.
            left_alone: Whether compiled code must not set each; None for none.
        """
        found = np.empty(len(names.begin), np.int32)
        self._grow(len(found), int((names.end - names.begin).sum()))
        data = np.frombuffer(text, np.uint8)
        add_names(data, names.begin, names.end, self._text, self._known, found)
        if left_alone is not None:
            self._left_alone[found[left_alone]] = True
            self._changes.named[found[left_alone]] = _OF_INTERPRETER
        return found

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
            changed.update(parameters.known_names())
            local = np.flatnonzero(self._is_local())
            self._named[local] = math.nan
            self._changes.named[local] = _OF_INTERPRETER * self._left_alone[local]
        for key in changed:
            if isinstance(key, str) or key <= LAST_PARAMETER:
                self._read(key)
        changed.clear()
        return Values(self._numbered, self._named, slots), self._changes

    def local_slots(self, slots: NDArray[np.int32]) -> NDArray[np.int32]:
        """Return the slots of the names that belong to their call."""
        known = np.unique(slots)
        return known[self._is_local()[known]]

    def restore(self, frames: Frames, depth: int) -> None:
        """Copy the local parameters of a caller back, before its call is entered."""
        flags, values = frames.numbered_changes[depth], frames.numbered[depth]
        for number in np.flatnonzero(flags == _SET).tolist():
            self._parameters.store_value(number, float(values[number]))
        places = np.flatnonzero(frames.named_changes[depth] == _SET)
        self._store_names(frames.slot[places], frames.named[depth][places])

    def store(self) -> None:
        """Copy the numbers that compiled code has set back, and note that names may be set."""
        store, numbered = self._parameters.store_value, self._changes.numbered
        for number in np.flatnonzero(numbered == _SET).tolist():
            store(number, float(self._numbered[number]))
        numbered[numbered == _SET] = 0
        self._parameters.unstored = self._store_set_names

    def _store_set_names(self) -> None:
        """Copy the names that compiled code has set back."""
        self._parameters.unstored = None
        slots = np.flatnonzero(self._changes.named == _SET)
        self._store_names(slots, self._named[slots])
        self._changes.named[slots] = 0

    def _store_names(self, slots: NDArray[np.integer], values: NDArray[np.float64]) -> None:
        spans = map(slice, self._known.begin[slots].tolist(), self._known.end[slots].tolist())
        text = self._text.data
        for span, value in zip(spans, values.tolist(), strict=True):
            self._parameters.store_value(bytes(text[span]).decode(), value)

    def _is_local(self) -> NDArray[np.bool_]:
        """Return for each slot whether its name belongs to its call."""
        first: NDArray[np.uint8] = self._text[self._known.begin[: self._known.used[0]]]
        return np.not_equal(first, _GLOBAL)

    def _read(self, key: int | str) -> None:
        """Copy one parameter."""
        values, flags, place, is_left = self._numbered, self._changes.numbered, key, False
        if isinstance(place, str):
            place = self._slot(place)
            values, flags, is_left = self._named, self._changes.named, self._left_alone[place]
        values[place] = self._parameters.stored_value(key)
        flags[place] = _OF_INTERPRETER if is_left or self._parameters.is_bound(key) else 0

    def _slot(self, name: str) -> int:
        """Return the slot of a name that the interpreter knows."""
        if name not in self._slots:
            text = name.encode()
            place = Names(np.zeros(1, np.int32), np.array([len(text)], np.int32), *self._known[2:])
            self._slots[name] = int(self.slots(text, place)[0])
        return self._slots[name]

    def _grow(self, names: int, size: int) -> None:
        """Make space for more names, of ``size`` bytes in all."""
        known, used = self._known, int(self._known.used[0])
        end = int(known.end[used - 1]) if used else 0
        # A known name stands behind the others while it is looked up.
        if end + size > len(self._text):
            self._text = np.concatenate((self._text, np.empty(end + size, np.uint8)))
        if used + names <= len(known.begin):
            return
        more = len(known.begin) + names
        self._known = names_space(len(known.begin) + more)
        begins, ends = known.begin[:used], known.end[:used]
        text = self._text.copy()
        add_names(text, begins, ends, self._text, self._known, np.empty(used, np.int32))
        self._named = np.concatenate((self._named, np.full(more, math.nan)))
        self._left_alone = np.concatenate((self._left_alone, np.zeros(more, np.bool_)))
        self._changes = self._changes._replace(
            named=np.concatenate((self._changes.named, np.zeros(more, np.uint8)))
        )
