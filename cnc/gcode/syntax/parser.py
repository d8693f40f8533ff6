"""A line of text to a statement. Parsed lines are memoised by their text."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Literal

from cnc.gcode.reader.lines import (
    KLARTEXT,
    MACRO,
    MAX_LINE,
    NGC,
    SINUMERIK,
    Language,
    read_line,
)
from cnc.gcode.reader.statements import Translator
from cnc.gcode.syntax.error_context import ErrorContext
from cnc.gcode.syntax.expressions import Builder
from cnc.gcode.syntax.fagor import HEAD, is_head, with_plain_tools
from cnc.gcode.syntax.mending import (
    as_program_start,
    inner_slash,
    is_for_simulation,
    mend,
    output_command,
    shown_message,
    to_first_bracket,
    with_whole_names,
    without_first_spindle,
    without_printer_text,
)
from cnc.gcode.syntax.statement import NOTED, Remark, Statement
from cnc.gcode.syntax.syntax_errors import describe
from cnc.gcode.syntax.words import fault
from cnc.model.diagnostics import GcodeError

if TYPE_CHECKING:
    from cnc.gcode.sinumerik.variables import Names, Variables

MEMO = 4096
"""Parsed lines that are kept."""

MOST_ZEROS = 512
"""Zero bytes in a line from which on they are a lost sector of a disk, and no leader of a tape."""

_QUERY = re.compile(r"[ \t]*(\?)[ \t]*(?:;.*)?")
_SWITCH = re.compile(r"([ \t]*/)[1-9](?=[ \t]*[A-Za-z(#])")
"""Block delete with the number of a switch, as FANUC and SINUMERIK have it."""
_CONTROL = re.compile(r"[\x00-\x08\x0a-\x1f\x7f]")
_TAPE = "\0\2\3\4\x0c\x11\x12\x13\x14\x1a\x7f \t"
"""Characters of paper tape, printers and serial links, which mean nothing around a line."""
_FOREIGN = re.compile(r"\([^()]*\)|[(;].*|([\[#Oo])", re.DOTALL)
_FOREIGN_NAMES = {
    "[": "expressions are",
    "#": "parameters are",
    "O": "O-words (subprograms and control flow) are",
}

Flavour = Literal["ngc", "macro-b", "siemens", "klartext", "none"]


@dataclass(frozen=True, slots=True)
class Syntax:
    """The syntax of a dialect.

    Attributes:
        flavour: Language of parameters, expressions and control flow.
        siemens: Whether the dialect has BSPLINE, SD=, PL=, PW=.
        dollar: Whether lines that begin with $ are commands for the board.
        lenient: Whether nested or open comments and text after % are only warnings.
        first_bracket: Whether a comment ends at the first ), whatever stands in it.
        dialect: Name of the dialect for messages.
        variables: Variables that a program of SINUMERIK defines.
    """

    flavour: Flavour = "ngc"
    siemens: bool = False
    dollar: bool = False
    lenient: bool = False
    first_bracket: bool = False
    dialect: str = "auto"
    variables: Variables = ()

    @property
    def language(self) -> Language:
        """How lines are read by compiled code."""
        languages = {"macro-b": MACRO, "siemens": SINUMERIK, "klartext": KLARTEXT}
        return languages.get(self.flavour, NGC)

    @property
    def names(self) -> Names:
        """The variables of a program of SINUMERIK."""
        return _names_of(self.variables)

    @property
    def skips_inside(self) -> bool:
        """Whether a ``/`` may stand inside a line, which block delete then skips from there."""
        return self.lenient or self.flavour == "macro-b"


AUTO = Syntax(siemens=True)


@lru_cache(maxsize=8)
def _names_of(variables: Variables) -> Names:
    from cnc.gcode.sinumerik.variables import Names  # most programs are in another language

    return Names(variables)


@lru_cache(maxsize=MEMO)
def parse_line(text: str, syntax: Syntax = AUTO) -> Statement:
    """Parse a line, which is given without its line end.

    Raises:
        GcodeError: A syntax error with its column (from 1). The caller adds line and file. Computed
            values raise the same kind of error when they are computed.
    """
    _check_size(text)
    if syntax.lenient and not text.strip(_TAPE):
        return Statement()
    if control := _CONTROL.search(text):
        code = text.strip(_TAPE)
        if syntax.lenient and not _CONTROL.search(code):
            return parse_line(" " * text.index(code) + code, syntax)
        message, hint = f"control character U+{ord(control[0]):04X}", "is this a text file?"
        raise fault("control-character", message, column=control.start() + 1, hint=hint)
    if not text or text.isspace():
        return Statement()
    if syntax.flavour == "klartext":
        from cnc.gcode.klartext.reader import parse  # for its programs only

        return parse(text)
    if text.strip(" \t") == "%":
        # Most programs have this line, and many need the grammar for no other one.
        return Statement(percent=True)
    if syntax.flavour == "siemens":
        return _siemens_line(text, syntax)
    if text.lstrip(" \t").startswith("$"):
        return _board_line(text, syntax)
    if syntax.lenient and is_for_simulation(text):
        what = "a line for the simulation of a training mill has no effect here"
        return Statement(remarks=(Remark(NOTED, what, 1, len(text)),))
    if syntax.flavour == "macro-b" and (command := output_command(text)):
        what = f"{command} (output to a port of the control) has no effect here"
        return Statement(remarks=(Remark(NOTED, what, 1, len(text)),))
    if syntax.lenient and (shown := shown_message(text)) is not None:
        return Statement(remarks=(Remark("msg", shown, 1, len(text)),))
    if text.lstrip(" \t").startswith("%") and (what := _meaning_of_head(text, syntax)):
        return Statement(remarks=(Remark(NOTED, what, 1, len(text)),))
    if syntax.dollar and (query := _QUERY.fullmatch(text)):
        what = "? (report of the board's status) has no effect here"
        return Statement(remarks=(Remark(NOTED, what, query.start(1) + 1, 1),))
    text = with_plain_tools(text) if syntax.dialect == "fagor" else text
    return _parse_mended(text, syntax)


def _check_size(text: str) -> None:
    """Refuse a line that is too long, or a lost part of a file."""
    if len(text) > MAX_LINE:
        message = f"the line has more than {MAX_LINE} characters"
        raise fault("line-too-long", message, column=MAX_LINE + 1)
    if (zeros := text.count("\0")) >= MOST_ZEROS:
        message = f"{zeros} zero bytes in one line: the file was not copied or saved whole"
        raise fault("zero-bytes", message, column=text.index("\0") + 1, hint="copy the file again")


def _meaning_of_head(text: str, syntax: Syntax) -> str:
    """Return what a line with % and a text is; empty if it is an error."""
    if syntax.lenient and syntax.dialect == "grbl":
        return "a line with % and a text is for the sender program and has no effect here"
    return HEAD if syntax.dialect == "fagor" and is_head(text) else ""


def _siemens_line(text: str, syntax: Syntax) -> Statement:
    """Parse a line of SINUMERIK."""
    from cnc.gcode.sinumerik.statements import Lines  # most programs are in another language
    from cnc.gcode.sinumerik.words import describe

    reading = read_line(text, SINUMERIK.grammar)
    results = reading.results
    if results.status[0]:
        wanted = reading.grammar.wanted[results.state[0]]
        raise describe(text, int(results.place[0]), wanted)
    return Lines(text, syntax.names).statement(reading, 0)


def _parse_mended(text: str, syntax: Syntax) -> Statement:
    """Parse a line; if its dialect is lenient, mend a slip that other controllers accept."""
    if syntax.skips_inside:
        text = as_program_start(text)
        if (slash := inner_slash(text)) is not None:
            text = f"{text[:slash]} {text[slash + 1 :]}"
    if syntax.lenient and (switch := _SWITCH.match(text)):
        text = f"{switch[1]} {text[switch.end() :]}"
    if syntax.flavour == "macro-b" and "[" in text:
        text = with_whole_names(text)
    if syntax.dialect == "marlin":
        text = without_printer_text(text)
    if "$" in text and syntax.flavour == "ngc":
        text = without_first_spindle(text)
    try:
        return _parse(text, syntax)
    except GcodeError as error:
        mended = None
        if syntax.lenient:
            mended = mend(text, error.diagnostic)
        elif syntax.first_bracket:
            mended = to_first_bracket(text, error.diagnostic)
        if mended is None:
            raise
    found = _parse(mended.text, syntax)
    return replace(found, remarks=(*found.remarks, mended.remark))


def _parse(text: str, syntax: Syntax) -> Statement:
    """Parse a line with the grammar."""
    if syntax.flavour == "none":
        _refuse_foreign(text, syntax)
    macro = syntax.flavour == "macro-b"
    reading = read_line(text, "macro" if macro else "ngc")
    results = reading.results
    if results.status[0]:
        wanted = reading.grammar.wanted[results.state[0]]
        raise describe(ErrorContext(text, int(results.place[0]), wanted, macro=macro))
    build = Builder("macro" if macro else "ngc")
    return Translator(text, build, siemens=syntax.siemens, dialect=syntax.dialect).statement(
        reading, 0
    )


def _board_line(text: str, syntax: Syntax) -> Statement:
    if not syntax.dollar:
        hint = "it is a command of a GRBL board: use --dialect grbl"
        raise fault(
            "syntax-not-in-dialect",
            f"$ lines are not in the {syntax.dialect} dialect",
            column=text.index("$") + 1,
            hint=hint,
        )
    return Statement(board=text.strip(" \t"))


def _refuse_foreign(text: str, syntax: Syntax) -> None:
    """Raise the error for parameters, expressions and O-words in a dialect without them."""
    for found in _FOREIGN.finditer(text):
        if found[1]:
            message = f"{_FOREIGN_NAMES[found[1].upper()]} not in the {syntax.dialect} dialect"
            raise fault(
                "syntax-not-in-dialect",
                message,
                column=found.start() + 1,
                hint="use --dialect linuxcnc, or auto",
            )
