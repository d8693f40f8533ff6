"""Commands in comments: MSG, DEBUG, PRINT and ABORT.

Source: LinuxCNC, "G-code overview", messages.
"""

from __future__ import annotations

from cnc.gcode.codes.comments import fill, shown
from cnc.gcode.state.block_buffer import BlockBuffer
from cnc.gcode.state.source_location import SourceLocation
from cnc.gcode.syntax.parameters import Parameters
from cnc.gcode.syntax.statement import MENDED, NOTED, SHOWN, Remark
from cnc.gcode.syntax.words import Word, fault
from cnc.model.blocks import Message
from cnc.model.diagnostics import GcodeError

_MESSAGES = ("msg", "debug", "print")


class CommentCommands:
    """Executes the commands in comments."""

    def __init__(
        self, here: SourceLocation, out: BlockBuffer, parameters: Parameters, *, aborts: bool
    ) -> None:
        """With ``aborts`` the dialect has ABORT."""
        self._here = here
        self._out = out
        self._parameters = parameters
        self._aborts = aborts
        self._noted: set[str] = set()
        self._may_abort: set[tuple[str, int]] = set()

    def execute(self, remark: Remark) -> GcodeError | None:
        """Execute a command; return the error of an ABORT that ends the program, else None."""
        here = self._here
        if remark.kind == "abort" and self._aborts:
            return self._abort(remark)
        if remark.kind in _MESSAGES:
            text = remark.text if remark.kind == "msg" else fill(remark.text, self._parameters)
            self._out.add(Message(here.file, here.line, text))
            return None
        if remark.kind == SHOWN:
            self._out.add(Message(here.file, here.line, shown(remark.text, self._parameters)))
            return None
        if remark.kind == MENDED:
            at = Word("(", 0.0, "(", remark.column, remark.length)
            here.report_warning(
                "comment-mended", remark.text, at, "write comments in ( ), without brackets inside"
            )
            return None
        if remark.kind == NOTED:
            if remark.text not in self._noted:
                self._noted.add(remark.text)
                at = Word("(", 0.0, "", remark.column, remark.length)
                here.report_note("code-not-needed", remark.text, at)
            return None
        name = f"({remark.kind.upper()})"
        at = Word("(", 0.0, name, remark.column, 1)
        effect = "stops the program" if remark.kind == "abort" else "writes a file or runs code"
        hint = f"it {effect} on LinuxCNC only"
        here.report_warning("comment-not-active", f"{name} has no effect here", at, hint)
        return None

    def _abort(self, remark: Remark) -> GcodeError | None:
        """Return the error ``program-abort``.

        It is only a warning where a guessed answer of the board may have led here.
        """
        here, text = self._here, fill(remark.text, self._parameters)
        reason = f": {text}" if text else ""
        at = Word("(", 0.0, "(ABORT)", remark.column, remark.length)
        if not self._out.assumed:
            hint = "correct the cause that its text gives, then run it again"
            return fault("program-abort", f"the program aborts itself{reason}", at, hint)
        if (place := (here.file, here.line)) not in self._may_abort:
            self._may_abort.add(place)
            hint = "the check continues; a run aborts here if the board's answer leads here"
            here.report_warning("abort-possible", f"the program may abort itself{reason}", at, hint)
        return None
