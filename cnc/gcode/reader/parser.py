"""A line of text to a statement. Parsed lines are memoised by their text.

First the syntax of a dialect and the parser; then the repair of lines that other controllers
accept; then the lines of Fagor's controls.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Literal, NamedTuple

from cnc.gcode.reader.expressions import (
    FUNCTIONS,
    MACRO_FUNCTIONS,
    MACRO_OPERATORS,
    OPERATORS,
    Builder,
)
from cnc.gcode.reader.lines import (
    KLARTEXT,
    MACRO,
    MAX_LINE,
    NGC,
    SINUMERIK,
    Language,
    read_line,
)
from cnc.gcode.reader.parameters import Names, Variables
from cnc.gcode.reader.statements import MENDED, NOTED, Remark, Statement, Translator
from cnc.gcode.reader.syntax_errors import MACRO_KEYWORDS, O_KEYWORDS, ErrorContext, describe
from cnc.gcode.reader.words import fault
from cnc.model.diagnostics import Diagnostic, Fix, GcodeError

if TYPE_CHECKING:
    from cnc.gcode.sinumerik.statements import Lines


_names_of = lru_cache(maxsize=8)(Names)
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


def language_of(flavour: Flavour) -> Language:
    """Return how compiled code reads the lines of a language."""
    languages = {"macro-b": MACRO, "siemens": SINUMERIK, "klartext": KLARTEXT}
    return languages.get(flavour, NGC)


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
        return language_of(self.flavour)

    @property
    def names(self) -> Names:
        """The variables of a program of SINUMERIK."""
        return _names_of(self.variables)

    @property
    def skips_inside(self) -> bool:
        """Whether a ``/`` may stand inside a line, which block delete then skips from there."""
        return self.lenient or self.flavour == "macro-b"


AUTO = Syntax(siemens=True)


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
    reading = read_line(text, SINUMERIK.grammar)
    results, lines = reading.results, siemens_lines(text, syntax)
    if results.status[0]:
        raise lines.refused(int(results.place[0]), reading.grammar.wanted[results.state[0]])
    return lines.statement(reading, 0)


def siemens_lines(text: str, syntax: Syntax, shift: int = 0) -> Lines:
    """Return the maker of the statement of a line of SINUMERIK.

    Args:
        text: The line.
        syntax: The syntax, with the variables of the program.
        shift: Position of the line in the text of the events.
    """
    from cnc.gcode.sinumerik.statements import Lines  # most programs are in another language

    return Lines(text, syntax.names, shift)


def _parse_mended(text: str, syntax: Syntax) -> Statement:
    """Parse a line; if its dialect is lenient, mend a slip that other controllers accept."""
    written = text
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
        finding, mended = error.diagnostic, None
        if syntax.lenient:
            mended = mend(text, finding)
        elif syntax.first_bracket:
            mended = to_first_bracket(text, finding)
        if mended is None:
            # Columns count in the text as it is written.
            fix = finding.fix or _fix(text, mend(text, finding), finding.code)
            fix = fix if len(text) == len(written) else None
            raise GcodeError(replace(finding, fix=fix)) from None
    statement = _parse(mended.text, syntax)
    fix = _fix(text, mended, finding.code, safe=True) if len(text) == len(written) else None
    return replace(statement, remarks=(*statement.remarks, replace(mended.remark, fix=fix)))


_TITLES = {
    "comment-nested": "write other brackets inside the comment",
    "comment-not-closed": "close the comment",
}


def _fix(text: str, mended: Mended | None, code: str, *, safe: bool = False) -> Fix | None:
    """Return the edit that leads from a line with an error to its repaired form."""
    if mended is None:
        return None
    new = mended.text
    begin = _alike(text, new)
    end = _alike(text[begin:][::-1], new[begin:][::-1])
    title = _TITLES.get(code, "write the text as a comment")
    return Fix.replace(
        title, begin + 1, len(text) - end - begin, new[begin : len(new) - end], safe=safe
    )


def _alike(a: str, b: str) -> int:
    """Return the number of first characters that two texts share."""
    pairs = enumerate(zip(a, b, strict=False))
    return next((at for at, pair in pairs if pair[0] != pair[1]), min(len(a), len(b)))


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
    for match in _FOREIGN.finditer(text):
        if match[1]:
            message = f"{_FOREIGN_NAMES[match[1].upper()]} not in the {syntax.dialect} dialect"
            raise fault(
                "syntax-not-in-dialect",
                message,
                column=match.start() + 1,
                hint="use --dialect linuxcnc, or auto",
            )


# Repair of lines that many controllers accept and RS274/NGC does not.
#
# Each repair keeps the place of every other character, and is reported as a warning.

_PROGRAM_NUMBER = re.compile(r"([ \t]*):(?=[ \t]*O?[0-9]{1,8}[ \t]*(?:[(;].*)?$)", re.DOTALL)
_PROGRAM_NAME = re.compile(r"([ \t]*)(?=<[-A-Z0-9+_.]{1,32}>[ \t]*(?:[(;].*)?$)", re.I | re.DOTALL)
"""A program's name in place of its number, on FANUC's Series 30i."""
_ALIGNMENT = re.compile(r"[ \t]*:(?=[ \t]*[0-9]{1,8}[ \t]+[A-Z][ \t]*[-+.0-9])", re.I)
"""A colon in place of N, at which some posts let a program begin again."""
_TEXT_CODE = re.compile(
    r"[ \t]*(?:N[0-9]+[ \t]*)?M(?:(?:16|23|28|30|32)\b(?=[ \t]+[A-Z])|11[478](?=[ \t]))", re.I
)
_STOP_TEXT = re.compile(r"[ \t]*(?:N[0-9]+[ \t]*)?M0?[01][ \t](?=[ \t]*[A-Z]{2})", re.I)
"""A stop with a text for the operator. Source: Marlin, "G-code Index", M0."""
_CHECKSUM = re.compile(r"\*[0-9]+[ \t]*(?=;|$)")
_HOMING = re.compile(r"[ \t]*(?:N[0-9]+[ \t]*)?G28(?![0-9.])", re.I)
_AXIS_ALONE = re.compile(r"[XYZ](?=[ \t]*(?:[A-Z]|$))", re.I)
_HOMING_OPTION = re.compile(r"[LOW](?=[ \t]*(?:[A-Z]|$))", re.I)
"""Home only axes of unknown position (O), without a restored bed level (L), without a probe (W)."""
_SHORT_NAME = re.compile(
    r"(?<![A-Z])(?:WH|AB|AC|AS|AT|BC|BI|CO|EX|FI|FU|RO|SI|SQ|TA)(?=[ \t]*\[)", re.I
)
_LONG_NAMES = {
    name[:2]: name
    for name in (
        "WHILE", "ABS", "ACOS", "ASIN", "ATAN", "BCD", "BIN", "COS", "EXP", "FIX", "FUP", "ROUND",
        "SIN", "SQRT", "TAN",
    )
}  # fmt: skip
_COMMENT = re.compile(r"\(([^)]*)\)")
_REMARK = re.compile(r"\([^()]*\)|;.*")
_SPINDLE = re.compile(r"(?:M0*(?:[345]|19)|G9[67])(?![0-9.])|S[0-9.]", re.IGNORECASE)
_FIRST_SPINDLE = re.compile(r"\$[ \t]*(?:0+|-0*1)(?![0-9.])")
_WORD = re.compile(r"[A-Za-z#\[][ \t]*[-+#\[]?[ \t]*[0-9.]|%|[A-Za-z0-9\]>][ \t]*=")
"""Text that could be executed if it stood outside of a comment."""
_PROSE = re.compile(r"(?<![A-Z0-9<_])[A-Z]{2,}(?![A-Z0-9>_])", re.I)
"""A word of letters alone."""
_KEYWORDS = frozenset(
    (
        *MACRO_KEYWORDS, *O_KEYWORDS, *FUNCTIONS, *MACRO_FUNCTIONS, *OPERATORS, *MACRO_OPERATORS,
        "ATAN", "EXISTS", "POPEN", "PCLOS", "DPRNT", "BPRNT", "SETVN",
    )
)  # fmt: skip


_INNER_SLASH = re.compile(r"(?<=[0-9.\]])[ \t]*(/)[ \t]*[A-Z][ \t]*[-+]?[.0-9]", re.I)
"""Block delete between two words."""
_ANY_COMMENT = re.compile(r"\([^)]*\)?|;.*", re.DOTALL)
_SHOWN = re.compile(r'[ \t]*(?:N[0-9]+[ \t]*)?(?:LOG|WARN)?MSG[ \t]+"([^"]*)"[ \t]*(?:;.*)?', re.I)
_SIMULATION = re.compile(r"[ \t]*\[[ \t]*(?:BILLET|EDGEMOVE|TOOLDEF)\b", re.I)
_OUTPUT = re.compile(
    r"[ \t]*/?[ \t]*(?:N[0-9]+[ \t]*)?(POPEN|PCLOS|[DB]PRNT(?=[ \t]*\[.*\]))"
    r"(?:[ \t]*\[.*\])?[ \t]*(?:[(;].*)?",
    re.I | re.DOTALL,
)
"""A line that writes to a port of the control."""


class Mended(NamedTuple):
    """A repaired line, and the remark that reports the repair."""

    text: str
    remark: Remark


def as_program_start(text: str) -> str:
    """Return a line with FANUC's other forms of a program's start as RS274/NGC has them.

    ``:1000`` is O1000, and before other words N1000; ``<PART>`` is O<PART>. Text after the % that
    begins a tape is its name, not code.
    """
    begin = text.lstrip(" \t")
    if begin.startswith("%") and begin[1:].strip() and begin[1:].lstrip(" \t")[:1] not in "(;":
        return f"%({re.sub('[()]', ' ', begin[1:])})"
    if begin.startswith("<") and (name := _PROGRAM_NAME.match(text)):
        return f"{name[1]}O{text[name.end() :]}"
    if begin.startswith(":") and (colon := _ALIGNMENT.match(text)):
        return f"{text[: colon.end() - 1]}N{text[colon.end() :]}"
    if begin.startswith(":") and (colon := _PROGRAM_NUMBER.match(text)):
        rest = text[colon.end() :].lstrip(" \t")
        return text[: colon.end() - 1] + (" " if rest[:1] in "Oo" else "O") + text[colon.end() :]
    return text


def inner_slash(text: str) -> int | None:
    """Return the place of a ``/`` between two words, from which on block delete skips the line.

    None if there is none. Source: FANUC Series 0i, "Optional block skip".
    """
    if "/" not in text:
        return None
    slash = _INNER_SLASH.search(_ANY_COMMENT.sub(lambda comment: " " * len(comment[0]), text))
    return slash.start(1) if slash else None


def shown_message(text: str) -> str | None:
    """Return the text of a line ``MSG "text"``, as EdingCNC has it; None for another line."""
    match = _SHOWN.fullmatch(text)
    return match and match[1]


def is_for_simulation(text: str) -> bool:
    """Whether a line is for the simulation of a training mill, such as ``[BILLET X50 Y50 Z25``."""
    return _SIMULATION.match(text) is not None


def output_command(text: str) -> str:
    """Return the command of macro B by which a line writes to a port; empty for other lines.

    Source: FANUC Series 0i, "External output commands".
    """
    match = _OUTPUT.fullmatch(text)
    return match[1].upper() if match else ""


def with_whole_names(text: str) -> str:
    """Return a line of custom macro B with names of two letters written out.

    Source: FANUC Series 0i, "Arithmetic and logic operation", abbreviations: ``RO`` is ROUND.
    """
    if _SHORT_NAME.search(text) is None:
        return text
    out, at = [], 0
    for comment in (*_ANY_COMMENT.finditer(text), None):
        code = text[at : comment.start() if comment else len(text)]
        out.append(_SHORT_NAME.sub(lambda match: _LONG_NAMES[match[0].upper()], code))
        if comment:
            out.append(comment[0])
            at = comment.end()
    return "".join(out)


def without_first_spindle(text: str) -> str:
    """Return a line without ``$0`` and ``$-1`` of a spindle's code: the first spindle, or all.

    Source: LinuxCNC, "G-code", M3, M4, M5, M19, G96, G97, and S.
    """
    code = _REMARK.sub(lambda match: " " * len(match[0]), text)
    if not _SPINDLE.search(code):
        return text
    for match in _FIRST_SPINDLE.finditer(code):
        text = f"{text[: match.start()]}{' ' * len(match[0])}{text[match.end() :]}"
    return text


def without_printer_text(text: str) -> str:
    """Return a line of a 3D printer without the text of a message and without a checksum.

    G28 names its axes without numbers; these get a 0. Source: Marlin, "G-code Index", G28.
    """
    if match := _TEXT_CODE.match(text):
        return text[: match.end()]
    text = _CHECKSUM.sub("", text)
    if _HOMING.match(text):
        code, semicolon, comment = text.partition(";")
        code = _AXIS_ALONE.sub(r"\g<0>0", _HOMING_OPTION.sub("", code.rstrip()))
        text = code + semicolon + comment
    return text


def mend(text: str, error: Diagnostic) -> Mended | None:
    """Return a line without the slip of an error; None if the line cannot be repaired safely."""
    if error.code == "block-delete-place":
        return _slashes(text)
    if error.code == "syntax-not-in-dialect" and (mended := _slashes(text)):
        return mended
    if (stop := _STOP_TEXT.match(text)) and not _could_be_code(text[stop.end() :]):
        shown = re.sub("[();]", " ", text[stop.end() :])
        what = "the text behind the stop is read as a message"
        remark = Remark(MENDED, what, stop.end() + 1, len(shown))
        return Mended(f"{text[: stop.end() - 1]}({shown})", remark)
    if error.code not in ("comment-nested", "comment-not-closed"):
        return None
    flat = _flat(text)
    if flat is None or flat == text:
        return None
    what = (
        "a ( inside a comment: the comment is read to its own closing bracket"
        if error.code == "comment-nested"
        else "this comment is not closed: it is read to the end of the line"
    )
    return Mended(flat, Remark(MENDED, what, error.column, error.length))


def _slashes(text: str) -> Mended | None:
    """Return a line with ``//`` as the begin of a comment; None without it, or with code behind."""
    begin = _ANY_COMMENT.sub(lambda comment: " " * len(comment[0]), text).find("//")
    if begin < 0 or _could_be_code(text[begin + 2 :]):
        return None
    remark = Remark(MENDED, "// begins no comment in G-code: it is read as one", begin + 1, 2)
    return Mended(f"{text[:begin]};{text[begin + 1 :]}", remark)


def to_first_bracket(text: str, error: Diagnostic) -> Mended | None:
    """Return a line whose comments end at their first ); None for another error."""
    if error.code != "comment-nested":
        return None
    mended = _COMMENT.sub(lambda comment: f"({comment[1].replace('(', '[')})", text)
    what = "a ( inside a comment: the comment ends at the first )"
    return Mended(mended, Remark(MENDED, what, error.column, error.length))


def _flat(text: str) -> str | None:
    """Return a line whose comments have no brackets inside and are closed.

    None if the comment ends at another bracket on other controllers, and the text behind that could
    be executed.
    """
    out: list[str] = []
    at = 0
    while at < len(text):
        if text[at] == ";":
            break
        if text[at] != "(":
            out.append(text[at])
            at += 1
            continue
        end = _balanced_end(text, at)
        first = text.find(")", at)
        if first < 0:
            return "".join(out) + "(" + text[at + 1 :].replace("(", "[") + ")"
        if end < 0:
            end = first
        elif _could_be_code(text[first + 1 : _end_of_code(text, first, end)]):
            return None
        inside = text[at + 1 : end].replace("(", "[").replace(")", "]")
        out.append(f"({inside})")
        at = end + 1
    return "".join(out) + text[at:]


def _could_be_code(text: str) -> bool:
    """Whether text between brackets of a comment could be executed outside of it.

    A line with a word that no control knows is an error on each of them, not another motion.
    """
    if not _WORD.search(text):
        return False
    prose = _PROSE.findall(_ANY_COMMENT.sub(" ", text))
    return all(word.upper() in _KEYWORDS for word in prose)


def _end_of_code(text: str, first: int, end: int) -> int:
    """Return the end of the text that is code where a comment ends at its first bracket."""
    semicolon = text.find(";", first, end)
    return end if semicolon < 0 else semicolon


def _balanced_end(text: str, begin: int) -> int:
    """Return the position of the bracket that closes the one at ``begin``; -1 for none."""
    depth = 0
    for at in range(begin, len(text)):
        if text[at] == "(":
            depth += 1
        elif text[at] == ")":
            depth -= 1
            if depth == 0:
                return at
    return -1


# Lines of Fagor's controls: the head of a file, tools with their offsets, words that are refused.
#
# Sources: Autodesk, posts "FAGOR 8037/8055" (the head, dwells in hundredths of a second, G53 beside
# G0) and "FAGOR 8065" (dwells in seconds); a table of functions of older controls (G53 to G59 are
# seven stored offsets). Commands of the high-level language stand in parentheses; no manual of them
# was at hand, so whatever looks like one is refused.

HEAD = "the head of the file has no effect here"
"""Note of a line with ``%`` and a name."""
_HEAD = re.compile(r"\s*%\s*[^\s%].*")
_FAGOR_COMMENT = re.compile(r"\(([^()]*)\)|;.*")
_COMMAND = re.compile(
    r"\s*(?:IF|GOTO|CALL|PCALL|MCALL|MDOFF|PROC|RPT|SUB|RET|ERROR|EXEC|REPOS|PROBE|DIGIT|OPEN|WRITE"
    r"|PAGE|SYMBOL|DW|ODW|IB|SK|WKEY|WBUF|SYSTEM|DSTBLK|ESTBLK|DSTOP|ESTOP|DFHOLD|EFHOLD|TRACE)\b"
    r"|\s*[A-Z_]\w*(?:\[[^\]]*\])?\s*=",
    re.IGNORECASE,
)
_TOOL = re.compile(r"T[ \t]*0*([0-9]+)(\.0*([0-9]*))", re.IGNORECASE)
_SYSTEM = re.compile(r"G[ \t]*0*5[3-9](?![0-9.])", re.IGNORECASE)
_MOTION = re.compile(r"G[ \t]*0*[0-3](?![0-9.])", re.IGNORECASE)
_AXIS = re.compile(r"[XYZABC][ \t]*[-+.0-9]", re.IGNORECASE)
_DWELL = re.compile(r"G[ \t]*0*4(?![0-9.]).*?(K[ \t]*[0-9]*\.[0-9]*)", re.IGNORECASE)


def is_head(text: str) -> bool:
    """Return whether a line is the head of a file: ``%`` and a name."""
    return _HEAD.fullmatch(text) is not None


def with_plain_tools(text: str) -> str:
    """Return a line with ``T5`` in place of ``T5.5``, at the same columns.

    Raises:
        GcodeError: ``code-not-supported``, ``decimal-point-place``, ``tool-offset-other``,
            ``offset-without-motion``.
    """
    for remark in _FAGOR_COMMENT.finditer(text):
        if remark[1] is not None and (command := _COMMAND.match(remark[1])):
            name = command[0].strip()
            raise fault(
                "code-not-supported",
                f"({name} ..) is a command of Fagor's high-level language, which is not supported",
                column=remark.start() + 1,
                hint="if it is a comment, write it behind a semicolon",
            )
    code = _FAGOR_COMMENT.sub(lambda remark: " " * len(remark[0]), text)
    if dwell := _DWELL.search(code):
        raise fault(
            "decimal-point-place",
            f"{dwell[1]} has a decimal point: K of G4 is in hundredths of a second on the 8037 and "
            "8055, and in seconds on others",
            column=dwell.start(1) + 1,
            hint="write whole hundredths, such as K150 for 1.5 s",
        )
    system = None if _MOTION.search(code) else _SYSTEM.search(code)
    if system and (_AXIS.search(code) or system[0].endswith("3")):
        raise fault(
            "offset-without-motion",
            f"{system[0]} without G0 or G1 is a move in machine coordinates or in this system on "
            "the 8037 and 8055, and the choice of an offset or an entry in its table on older ones",
            column=system.start() + 1,
            hint="write G0 or G1 in this line",
        )
    for tool in _TOOL.finditer(code):
        if tool[3] and int(tool[3]) != int(tool[1]):
            raise fault(
                "tool-offset-other",
                f"{tool[0]}: tool {tool[1]} with offset {tool[3]} is not supported, only an offset "
                "with the number of its tool",
                column=tool.start() + 1,
                hint=f"write T{tool[1]}.{tool[1]}, and its data in the tool table",
            )
        start, end = tool.span(2)
        text = text[:start] + " " * (end - start) + text[end:]
    return text
