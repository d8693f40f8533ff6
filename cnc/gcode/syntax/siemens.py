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

from cnc.gcode.syntax.statement import Remark
from cnc.gcode.syntax.words import fault
from cnc.model.diagnostics import GcodeError

NOTED = "noted"
"""Kind of the remark that names a word without effect."""
FIRST_NAMED_TOOL, MOST_NAMED_TOOLS = 90_000, 10_000
"""Range of the numbers of tools that a program calls by a name; a checksum gives the number."""

_HEAD = re.compile(
    r"\s*(/[0-9]?)?\s*(?:([N:])\s*([0-9]+))?\s*(?:([A-Z_][A-Z0-9_]+)\s*:(?!=))?\s*", re.I
)
_MESSAGE = re.compile(r'MSG\s*\(\s*(?:"([^"]*)")?\s*\)', re.I)
_JUMP = re.compile(r"(?:IF\s*(.+?)\s+)?GOTO[FB]?\s+N?([0-9]+)\s*$", re.I)
_ANY_JUMP = re.compile(r"\b(?:GOTO[FBCS]?|IF)\b", re.I)
_CYCLE = re.compile(r"(MCALL)?\s*(?:CYCLE(8[123])\s*\((.*)\))?\s*$", re.I)
_ASSIGN = re.compile(r"R([0-9]+)\s*=(?!=)\s*", re.I)
_TOOL_NAME = re.compile(r'T\s*=\s*"([^"]*)"', re.I)
_EQUAL = re.compile(r"(CR|TURN|AP|RP|RPL|S1|M1|[A-Z])\s*=(?!=)\s*", re.I)
_KEYWORD = re.compile(r"[A-Z_][A-Z_]+[0-9]*", re.I)
_PLAIN = re.compile(r"([A-Z])\s*([-+]?\s*(?:[0-9]+\.?[0-9]*|\.[0-9]+))", re.I)
_OPERAND = re.compile(
    r"\s*[-+]?\s*(?:[0-9]+\.?[0-9]*|\.[0-9]+|R[0-9]+|[A-Z][A-Z0-9]*(?=\s*\())", re.I
)
_OPERATOR = re.compile(r"\s*(\*\*|==|<>|<=|>=|[-+*/<>]|\bMOD\b|\bAND\b|\bOR\b)", re.I)
_LETTERS = {"CR": "R", "AP": "^", "RP": "@", "S1": "S", "M1": "M"}
_COMPARED = {"==": "EQ", "<>": "NE", "<=": "LE", ">=": "GE", "<": "LT", ">": "GT"}
_FUNCTIONS = {"SIN", "COS", "TAN", "ASIN", "ACOS", "SQRT", "ABS", "ROUND", "LN", "EXP", "TRUNC"}
_CENTRES = {"I": "x", "J": "y", "K": "z"}
_FRAMES = {"AMIRROR": "G51.1", "ASCALE": "G51", "AROT": "G68 X0 Y0"}
_FRAME_ENDS = {"MIRROR": "G50.1", "SCALE": "G50", "ROT": "G69", "AROT": "G69"}


class Translation(NamedTuple):
    """A line in the words of RS274/NGC.

    Attributes:
        text: The line.
        remarks: A message, and words without effect.
        deletable: Whether the line begins with ``/``.
        condition: Condition of a jump, as an expression; empty for none.
        target: N number that the line jumps to, or None.
        cycle: Number of a drilling cycle (81 to 83), 0 for the end of a modal one, or None.
        modal: Whether the cycle is executed after each following move.
        arguments: Arguments of the cycle, as expressions; empty where left out.
    """

    text: str = ""
    remarks: tuple[Remark, ...] = ()
    deletable: bool = False
    condition: str = ""
    target: int | None = None
    cycle: int | None = None
    modal: bool = False
    arguments: tuple[str, ...] = ()


@lru_cache(maxsize=1)
def _words() -> dict[str, dict[str, str]]:
    file = files("cnc.gcode.dialects").joinpath("siemens_words.toml")
    return tomllib.loads(file.read_text(encoding="utf-8"))


def translate(text: str) -> Translation:
    """Translate a line.

    Raises:
        GcodeError: A word is not supported.
    """
    return _Line(text).translation()


