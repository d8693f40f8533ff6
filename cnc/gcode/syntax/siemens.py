"""Lines of SINUMERIK in the words of RS274/NGC.

A line is translated word by word, and the grammar of RS274/NGC reads the result. So ``X=IC(R1)``
becomes a sum of the position and a named parameter. Words without a counterpart are data
(``dialects/siemens_words.toml``): they are either without effect here, or refused by name. Source:
Siemens, "SINUMERIK 840D sl/828D Programming Manual, Fundamentals" and "Job Planning".
"""

from __future__ import annotations

import re
import tomllib
import zlib
from functools import lru_cache
from importlib.resources import files
from typing import NamedTuple

from cnc.gcode.syntax.error_context import about_character
from cnc.gcode.syntax.siemens_arrays import (
    elements,
    following,
    initial_values,
    left_from,
    list_of,
)
from cnc.gcode.syntax.siemens_control import (
    ControlLine,
    call_line,
    control_line,
)
from cnc.gcode.syntax.siemens_expressions import Cursor, closing
from cnc.gcode.syntax.siemens_messages import message_of
from cnc.gcode.syntax.siemens_variables import Variables, as_type, without_comment
from cnc.gcode.syntax.statement import DIAMETERS, DIRECTION, NOTED, SHOWN, Remark
from cnc.gcode.syntax.words import fault

FIRST_NAMED_TOOL, MOST_NAMED_TOOLS = 90_000, 10_000
"""Range of the numbers of tools that a program calls by a name; a checksum gives the number."""

_HEAD = re.compile(
    r"\s*(/[0-9]?)?\s*(?:([N:])\s*([0-9]+))?\s*(?:([A-Z_][A-Z0-9_]+)\s*:(?!=))?\s*", re.I
)
_ASSIGN = re.compile(r"R([0-9]+)\s*=(?!=)\s*", re.I)
_VARIABLE = re.compile(r"([A-Z_]{2}[A-Z0-9_]*)\s*=(?!=)\s*", re.I)
_INDEXED = re.compile(r"([A-Z_][A-Z0-9_]*)\s*\[", re.I)
_LIST = re.compile(r"\s*(?:SET|REP)\s*\(", re.I)
_DECLARED = re.compile(r"EXTERN\s+[A-Z_][A-Z0-9_]+\s*(?:\(.*\))?", re.I)
"""The parameters of a subprogram, which its PROC has too."""
_TOOL_NAME = re.compile(r'T\s*=\s*"([^"]*)"', re.I)
_EQUAL = re.compile(
    r"(CR|AR|TURN|AP|RPL|RP|RNDM|RND|CHR|CHF|ANG|SD|PL|PW|S1|M1|[ABC][2-7]|[A-Z])\s*=(?!=)\s*", re.I
)
_KEYWORD = re.compile(r"[A-Z_][A-Z_]+[0-9]*", re.I)
_PLAIN = re.compile(r"([A-Z])\s*([-+]?\s*(?:[0-9]+\.?[0-9]*|\.[0-9]+))", re.I)
_NUMBER = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)")
_LETTERS = {
    "CR": "R", "AP": "^", "RP": "@", "S1": "S", "M1": "M", "RND": ",R", "CHR": ",C", "CHF": ",H",
    "ANG": ",A", "AR": ",O",
}  # fmt: skip
_DIRECTIONS = {"DC": "shortest", "ACP": "positive", "ACN": "negative", "IC": "counted"}
_TRANSFORMATIONS = {"TRAORI": "G43.4", "TRAFOOF": "G49"}
_DIAMETERS = ("DIAMON", "DIAMOF", "DIAM90")
_TOOL_TURNS = {"ORIAXES": "linear", "ORIVECT": "circle", "ORIPLANE": "circle"}
_NO_DIRECTION = {
    "2": "Euler or RPY angle",
    "4": "surface normal",
    "5": "surface normal",
    "6": "direction of a cone",
    "7": "orientation between",
}
_ADDRESSES = ("SD", "PL", "PW", "A3", "B3", "C3")
_POLAR_HERE = {"^": "[ATAN[#<_y>]/[#<_x>]]", "@": "SQRT[#<_x>*#<_x>+#<_y>*#<_y>]"}
"""Angle and radius of the position, from which AP=IC() and RP=IC() count."""
_COORDINATES = frozenset("XYZABCUVWIJK^@")
"""Letters whose value may count from the position."""
_CENTRES = {"I": "x", "J": "y", "K": "z"}


