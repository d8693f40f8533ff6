"""Calls of programs that are not at hand: a check continues without them, a run does not begin."""

from __future__ import annotations

from cnc.gcode.program.call_stack import Flow
from cnc.gcode.syntax.words import Word


def skips_missing(flow: Flow, name: str, word: Word, line: int) -> bool:
    """Return whether the call of a missing program is skipped, and report it once a program.

    Args:
        flow: The flow of control.
        name: The name of the program, as messages call it.
        word: The place of the call.
        line: The line of the call.
    """
    interpreter = flow.interpreter
    if interpreter.policy.missing_programs == "error":
        return False
    if name not in flow.missing:
        flow.missing.add(name)
        interpreter.here.line = line
        message = (
            f"there is no program {name} here: its moves are not checked, and the lines behind "
            "the call are checked as if it did nothing"
        )
        hint = "a run needs it: put its file beside the program or name its folder"
        interpreter.here.report_warning("subprogram-missing", message, word, hint)
    return True
