"""The faults of boards."""

from __future__ import annotations

from cnc.model.diagnostics import BoardError, Diagnostic


def board_error(code: str, message: str, *, line: int = 0, hint: str = "") -> BoardError:
    """Return a fault of the board, with its source line where it is known."""
    return BoardError(Diagnostic(code, message, line=line, hint=hint))
