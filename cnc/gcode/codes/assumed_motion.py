"""The motion of axis words without a motion code: at the start of a program and after G80.

FANUC and Haas go on with the motion code of group 1 that was in effect before the cycle; LinuxCNC
has none after G80 (``no motion``), and refuses the axis words.
"""

from __future__ import annotations

from cnc.gcode.dialects import Dialect
from cnc.gcode.state.modal_groups import PLAIN_MOTIONS, ModalState
from cnc.gcode.state.source_location import SourceLocation
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.words import Word
from cnc.kernels.gcode.rules import motion_after_cancel
from cnc.kernels.jit import interpreted

_motion_after_cancel = interpreted(motion_after_cancel)
_HIGHEST = {"none": -1, "assumed": -1, "previous": PLAIN_MOTIONS.index(G.G3)}
_STRAIGHT = PLAIN_MOTIONS.index(G.G1)


class AssumedMotion:
    """Knows the motion code before a cycle.

    Attributes:
        restored: Highest of G0 to G3 to which G80 returns, -1 for none.
        resting: The last of G0 to G3 that was in effect, None for none.
    """

    def __init__(self, dialect: Dialect, here: SourceLocation, state: ModalState) -> None:
        self._assumes = dialect.after_g80 == "assumed"
        self._here, self._state = here, state
        self._code: G | None = G.G0 if dialect.motion_assumed else None
        self.restored = _HIGHEST[dialect.after_g80]
        self.resting: G | None = dialect.motion

    def end(self) -> None:
        """Assume no motion: a motion code is in effect, or something else than G80 ended it."""
        self._code = None

    def keep(self) -> None:
        """Remember the motion in effect before a line that has a motion code."""
        if self._state.motion in PLAIN_MOTIONS:
            self.resting = self._state.motion

    def cancel(self) -> None:
        """Execute G80, after :meth:`keep`."""
        resting, before = self.resting, self._state.motion
        place = -1 if resting is None else PLAIN_MOTIONS.index(resting)
        after = _motion_after_cancel(place, self.restored)
        self._state.motion = PLAIN_MOTIONS[after] if after >= 0 else None
        if before is not None:
            self.cancelled()

    def cancelled(self) -> None:
        """Record that G80 has ended a motion; it may be assumed for the axis words after it."""
        straight = self.resting in PLAIN_MOTIONS[: _STRAIGHT + 1]
        self._code = self.resting if self._assumes and straight else None

    def assume(self, word: Word) -> G | None:
        """Return the motion of an axis word while none is in effect; None for an error."""
        code = self._code
        if code is None:
            return None
        message = f"{word.written} without a motion code in effect is read with {code.written}"
        hint = "begin with G0 or G1: controllers differ"
        if self.resting is not None:
            hint = f"{hint}; from here on each G80 returns to the G0 or G1 before it"
            self.restored = _STRAIGHT
        self._here.report_warning("motion-assumed", message, word, hint)
        self._state.motion, self._code = code, None
        return code
