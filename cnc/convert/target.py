"""The control that a program is written for: codes with the same meaning, and its spelling."""

from __future__ import annotations

import re
from collections.abc import Container
from dataclasses import dataclass, field
from typing import cast

from cnc.convert.turning import TARGETS, LatheCodes
from cnc.gcode.core.coordinates import SYSTEM_CODES
from cnc.gcode.core.modal_groups import GROUP_OF_G, GROUP_OF_M
from cnc.gcode.dialects import Dialect
from cnc.gcode.reader.statements import Statement
from cnc.gcode.reader.words import G, Word
from cnc.grbl_lines.number_format import plain_text
from cnc.model.blocks import PathControl
from cnc.model.choices import TargetName

# Codes that mean the same in every dialect that has them. The proof compares the motion; this table
# is about what no block shows: a stored position, a memory of the control, an operator's action.

_SHARED_G = frozenset(
    G(round(10 * code))
    for code in (
        0, 1, 2, 3, 17, 18, 19, 20, 21, 40, 53, 54, 55, 56, 57, 58, 59, 59.1, 59.2, 59.3, 61.1, 64,
        80, 90, 90.1, 91, 91.1, 92, 93, 94, 96, 97, 98, 99,
    )
)  # fmt: skip
_CYCLES = frozenset(G(10 * code) for code in (73, 81, 82, 83, 85, 86, 89))
_WITH_TABLES = frozenset(G(10 * code) for code in (41, 42, 43, 49))
_SHARED_M = frozenset((0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 30, 48, 49))
_BULK_G = frozenset((0, 1, 2, 3, 17, 18, 19, 20, 21, 90, 91, 94))
_BULK_M = frozenset((3, 4, 5, 7, 8, 9))
_FAMILIES = {
    "fanuc": "macro-b", "haas": "macro-b",
    "linuxcnc": "rs274", "grbl": "rs274", "auto": "rs274", "paper": "rs274",
}  # fmt: skip
_FLOW = {"fanuc": "macro-b", "haas": "macro-b", "linuxcnc": "ngc", "auto": "ngc"}
"""Language of loops, branches and calls by dialect; that of others is their own."""
_SPLINES = {"linuxcnc": "G5.2", "fanuc": "G6.2", "siemens": "BSPLINE"}
"""Code of a B-spline. A Haas control reads FANUC's codes, but has no NURBS."""
_FLOW_G, _FLOW_M = frozenset((G.G65, G.G66, G.G67)), frozenset((97, 98, 99))
_WITHOUT_TABLES = ("siemens", "fagor", "marlin")
"""Dialects whose G43 and G41 take no number of an offset, and whose cycles are others."""

_NO_COMMANDS = bytes.maketrans(b"!?~" + bytes(range(128, 256)), b"..-" + 128 * b".")
"""GRBL takes these bytes for commands, even in a comment."""
_COMMENT = re.compile(r"\(((?:[^()]|\([^()]*\))*)\)?|;(.*)")
"""A comment, in which another one in brackets may stand."""
_SEMICOLON = re.compile(r"(\([^)]*\)?)|;(.*)")
_COMMAND = re.compile(r"[ \t]*(msg|debug|print|log|probe|py|abort)", re.IGNORECASE)
_ISO_WORD = re.compile(
    rb"(\([^)\r\n]*\)?|;[^\r\n]*)|[Rr][ \t]*([-+]?[0-9.]+)|[Gg][ \t]*0*2([01])(?![0-9.])"
)
"""A comment, or a word that SINUMERIK has in another form: the radius of an arc (R alone is a
parameter), G20 and G21.
"""
_POINTLESS = re.compile(
    rb"(\([^)\r\n]*\)?|;[^\r\n]*)|([XYZABCUVWIJKR][+-]?[0-9]+)(?![0-9.])", re.IGNORECASE
)