class Translation(NamedTuple):
    """A line in the words of RS274/NGC.

    Attributes:
        text: The line.
        remarks: A message, and words without effect.
        deletable: Whether the line begins with ``/``.
        control: A jump, block, cycle or frame, with its values as expressions; None for none.
    """

    text: str = ""
    remarks: tuple[Remark, ...] = ()
    deletable: bool = False
    control: ControlLine | None = None


@lru_cache(maxsize=1)
def _words() -> dict[str, dict[str, str]]:
    file = files("cnc.gcode.dialects").joinpath("siemens_words.toml")
    return tomllib.loads(file.read_text(encoding="utf-8"))


@lru_cache(maxsize=1)
def _no_names() -> frozenset[str]:
    """Return the words that are no names of subprograms."""
    tables = _words()
    words = tables["not-needed"].keys() | tables["only-zero"].keys() | tables["refused"].keys()
    return frozenset(
        words | _TRANSFORMATIONS.keys() | {*_TOOL_TURNS, *_DIAMETERS, "SUPA", "BSPLINE"}
    )


def translate(text: str, variables: Variables = ()) -> Translation:
    """Translate a line.

    Args:
        text: The line.
        variables: Variables that the program defines. Names that begin with an underscore need no
            definition.

    Raises:
        GcodeError: A word is not supported.
    """
    return _Line(text, variables).translation()