class _Line:
    """A line that is being translated."""

    def __init__(self, text: str) -> None:
        self.text = _without_comment(text)
        self.at = 0
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
        if message := _MESSAGE.fullmatch(rest):
            self.remarks.append(Remark("msg", message[1] or "", self.at + 1, len(rest)))
            return self._done(deletable)
        if jump := _JUMP.fullmatch(rest):
            condition = self._ngc(jump[1]) if jump[1] else ""
            return self._done(deletable)._replace(condition=condition, target=int(jump[2]))
        if _ANY_JUMP.match(rest):
            raise self._fault(
                "a jump other than IF .. GOTOF N100", len(rest), "jump to an N number"
            )
        if rest and (cycle := _CYCLE.fullmatch(rest)):
            arguments = tuple(self._ngc(part) for part in _arguments(cycle[3] or ""))
            found = self._done(deletable)._replace(modal=bool(cycle[1]), arguments=arguments)
            return found._replace(cycle=int(cycle[2]) if cycle[2] else 0)
        while self._skip():
            self._word()
        return self._done(deletable)

    def _done(self, deletable: bool) -> Translation:
        return Translation(" ".join(self.out), tuple(self.remarks), deletable)

    def _skip(self) -> bool:
        """Pass blanks; return whether a word follows."""
        while self.at < len(self.text) and self.text[self.at] in " \t":
            self.at += 1
        return self.at < len(self.text)

    def _word(self) -> None:
        """Translate the next word."""
        if name := _TOOL_NAME.match(self.text, self.at):
            number = FIRST_NAMED_TOOL + zlib.crc32(name[1].encode()) % MOST_NAMED_TOOLS
            what = f"the tool {name[1]!r} has the number T{number} here"
            self.remarks.append(Remark(NOTED, what, self.at + 1, len(name[0])))
            self.out.append(f"T{number}")
            self.at = name.end()
        elif assignment := _ASSIGN.match(self.text, self.at):
            self.at = assignment.end()
            self.out.append(f"#<_r{int(assignment[1])}>=[{self._expression()}]")
        elif equal := _EQUAL.match(self.text, self.at):
            self.at = equal.end()
            self._address(equal[1].upper())
        elif (keyword := _KEYWORD.match(self.text, self.at)) and not _is_code(keyword[0]):
            self._keyword(keyword[0].upper())
        elif plain := _PLAIN.match(self.text, self.at):
            self.at = plain.end()
            self.out.append(self._code(plain[1].upper(), re.sub(r"\s", "", plain[2])))
        else:
            raise self._fault(f"{self.text[self.at]!r}", 1, "")

    def _code(self, letter: str, number: str) -> str:
        if letter == "G" and re.fullmatch(r"64[1-5]", number):
            return "G64"
        if letter == "G" and re.fullmatch(r"60[1-3]", number):
            return ""
        if letter == "G" and number in ("60",):
            return "G61.1"
        if letter == "M" and number in ("17",):
            return "M2"
        if letter == "L":
            raise self._fault(f"L{number} (call of a subprogram)", 1, "")
        return letter + number

    def _address(self, name: str) -> None:
        """Translate an address with = and its value."""
        found = re.compile(r"(IC|AC|DC)\s*\(", re.I).match(self.text, self.at)
        mode = found[1].upper() if found else ""
        if found:
            self.at = found.end() - 1
        value = self._expression()
        letter = _LETTERS.get(name, name)
        if name == "RPL":
            raise self._fault("RPL without AROT", 1, "")
        if name == "TURN":
            self.out.append(f"P[{value}+1]")
        elif name in _CENTRES and mode == "AC":
            self.out.append(f"{letter}[{value}-#<_{_CENTRES[name]}>]")
        elif mode:
            self.out.append(f"{letter}[{self._from_here(letter, mode, value)}]")
        else:
            self.out.append(f"{letter}[{value}]")

    def _from_here(self, letter: str, mode: str, value: str) -> str:
        """Return a coordinate in the distance mode of the line."""
        here = f"#<_{letter.lower()}>"
        if mode == "IC":
            if self.is_incremental or letter in _CENTRES:
                return value
            return f"{value}+{here}" if self.is_absolute else f"{value}+{here}*#<_absolute>"
        if self.is_absolute:
            return value
        return f"{value}-{here}" if self.is_incremental else f"{value}-{here}*#<_incremental>"

    def _keyword(self, name: str) -> None:
        """Translate a word of letters, with its brackets or its value."""
        begin = self.at
        self.at += len(name)
        tables = _words()
        if name in ("SUPA", "G153"):
            self.out.append("G53")
        elif name == "RET":
            self.out.append("M2")
        elif name == "TRANS":
            given = self._axes()
            words = " ".join(f"{axis}[{given.get(axis, '0')}]" for axis in "XYZ")
            self.out.append(f"G69 G52 {words}")
        elif name in _FRAMES or name in _FRAME_ENDS:
            self._frame(name, begin)
        elif name in tables["not-needed"]:
            self._pass_value()
            what = f"{name} ({tables['not-needed'][name]}) has no effect here"
            self.remarks.append(Remark(NOTED, what, begin + 1, len(name)))
        else:
            self.at = begin
            what = tables["refused"].get(name, "a name, or a word that is not known")
            raise self._fault(f"{name} ({what})", len(name), "")

    def _frame(self, name: str, begin: int) -> None:
        """Translate AROT, AMIRROR, ASCALE, and the ends of frames."""
        rest = self.text[self.at :].strip()
        if not rest and name in _FRAME_ENDS:
            self.out.append(_FRAME_ENDS[name])
            return
        if name not in _FRAMES:
            self.at = begin
            raise self._fault(f"{name} ({_words()['refused'][name]})", len(name), "")
        if name == "AROT":
            self._skip()
            plane = re.compile(r"(?:RPL\s*=|Z\s*=?)\s*", re.I).match(self.text, self.at)
            if plane is None:
                raise self._fault("AROT about another axis than Z", 4, "give RPL= or Z")
            self.at = plane.end()
            self.out.append(f"G68 X0 Y0 R[{self._expression()}]")
            return
        given = self._axes()
        letters = dict(zip("XYZ", "IJK", strict=True)) if name == "ASCALE" else {}
        words = [f"{letters.get(axis, axis)}[{value}]" for axis, value in given.items()]
        centre = " X0 Y0 Z0" if name == "ASCALE" else ""
        self.out.append(f"{_FRAMES[name]}{centre} {' '.join(words)}")

    def _axes(self) -> dict[str, str]:
        """Take the axis words to the end of the line."""
        found: dict[str, str] = {}
        while self._skip():
            axis = re.compile(r"([XYZ])\s*=?\s*", re.I).match(self.text, self.at)
            if axis is None:
                raise self._fault("a word that is no axis", 1, "write it on a line of its own")
            self.at = axis.end()
            found[axis[1].upper()] = self._expression()
        return found

    def _pass_value(self) -> None:
        """Pass the = and value, or the brackets, of a word without effect."""
        self._skip()
        if self.text[self.at : self.at + 1] == "=":
            self.at += 1
            self._expression()
        elif self.text[self.at : self.at + 1] == "(":
            self.at = _closing(self.text, self.at) + 1

    def _expression(self) -> str:
        """Take an expression; return it in the words of RS274/NGC."""
        begin = self.at
        while True:
            while self.at < len(self.text) and self.text[self.at] in " \t":
                self.at += 1
            if operand := _OPERAND.match(self.text, self.at):
                self.at = operand.end()
                self._blank_before_bracket()
            elif self.text[self.at : self.at + 1] in ("-", "+"):
                self.at += 1
                continue
            if self.text[self.at : self.at + 1] == "(":
                self.at = _closing(self.text, self.at) + 1
            elif operand is None:
                raise self._fault("an expression that is not complete", 1, "")
            operator = _OPERATOR.match(self.text, self.at)
            if operator is None:
                return self._ngc(self.text[begin : self.at])
            self.at = operator.end()

    def _blank_before_bracket(self) -> None:
        end = self.at
        while end < len(self.text) and self.text[end] in " \t":
            end += 1
        if self.text[end : end + 1] == "(":
            self.at = end

    def _ngc(self, expression: str) -> str:
        """Return an expression in the words of RS274/NGC."""
        text = expression.strip()
        for name in re.findall(r"([A-Z][A-Z0-9]*)\s*\(", text, re.I):
            if name.upper() not in _FUNCTIONS:
                raise self._fault(f"{name.upper()}(..)", len(name), "")
        text = re.sub(r"==|<>|<=|>=|<|>", lambda found: f" {_COMPARED[found[0]]} ", text)
        text = re.sub(r"\bTRUNC\b", "FIX", text, flags=re.I)
        text = re.sub(r"\bR([0-9]+)\b", lambda found: f"#<_r{int(found[1])}>", text, flags=re.I)
        return text.replace("(", "[").replace(")", "]")

    def _fault(self, what: str, length: int, hint: str) -> GcodeError:
        hint = hint or "this looks like SINUMERIK; docs/reference/language.md lists what is read"
        return fault(
            "code-not-supported", f"{what} is not supported", column=self.at + 1, length=length,
            hint=hint,
        )  # fmt: skip


def _is_code(word: str) -> bool:
    """Whether letters and digits are one or more words such as G17 or M6."""
    return re.fullmatch(r"[A-Z][0-9]+", word, re.I) is not None


def _without_comment(text: str) -> str:
    """Return a line without the comment after a semicolon, which may not stand in quotes."""
    quoted = False
    for at, char in enumerate(text):
        if char == '"':
            quoted = not quoted
        elif char == ";" and not quoted:
            return text[:at]
    return text


def _closing(text: str, begin: int) -> int:
    """Return the position of the bracket that closes the one at ``begin``."""
    depth = 0
    for at in range(begin, len(text)):
        depth += (text[at] == "(") - (text[at] == ")")
        if depth == 0:
            return at
    raise fault("bracket-not-closed", "this ( is not closed", column=begin + 1)


def _arguments(text: str) -> list[str]:
    """Return the arguments of a cycle, split at commas outside of brackets."""
    parts, depth, begin = [], 0, 0
    for at, char in enumerate(text):
        depth += (char == "(") - (char == ")")
        if char == "," and depth == 0:
            parts.append(text[begin:at])
            begin = at + 1
    return [part.strip() for part in (*parts, text[begin:])]