@dataclass
class Target:
    """A control, seen from another one.

    Attributes:
        rules: Its dialect.
        source: The dialect of the program.
        is_lathe: Whether the machine is a lathe, where no line with code is kept.
        refused: Forms of lines that the proof has shown to mean something else here.
        takes_runs: Whether many plain lines may be taken as they are.
        compensates: Whether lines under cutter compensation may be taken as they are.
    """

    rules: Dialect
    source: Dialect
    is_lathe: bool = False
    refused: set[tuple[str, ...]] = field(default_factory=set)
    takes_runs: bool = True
    compensates: bool = True

    def __post_init__(self) -> None:
        source, rules = self.source, self.rules
        own = _FAMILIES.get(source.name, source.name)
        self.same_family = own == _FAMILIES.get(rules.name, rules.name)
        shared = _SHARED_G
        if source.name not in _WITHOUT_TABLES and rules.name not in _WITHOUT_TABLES:
            shared = shared | _CYCLES | _WITH_TABLES
        if source.dwell == rules.dwell:
            shared = shared | {G.G4}
        common = source.g & rules.g
        changed = {code.code for code in common} & (source.aliases.keys() | rules.aliases.keys())
        # G20 and G21 get SINUMERIK's spelling where their lines are kept.
        changed |= rules.spelled.keys() - {G.G20.code, G.G21.code}
        noted = source.noted.keys() | rules.noted.keys()
        changed |= {number for letter, number in noted if letter == "G"}
        kept = common - _FLOW_G if self.same_family else common & shared
        self.same_flow = _FLOW.get(source.name, source.name) == _FLOW.get(rules.name, rules.name)
        if self.is_lathe:
            self.same_flow = self.takes_runs = False
        self.g = frozenset(code for code in kept if code.code not in changed)
        m = source.m & rules.m
        m = m - _FLOW_M if self.same_family else m & _SHARED_M
        self.m = frozenset(code for code in m if ("M", float(code)) not in noted)
        self.bulk_g = frozenset(int(code) for code in self.g if code.code in _BULK_G)
        self.bulk_m = frozenset(int(code) for code in self.m if int(code) in _BULK_M)
        self.letters = frozenset("GMNFSTIJKRPQLHD") | rules.axes

    # Reading of the program's lines

    def can_keep(self, statement: Statement) -> bool:
        """Return whether each word of a line means the same here."""
        if statement.computed or statement.assignments or statement.control or statement.board:
            return False
        if statement.percent or statement.remarks or (self.is_lathe and statement.words):
            return False
        if statement.deletable and self.rules.name in ("grbl", "marlin"):
            return False
        return self._has_words(statement, self.g, self.m) and (
            self.form(statement) not in self.refused
        )

    def can_keep_flow(self, statement: Statement) -> bool:
        """Return whether a line of a program with the same flow means the same here."""
        then = statement.control.then if statement.control else None
        return all(
            self._has_words(part, self.g | _FLOW_G, self.m | (_FLOW_M & self.rules.m))
            for part in (statement, then)
            if part is not None
        )

    def _has_words(self, statement: Statement, g: Container[int], m: Container[int]) -> bool:
        for word in statement.words:
            if word.letter not in self.letters:
                return False
            if word.letter == "G" and (word.tenths is None or word.tenths not in g):
                return False
            if word.letter == "M" and (word.whole is None or word.whole not in m):
                return False
        return True

    @staticmethod
    def form(statement: Statement) -> tuple[str, ...]:
        """Return the codes and letters of a line, by which similar lines are recognised."""
        return tuple(
            sorted(
                f"{word.letter}{word.number:g}" if word.letter in "GM" else word.letter
                for word in statement.words
                if word.letter != "N"
            )
        )

    def in_group(self, words: tuple[Word, ...], group: str) -> bool:
        """Return whether a line has a code of a modal group."""
        return any(
            (
                word.letter == "G"
                and word.tenths in GROUP_OF_G
                and GROUP_OF_G[G(word.tenths)] == group
            )
            or (word.letter == "M" and GROUP_OF_M.get(word.whole) == group)  # type: ignore[call-overload]
            for word in words
        )

    # Writing

    @property
    def tool_change(self) -> bool:
        """Whether the control changes tools: by M6, or by the T word of a turret."""
        return self.is_lathe or 6 in self.rules.m

    @property
    def lathe(self) -> LatheCodes:
        """The codes of the control's lathes."""
        return TARGETS[cast(TargetName, self.rules.name)]

    def has_overrides(self, feed: bool, spindle: bool) -> bool:
        """Return whether the control has codes that allow these overrides."""
        return (48 if feed == spindle else 50) in self.rules.m

    @property
    def spline(self) -> str:
        """The code of a B-spline; empty where the control has none."""
        return _SPLINES.get(self.rules.name, "")

    def units(self, scale: float) -> str:
        """Return the code of millimetres (a scale of 1) or inches, for distances and feeds.

        It is empty where the control has none.
        """
        if (G.G21 if scale == 1.0 else G.G20) not in self.rules.g:
            return ""
        if self.rules.name == "siemens":
            return "G710" if scale == 1.0 else "G700"
        return "G21" if scale == 1.0 else "G20"

    def path_code(self, control: PathControl) -> str:
        """Return the code of a path mode; empty where the control has none."""
        has = self.rules.g
        if control == "exact-stop" and G.G61_1 in has:
            return "G60" if self.rules.name == "siemens" else "G61.1"
        code, g = ("G64", G.G64) if control == "blend" else ("G61", G.G61)
        says_it = control == "blend" or (control == self.rules.motion.path_stop and G.G64 in has)
        return code if says_it and g in has else ""

    def spelled(self, text: bytes) -> bytes:
        """Return lines of the program as this control reads them: comments, decimal points."""
        if self.rules.lines.decimal_points:
            text = _POINTLESS.sub(lambda at: at[1] or at[2] + b".", text)
        if self.rules.name == "siemens" and self.source.flavour != "siemens":
            text = _ISO_WORD.sub(_of_sinumerik, text)
        if self.rules.name == "grbl":
            text = text.translate(_NO_COMMANDS)
        if b";" in text and self.rules.name in ("fanuc", "haas", "mach3"):
            lines = text.decode("latin-1").split("\n")
            text = "\n".join(map(self._round_brackets, lines)).encode("latin-1")
        elif b"(" in text and self.rules.name in ("siemens", "marlin"):
            lines = text.decode("latin-1").split("\n")
            text = "\n".join(map(self._behind_semicolon, lines)).encode("latin-1")
        return text

    @staticmethod
    def _round_brackets(line: str) -> str:
        end = "\r" if line.endswith("\r") else ""
        return (
            _SEMICOLON.sub(lambda at: at[1] or f"({_inside(at[2])})", line.removesuffix("\r")) + end
        )

    def _behind_semicolon(self, line: str) -> str:
        texts = comments(line)
        if not texts:
            return line
        code = _COMMENT.sub("", line.rstrip("\r")).rstrip()
        return f"{code} {'; '.join(['', *texts]).lstrip()}".lstrip()

    def comment(self, text: str) -> str:
        """Return a line with a comment."""
        if self.rules.name in ("siemens", "marlin"):
            return f"; {text.strip()}"
        if self.rules.name == "grbl":
            text = plain_text(text)
        return f"({_inside(text)})"

    @property
    def systems(self) -> int:
        """Number of coordinate systems: G54 and those that follow it, or one without a code."""
        count = 0
        while count < len(SYSTEM_CODES) and SYSTEM_CODES[count] in self.rules.g:
            count += 1
        return max(count, 1)

    def ends(self) -> str:
        """Return the line that ends a program; empty where the text ends it."""
        if 30 not in self.rules.m:
            return ""
        return "M2" if self.rules.name == "linuxcnc" else "M30"


def _of_sinumerik(at: re.Match[bytes]) -> bytes:
    """Return a comment as it is, and a word in SINUMERIK's form."""
    if at[1] is not None:
        return at[1]
    return b"CR=" + at[2] if at[2] is not None else b"G7" + at[3] + b"0"


def comments(text: str) -> list[str]:
    """Return the comments of a line."""
    return [(at[1] if at[1] is not None else at[2]).strip() for at in _COMMENT.finditer(text)]


def without_comments(text: str) -> str:
    """Return the code of a line."""
    return _COMMENT.sub("", text)


def _inside(text: str) -> str:
    """Return text for a comment in brackets that gives no command."""
    text = text.replace("(", "[").replace(")", "]").strip()
    return f"- {text}" if _COMMAND.match(text) else text


def number(value: float, digits: int) -> str:
    """Return a number with at most ``digits`` decimals; a whole one ends in a point."""
    text = f"{value:.{digits}f}".rstrip("0")
    return "0." if text in ("-0.", "0.") else text