class _Line(Cursor):
    """A line that is being translated."""

    def __init__(self, text: str, variables: Variables) -> None:
        super().__init__(without_comment(text), variables)
        self.out: list[str] = []
        self.remarks: list[Remark] = []
        self.is_absolute = bool(re.search(r"(?<![A-Z])G90(?![0-9])", self.text, re.I))
        self.is_incremental = bool(re.search(r"(?<![A-Z])G91(?![0-9])", self.text, re.I))

    def translation(self) -> Translation:
        """Return the translation of the whole line."""
        head = _HEAD.match(self.text)
        assert head
        self.at = head.end()
        if head[3]:
            self.out.append(f"N{head[3]}")
        deletable = bool(head[1])
        rest = self.text[self.at :].strip()
        if (message := message_of(rest, self._value_of)) is not None:
            self.remarks.append(Remark(SHOWN, message, self.at + 1, len(rest)))
            return self._done(deletable)
        if _DECLARED.fullmatch(rest):
            return self._done(deletable)
        control = control_line(rest, lambda what, hint: self.fault(what, len(rest), hint))
        if control := control or call_line(rest, _no_names()):
            if control.keyword == "s-def":
                control = self._defined(control)
            elif control.keyword == "s-for":
                control = control._replace(label=self.stored(control.label))
            values = tuple(self.ngc(value) if value else "" for value in control.values)
            return self._done(deletable)._replace(control=control._replace(values=values))
        while self.skip():
            self._word()
        return self._done(deletable)

    def _defined(self, control: ControlLine) -> ControlLine:
        """Return a DEF with the names or numbers of its parameters here, and a value for each."""
        names: list[str] = []
        values: list[str] = []
        for name, value in zip(control.label.split(), control.values, strict=True):
            if not name.endswith("["):
                names.append(self.stored(name))
                values.append(value)
                continue
            known = self.variables.get(name[:-1].upper())
            found = initial_values(known, value) if known and known.sizes else None
            if known is None or found is None:
                hint = "write DEF REAL NAME[3]=SET(1,2) or =REP(0) in the main program"
                raise self.fault(f"this definition of the array {name[:-1].upper()}", 1, hint)
            names += [f"#{number}" for number in elements(known)]
            values += found
        return control._replace(label=" ".join(names), values=tuple(values))

    def _element(self, name: str) -> None:
        """Translate the assignment to an element of an array, or by SET and REP to several."""
        end = closing(self.text, self.at)
        index = self.text[self.at + 1 : end]
        number = self.element(name, index)
        self.at = end + 1
        self.skip()
        if self.text[self.at : self.at + 1] != "=":
            raise self.fault(f"{name.upper()}[..] without a value", 1, f"write {name}[1]=5")
        self.at += 1
        known = self.variables.get(name.upper())
        kind = known.kind if known else "REAL"
        found = _LIST.match(self.text, self.at)
        if found is None:
            self.out.append(f"#[{number}]=[{self.ngc(as_type(kind, self.written_value()))}]")
            return
        array, indices = self.array(name, index)
        begin, self.at = self.at, closing(self.text, found.end() - 1) + 1
        left = left_from(array, indices) if array else None
        for step, value in enumerate(self._listed(self.text[begin : self.at], left)):
            place = following(array, indices, step) if array else f"{number}+{step}"
            self.out.append(f"#[{place}]=[{self.ngc(as_type(kind, value))}]")

    def _listed(self, text: str, left: int | None) -> list[str]:
        """Return the values of SET or REP; ``left`` elements are there, if that is known."""
        kind, values = list_of(text) or ("", [])
        if kind == "REP":
            count = values[1] if len(values) == 2 else "" if left is None else str(left)
            if not count.isdigit() or len(values) > 2:
                raise self.fault("REP without a number of elements", 1, "write REP(0,5), or SET")
            values = values[:1] * int(count)
        if not all(values):
            raise self.fault(f"{kind} with a value left out", 1, "write each value")
        return values

    def _done(self, deletable: bool) -> Translation:
        return Translation(" ".join(self.out), tuple(self.remarks), deletable)

    def _word(self) -> None:
        """Translate the next word."""
        if name := _TOOL_NAME.match(self.text, self.at):
            number = FIRST_NAMED_TOOL + zlib.crc32(name[1].encode()) % MOST_NAMED_TOOLS
            what = f"the tool {name[1]!r} has the number T{number} here"
            self.remarks.append(Remark(NOTED, what, self.at + 1, len(name[0])))
            self.out.append(f"T{number}")
            self.at = name.end()
        elif (element := _INDEXED.match(self.text, self.at)) and self._has_elements(element[1]):
            self.at = element.end() - 1
            self._element(element[1])
        elif assignment := _ASSIGN.match(self.text, self.at):
            self.at = assignment.end()
            self.out.append(f"#<_r{int(assignment[1])}>=[{self.expression()}]")
        elif (name := _VARIABLE.match(self.text, self.at)) and self.is_variable(name[1]):
            self.at = name.end()
            known = self.variables.get(name[1].upper())
            value = as_type(known.kind if known else "REAL", self.written_value())
            self.out.append(f"#<{self.stored(name[1])}>=[{self.ngc(value)}]")
        elif equal := _EQUAL.match(self.text, self.at):
            self.at = equal.end()
            self._address(equal[1].upper())
        elif (keyword := _KEYWORD.match(self.text, self.at)) and not _is_code(keyword[0]):
            self._keyword(keyword[0].upper())
        elif plain := _PLAIN.match(self.text, self.at):
            self.at = plain.end()
            self.out.append(self._code(plain[1].upper(), re.sub(r"\s", "", plain[2])))
        else:
            self._refuse_foreign_character()
            raise self.fault(f"{self.text[self.at]!r}", 1, "")

    def _refuse_foreign_character(self) -> None:
        """Raise the error of a character outside of ASCII, which may follow a letter."""
        for at in (self.at, self.at + 1):
            char = self.text[at : at + 1]
            if char and not char.isascii():
                message, hint = about_character(char)
                raise fault("character-unknown", message, column=at + 1, hint=hint)

    def _value_of(self, name: str) -> str | None:
        """Return the name here of an R parameter or a variable; None for another name."""
        is_value = re.fullmatch(r"R[0-9]+", name, re.I) or self.is_variable(name)
        return self.stored(name) if is_value else None

    def _has_elements(self, name: str) -> bool:
        known = self.variables.get(name.upper())
        return name.upper() == "R" or (known is not None and bool(known.sizes))

    def _code(self, letter: str, number: str) -> str:
        if letter == "M" and number == "17":
            raise self.fault("M17 beside other words", 1, "write M17 in a line of its own")
        if letter == "L":
            raise self.fault(f"L{number} (call of a subprogram)", 1, "")
        return letter + number

    def _address(self, name: str) -> None:
        """Translate an address with = and its value."""
        if name[0] in "ABC" and name[1:2] in _NO_DIRECTION:
            what = f"{name}= ({_NO_DIRECTION[name[1]]})"
            raise self.fault(what, 1, "give A3= B3= C3=, or the angles of the axes")
        found = re.compile(r"(IC|AC|DC|ACP|ACN)\s*\(", re.I).match(self.text, self.at)
        mode = found[1].upper() if found else ""
        if found:
            self.at = found.end() - 1
        begin = self.at
        value = self.expression()
        letter = _LETTERS.get(name, name)
        if name in "ABC" and mode in _DIRECTIONS:
            text = f"{letter} {_DIRECTIONS[mode]}"
            self.remarks.append(Remark(DIRECTION, text, begin + 1, 1))
        elif mode in ("DC", "ACP", "ACN"):
            self.at = begin
            hint = f"{mode} is for the rotary axes A, B and C"
            raise self.fault(f"{name}={mode}(..)", 1, hint)
        if name == "RPL":
            raise self.fault("RPL without ROT or AROT", 1, "")
        if name == "RNDM":
            if value.strip("0.") == "":
                return
            raise self.fault("RNDM (rounding of each corner)", 1, "write RND= at each corner")
        if name == "TURN":
            self.out.append(f"P[{value}+1]")
        elif name in _CENTRES and mode == "AC":
            value = f"[{value}]*#<_x_absolute>" if name == "I" else value
            self.out.append(f"{letter}[{value}-#<_{_CENTRES[name]}>]")
        elif name in _ADDRESSES:
            if mode:
                raise self.fault(f"{name}={mode}(..)", 1, "")
            self.out.append(f"{name}=[{value}]")
        elif found and letter not in _COORDINATES:
            self.at = found.start()
            raise self.fault(f"{name}={mode}(..)", 1, f"{mode} is for coordinates")
        elif mode:
            self.out.append(f"{letter}[{self._from_here(letter, mode, value)}]")
        else:
            self.out.append(f"{letter}{value if _NUMBER.fullmatch(value) else f'[{value}]'}")

    def _from_here(self, letter: str, mode: str, value: str) -> str:
        """Return a coordinate in the distance mode of the line."""
        here = _POLAR_HERE.get(letter) or f"#<_{letter.lower()}>"
        if letter == "X":
            return self._x_from_here(mode, value)
        if mode == "IC":
            if self.is_incremental or letter in _CENTRES:
                return value
            return f"{value}+{here}" if self.is_absolute else f"{value}+{here}*#<_absolute>"
        if self.is_absolute:
            return value
        return f"{value}-{here}" if self.is_incremental else f"{value}-{here}*#<_incremental>"

    def _x_from_here(self, mode: str, value: str) -> str:
        """Return X, which may be a diameter, in the distance mode of the line."""
        if mode == "IC":
            if self.is_incremental:
                return value
            total = f"[[{value}]*#<_x_incremental>+#<_x>]/#<_x_absolute>"
            here = f"{total}*#<_absolute>+[{value}]*#<_incremental>"
            return total if self.is_absolute else here
        if self.is_absolute:
            return value
        step = f"[[{value}]*#<_x_absolute>-#<_x>]/#<_x_incremental>"
        here = f"{step}*#<_incremental>+[{value}]*#<_absolute>"
        return step if self.is_incremental else here

    def _keyword(self, name: str) -> None:
        """Translate a word of letters, with its brackets or its value."""
        begin = self.at
        self.at += len(name)
        tables = _words()
        if name in ("SUPA", "G153"):
            self.out.append("G53")
        elif name in _TRANSFORMATIONS:
            self._pass_value()
            self.out.append(_TRANSFORMATIONS[name])
        elif name in tables["only-zero"]:
            self._only_zero(name, tables["only-zero"][name])
        elif name == "BSPLINE":
            self.out.append(name)
        elif name in _TOOL_TURNS:
            self.remarks.append(
                Remark(DIRECTION, f"TOOL {_TOOL_TURNS[name]}", begin + 1, len(name))
            )
        elif name in _DIAMETERS:
            self.remarks.append(Remark(DIAMETERS, name, begin + 1, len(name)))
        elif name in tables["not-needed"]:
            self._pass_value()
            what = f"{name} ({tables['not-needed'][name]}) has no effect here"
            self.remarks.append(Remark(NOTED, what, begin + 1, len(name)))
        else:
            self.at = begin
            what = tables["refused"].get(name, "a name, or a word that is not known")
            hint = tables["instead"].get(name, "")
            if name not in tables["refused"] and self.text[begin + len(name) :].lstrip()[:1] == "(":
                what = "call of a subprogram with values"
                hint = "write its moves in place of the call, or hand values over in R parameters"
            raise self.fault(f"{name} ({what})", len(name), hint)

    def _only_zero(self, name: str, what: str) -> None:
        """Pass a word whose value other than 0 would move the path otherwise."""
        begin = self.at - len(name)
        self._pass_value()
        value = self.text[begin + len(name) : self.at].lstrip(" \t=")
        if not value or value.strip("0."):
            self.at = begin
            raise self.fault(f"{name} ({what})", len(name), f"only {name}=0 is read")

    def _pass_value(self) -> None:
        """Pass the = and value, or the brackets, of a word without effect."""
        self.skip()
        if self.text[self.at : self.at + 1] == "=":
            self.at += 1
            self.expression()
        elif self.text[self.at : self.at + 1] == "(":
            self.at = closing(self.text, self.at) + 1


def _is_code(word: str) -> bool:
    """Whether letters and digits are one or more words such as G17 or M6."""
    return re.fullmatch(r"[A-Z][0-9]+", word, re.I) is not None
