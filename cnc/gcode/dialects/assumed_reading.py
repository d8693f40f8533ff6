"""What the first lines of a program leave open, and how they are read.

Units without a code, comments that name other units, words that two controllers read differently.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

from cnc.gcode.dialects import Dialect
from cnc.gcode.dialects.recognition import Recognition, code_of, comments_of, first_lines
from cnc.model.diagnostics import Diagnostic

_BEGIN = re.compile(r"[0-9]*\s*BEGIN\s+PGM\b")
_INCH = re.compile(r"G\s*0?20(?![0-9.])")
_MM = re.compile(r"G\s*0?21(?![0-9.])")
_OTHER_INCH = re.compile(r"G\s*700?(?![0-9.])")
_OTHER_MM = re.compile(r"G\s*710?(?![0-9.])")

_STATED = r"UNITS?(?:\s+ARE)?(?:\s*[:=]\s*|\s+)(?:IN\s+)?"
_STATES_INCH = re.compile(
    _STATED + r"(?:IN\b(?!\s*\w)|(?:INCH|INCHES|IMPERIAL)\b)"
    r"|\b(?:DIMENSIONS?|COORDINATES?|VALUES?|MEASUREMENTS?)\s+(?:ARE\s+)?IN\s+INCH(?:ES)?\b"
    r"|\bINCH\s+(?:MODE|UNITS|PROGRAM)\b"
)
_STATES_MM = re.compile(
    _STATED + r"(?:MM|MILLIMET(?:ER|RE)S?|METRIC)\b"
    r"|\b(?:DIMENSIONS?|COORDINATES?|VALUES?|MEASUREMENTS?)\s+(?:ARE\s+)?IN\s+"
    r"(?:MM|MILLIMET(?:ER|RE)S?)\b"
    r"|\b(?:METRIC|MM)\s+(?:MODE|UNITS|PROGRAM)\b"
)
_HINTS_AT_INCH = re.compile(
    rf"{_STATES_INCH.pattern}|\bINCH(?:ES)?\b|\bIMPERIAL\b"
    r"|(?:[0-9]*\.[0-9]+|[0-9]+/[0-9]+)(?:\s*IN\b|\")"
)
_CODES_OF_UNITS = {"siemens": "G70, G71, G700 or G710", "fagor": "G70 or G71"}
_FUNCTIONS = re.compile(r"\b(?:ATAN|FIX|FUP|MOD)\b")
_LOGIC = re.compile(r"(?<![A-Z_<])(?:AND|OR|XOR)(?![A-Z_>])")
_COMPARISON = re.compile(r"(?<![A-Z_<])(?:EQ|NE|GT|GE|LT|LE)(?![A-Z_>])")

_HAAS = (
    (re.compile(r"G\s*10(?=.*L1[23])"), "R of G10 L12 and L13 as a radius (Haas: a diameter)"),
    (re.compile(r"#\s*2[0-6][0-9]{2}(?![0-9])"), "#2001 and on as FANUC numbers offsets"),
    (re.compile(r"G(?:73|83)(?=.*P)"), "P of G73 and G83 without effect (Haas: a dwell)"),
    (re.compile(r"G51(?=.*[PIJK]\s*[0-9]+(?![0-9.]))"), "a scale without a point in thousandths"),
    (re.compile(r"M98\s*P\s*[0-9]{5,8}(?![0-9.])(?!.*L)"), "P of M98 with the number of repeats"),
)
"""Words that FANUC and Haas read differently, without a warning where they stand."""


class AssumedReading(NamedTuple):
    """What the first lines leave open.

    Attributes:
        units: What is assumed of the units; empty if a code names them.
        doubt: The warning of a comment that names other units.
        differences: Words with another meaning on another controller, and the one taken.
    """

    units: str = ""
    doubt: Diagnostic | None = None
    differences: tuple[str, ...] = ()

    def described(self) -> list[str]:
        """Return the assumptions, for the summary."""
        return [*self.differences, *([self.units] if self.units else [])]


def assumed_reading(
    lines: Sequence[str], rules: Dialect, file: str, recognition: Recognition | None
) -> AssumedReading:
    """Return what the first lines of a program leave open.

    Args:
        lines: The lines.
        rules: The dialect in which they are read.
        file: The program, for the warning.
        recognition: The evidence by which the dialect was chosen; None if it was named.
    """
    differences = []
    if rules.name == "auto":
        names = " and ".join(differing_functions(lines))
        differences += [f"{names} as LinuxCNC computes them, not FANUC"] if names else []
    if recognition is not None and recognition.five_digits:
        differences.append(_as_fanuc(lines))
    if rules.flavour == "klartext":
        begins = any(_BEGIN.match(code_of(line)) for _, line in first_lines(lines))
        return AssumedReading("" if begins else "millimetres, as there is no BEGIN PGM")
    inch, mm = _codes_of_units(lines, rules)
    units = ""
    if not (inch or mm):
        codes = _CODES_OF_UNITS.get(rules.name, "G20 or G21")
        units = f"millimetres, as no {codes} is in the first lines"
    doubt = _doubt(lines, file, inch=inch, mm=mm)
    return AssumedReading(units, doubt, tuple(differences))


def _as_fanuc(lines: Sequence[str]) -> str:
    """Return how a program is read whose number may be one of FANUC's or of Haas'."""
    codes = [code_of(line) for _, line in first_lines(lines)]
    words = [text for pattern, text in _HAAS if any(pattern.search(code) for code in codes)]
    listed = f": {', '.join(words)}" if words else ""
    return f"FANUC, not Haas, whose program numbers have five digits, too{listed}"


def _codes_of_units(lines: Sequence[str], rules: Dialect) -> tuple[bool, bool]:
    """Return whether the first lines have a code for inches, and one for mm."""
    codes = [code_of(line) for _, line in first_lines(lines)]
    # G70 and G71 are cycles on Haas' and FANUC's controls.
    more = 70 in rules.aliases
    inch, mm = (
        any(own.search(code) or (more and other.search(code)) for code in codes)
        for own, other in ((_INCH, _OTHER_INCH), (_MM, _OTHER_MM))
    )
    return inch, mm


def _doubt(lines: Sequence[str], file: str, *, inch: bool, mm: bool) -> Diagnostic | None:
    """Return the warning of a comment that names other units than those that are read."""
    if inch and mm:
        return None
    comments = [
        (number, comment.upper())
        for number, line in first_lines(lines)
        for comment in comments_of(line)
    ]
    named = inch or mm
    if not named and any(_STATES_MM.search(text) for _, text in comments):
        return None
    pattern = _STATES_MM if inch else _STATES_INCH if mm else _HINTS_AT_INCH
    for number, text in comments:
        if found := pattern.search(text):
            written = " ".join(found[0].split())
            read = "inches" if inch else "millimetres"
            why = "" if named else ", as no code of the first lines names the units"
            message = f"the comment says {written}, but numbers are read as {read}{why}"
            hint = "write the code of the units at the start of the program"
            return Diagnostic(
                "units-doubtful", message, file, number, hint=hint, severity="warning"
            )
    return None


def differing_functions(lines: Sequence[str]) -> tuple[str, ...]:
    """Return the functions in the first lines that FANUC and LinuxCNC compute differently.

    They are named with the arguments for which they differ.
    """
    codes = [code_of(line) for _, line in first_lines(lines)]
    functions = {name for code in codes for name in _FUNCTIONS.findall(code)}
    # Of comparisons, which are 0 or 1, the bits and the truth are the same.
    plain = [code for code in codes if not _COMPARISON.search(code)]
    logic = {name for code in plain for name in _LOGIC.findall(code)}
    groups = (functions, "negative numbers"), (logic, "other numbers than 0 and 1")
    return tuple(f"{', '.join(sorted(names))} of {of}" for names, of in groups if names)
