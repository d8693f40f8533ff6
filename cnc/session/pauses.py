"""Pauses of a program for the operator (M0, M6, M60): reason and text."""

from __future__ import annotations

import re

from cnc.gcode.syntax.source_text import Text
from cnc.model.blocks import Block, Stop, Tool
from cnc.model.diagnostics import Diagnostic, GcodeError
from cnc.session.program_reader import ProgramReader

_COMMENT = re.compile(r"\(([^()]*)\)|;(.*)")
_KEYWORD = re.compile(r"\s*(?:MSG|PRINT|DEBUG|LOG)\s*,", re.IGNORECASE)


def pause_reason(block: Block) -> str:
    """Return why the machine waits for the operator at a block; empty if it does not wait.

    The machine does not wait at M1, unless the user has turned the optional stop on.
    """
    if isinstance(block, Tool) and block.change:
        return f"put in tool {block.number}"
    if isinstance(block, Stop) and not block.optional:
        return "change the pallet" if block.pallet else "the program stops here"
    return ""


def pause_text(block: Block, reader: ProgramReader) -> str:
    """Return the reason of a pause with what the operator should know; empty without a pause.

    For a tool that is its comment in the tool table. Otherwise it is the program's comment in the
    line of the pause, or alone in the line before.
    """
    reason = pause_reason(block)
    if not reason:
        return ""
    if isinstance(block, Tool):
        entry = reader.saved.tools().tool(block.number)
        if entry is not None and entry.comment:
            return f"{reason}: {entry.comment} (tool table)"
    comment = _comment_at(block, reader)
    return f"{reason}: {comment}" if comment else reason


def needs_operator(block: Block) -> GcodeError:
    """Return the fault of a block that waits, if there is no operator."""
    hint = "run it in a terminal and continue with the space bar, or use --yes to skip the pause"
    message = f"{pause_reason(block)}, and there is no terminal to continue from"
    return GcodeError(Diagnostic("needs-operator", message, block.file, block.line, hint=hint))


def _comment_at(block: Block, reader: ProgramReader) -> str:
    """Return the comment in the line of a block, or in the comment line before it."""
    if block.file != reader.name:
        return ""
    text = Text.of_file(reader.path)
    for line in range(block.line, max(block.line - 2, 0), -1):
        window = text.window(line)
        source = window.text(line - window.first) if window else ""
        comments = " ".join(
            _KEYWORD.sub("", first or second).strip() for first, second in _COMMENT.findall(source)
        ).strip()
        if comments and (line == block.line or not _COMMENT.sub("", source).strip()):
            return comments
    return ""
