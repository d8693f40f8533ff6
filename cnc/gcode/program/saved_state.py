"""The saved modal state of each call: M70 to M73."""

from __future__ import annotations

from cnc.gcode.codes.machine_codes import MachineCodes
from cnc.gcode.codes.motion import Motion
from cnc.gcode.state.modal_groups import Code, ModalState
from cnc.gcode.state.unused_words import UnusedWords
from cnc.gcode.syntax.code_numbers import M
from cnc.gcode.syntax.words import Word, fault

_Saved = tuple[ModalState, tuple[int, list[float]]]


class SavedState:
    """Saves and restores the modal state. Each call has a saved state of its own."""

    def __init__(
        self,
        machine_codes: MachineCodes,
        modal: ModalState,
        motion: Motion,
        unused_words: UnusedWords,
    ) -> None:
        self._machine_codes = machine_codes
        self._modal = modal
        self._motion = motion
        self._unused_words = unused_words
        self._saved: list[_Saved | None] = [None]
        self._restore_at_return: list[bool] = [False]

    @property
    def calls(self) -> int:
        """Number of calls within each other."""
        return len(self._saved) - 1

    def enter(self) -> None:
        """Begin a call."""
        self._saved.append(None)
        self._restore_at_return.append(False)

    def leave(self) -> bool:
        """End a call; return whether M73 had saved a state in it, which is restored."""
        saved = self._saved.pop()
        if self._restore_at_return.pop() and saved is not None:
            self._restore(saved)
            return True
        return False

    def execute(self, code: Code) -> None:
        """Execute M70 and M73 (save), M71 (discard) or M72 (restore).

        Raises:
            GcodeError: ``state-not-saved``, ``compensation-active``.
        """
        if code.number in (M.M70, M.M73):
            self._saved[-1] = self._machine_codes.save(), self._motion.coordinates.save()
            self._restore_at_return[-1] = code.number == M.M73
        elif code.number == M.M71:
            self._saved[-1] = None
        else:
            saved = self._saved[-1]
            if saved is None:
                hint = "save it with M70 before, in the same program or subprogram"
                raise fault("state-not-saved", "M72 without a saved state", code.word, hint)
            self._restore(saved, code.word)

    def _restore(self, saved: _Saved, at: Word | None = None) -> None:
        modal, system = saved
        coordinates = self._motion.coordinates
        if self._motion.compensated and (
            modal.plane != self._modal.plane or system != coordinates.save()
        ):
            message = "the saved plane or coordinate system differs, and cutter compensation is on"
            raise fault("compensation-active", message, at, "write G40 and a move before")
        self._machine_codes.restore(modal)
        self._unused_words.words.clear()
        coordinates.restore(system)
        self._motion.units_changed()
