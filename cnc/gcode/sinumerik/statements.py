"""Lines of SINUMERIK as statements.

Each rule of the grammar has a method of its name here. A line of words is executed as one of
RS274/NGC; ``X=IC(R1)`` is a sum of the position and a parameter. Source: Siemens, "SINUMERIK 840D
sl/828D Programming Manual, Fundamentals" and "Job Planning".
"""

from __future__ import annotations

import math
import re
import zlib
from dataclasses import dataclass
from typing import Any, NamedTuple, cast

from cnc.gcode.reader.expressions import Builder, Node, constant
from cnc.gcode.reader.parameters import Names, Parameters, Variable
from cnc.gcode.reader.statements import (
    DIAMETERS,
    DIRECTION,
    NOTED,
    REMARK,
    SHOWN,
    UNCHECKED,
    Assignment,
    Control,
    ExpressionRules,
    Keyword,
    Remark,
    Statement,
    Token,
    Value,
    squeezed,
)
from cnc.gcode.reader.words import MAX_NUMBER, Word
from cnc.gcode.sinumerik.variables import (
    KINDS,
    MOST_ELEMENTS,
    describe,
    elements,
    left_from,
    no_names,
    not_supported,
    number_of,
    parameters_of,
    refused,
    sizes_of,
    words,
)
from cnc.model.diagnostics import GcodeError

FIRST_NAMED_TOOL, MOST_NAMED_TOOLS = 90_000, 10_000
"""Range of the numbers of tools that a program calls by a name; a checksum gives the number."""
MOST_CALLS = 9999
"""Most repeats of a call."""
_NUMBER = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)")
_RADIUS = re.compile(r"(?<![A-Z_$])R *[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)", re.IGNORECASE)
_LABEL = re.compile(r"[A-Z_][A-Z0-9_]+")
_FRAME = re.compile(r"A?(TRANS|ROT|SCALE|MIRROR)")
_DISTANCE = re.compile(r"(?<![A-Z])G9([01])(?![0-9])", re.IGNORECASE)
"""G90 or G91."""
_CENTRES = {"I": "_x", "J": "_y", "K": "_z"}
_COORDINATES = frozenset("XYZABCUVWIJK^@")
"""Letters whose value may count from the position."""
_ENDS = {17.0: "", 2.0: "2", 30.0: "30"}
_LEVEL = slice(4, 13)
"""Arguments of CYCLE800: zero before the rotation (3), angles (3), zero after it (3)."""
_COMPARED_LAST = frozenset(("==", "<>", "<=", ">=", "<", ">", "AND", "XOR", "OR"))


@dataclass(slots=True, eq=False)
class _Called(Node):
    """What is no part of a sum: ``IC(..)``, ``SET(..)``, and a value that only a control knows."""

    name: str = ""
    arguments: tuple[Node | Token | None, ...] = ()


class _Word(NamedTuple):
    """A word with its value, if that is computed."""

    word: Word
    value: Value | None


class _Named(NamedTuple):
    """A name, with what follows = or stands in brackets.

    Attributes:
        name: The name.
        end: Position after it, with its value.
        value: The value behind =, if there is one.
        arguments: What stands in brackets; None for a name without them.
    """

    name: Token
    end: int
    value: Node | Token | None = None
    arguments: tuple[Node | Token | None, ...] | None = None


class _Sums:
    """Sums and products with the position, all at one place of a line."""

    def __init__(self, build: Builder, place: tuple[int, int]) -> None:
        self._build, self._place = build, place

    def of(self, left: Node | str, sign: str, right: Node | str) -> Node:
        """Return a sum or a product; names are those of parameters."""
        a, b = (
            self._build.parameter(value, *self._place) if isinstance(value, str) else value
            for value in (left, right)
        )
        return self._build.binary(a, sign, b, *self._place)

    def position(self, letter: str) -> Node:
        """Return the position of an axis, or the angle (^) or radius (@) of that in the plane."""
        if letter not in "^@":
            return self._build.parameter(f"_{letter.lower()}", *self._place)
        x, y = (self._build.parameter(name, *self._place) for name in ("_x", "_y"))
        if letter == "^":
            return self._build.arctangent(y, x, self._place[0])
        squares = self.of(self.of(x, "*", x), "+", self.of(y, "*", y))
        return self._build.call("SQRT", squares, *self._place)


def _nothing(_: Parameters) -> float:
    """Return what an argument is that is left out."""
    return math.nan


class Lines(ExpressionRules):
    """Makes the statement of one line."""

    def __init__(self, text: str, names: Names, shift: int = 0) -> None:
        """Create the maker of a line.

        Args:
            text: The line.
            names: The variables of the program.
            shift: Position of the line in the text of the events.
        """
        super().__init__(text, Builder(language="siemens"), shift)
        self._names = names
        self._remarks: list[Remark] = []
        self._loose: list[tuple[Node, str]] = []

    def refused(self, place: int, wanted: frozenset[str]) -> GcodeError:
        """Return the error at the place where the line does not go on as its grammar says.

        R and a number are a parameter, which needs =; the radius of an arc is CR. Source: Siemens,
        "SINUMERIK 840D sl/828D Programming Manual, Fundamentals", "Circular interpolation with
        radius and end point", "Arithmetic parameters".
        """
        for match in _RADIUS.finditer(self._text):
            if match.start() < place and not self._text[match.end() : place].strip():
                written = squeezed(match[0])
                hint = f"write CR={written[1:]} for the radius of an arc"
                if written[1:].isdigit():
                    hint += f", or {written}=.. for a parameter"
                return not_supported(f"{written} without =", match.start(), match.end(), hint)
        return describe(self._text, place, wanted)

    def number(self, begin: int, end: int, value: float) -> Node:
        """Return a number as a node."""
        if value == math.inf:
            message = "this number is too large"
            raise self._build.fault("number-too-large", message, begin, end)
        return constant(value, begin, end)

    # Expressions

    def _binary(self, begin: int, end: int, left: Node, operator: Token, right: Node) -> Node:
        sign = operator.text
        made = super()._binary(begin, end, left, operator, right)
        if sign not in _COMPARED_LAST:
            return made
        inside = {id(node): name for node, name in self._loose}
        before, after = inside.get(id(left), ""), inside.get(id(right), "")
        if operator.terminal == "COMPARE" and (before or after):
            first, second = (before, sign) if before else (sign, after)
            what = f"{first} and {second} without brackets"
            hint = "SINUMERIK compares last: write brackets, as in (R1>2) AND (R2<5)"
            raise not_supported(what, operator.begin, operator.end, hint)
        self._loose.append((made, before or sign))
        return made

    def _function(self, begin: int, end: int, function: Token, argument: Node) -> Node:
        build = self._build
        if function.text == "POT":
            return build.binary(argument, "**", constant(2.0, end, end), begin, function.end)
        return build.call(function.text, argument, function.begin, function.end)

    def _call(self, begin: int, end: int, name: Token, *parts: Node | Token) -> Node:
        given = _arguments(parts)
        if name.text == "ATAN2":
            if len(given) != 2:
                what = f"ATAN2 with {len(given)} values"
                raise not_supported(what, name.begin, name.end)
            y, x = (self._value(argument, name) for argument in given)
            return self._build.arctangent(y, x, begin).spanning(begin, end)
        if name.text not in words()["axes"] and name.text not in ("SET", "REP"):
            raise self._no_value(name)
        return _Called((), begin, end, name=name.text, arguments=tuple(given))

    def _variable(self, begin: int, end: int, name: Token) -> Node:
        if name.terminal == "SYSTEM":
            return _Called((), begin, end, name=name.text)
        if name.terminal == "REGISTER" or self._names.is_variable(name.text):
            return self._build.parameter(self._stored(name), begin, end)
        if name.text in ("TRUE", "FALSE"):
            return constant(float(name.text == "TRUE"), begin, end)
        raise self._no_value(name)

    def _cell(self, begin: int, end: int, name: Token, index: list[Node]) -> Node:
        number = number_of(self._array(name, index), index)
        return self._build.parameter(number.spanning(begin, end), begin, end)

    def _index(self, begin: int, end: int, *parts: Node | Token) -> list[Node | Token | None]:
        return _arguments(parts)

    def _axis(self, begin: int, end: int, letter: Token, *number: Node) -> Token:
        return letter._replace(text=squeezed(self._text[begin:end]), end=end)

    def _part(self, node: Node) -> Node:
        """Return a part of an expression, which must have one value."""
        if isinstance(node, _Called):
            what = f"{node.name} in an expression"
            raise not_supported(what, node.begin, node.begin + len(node.name))
        return node

    def _value(self, given: Node | Token | None, of: Token) -> Node:
        """Return a value in brackets."""
        if isinstance(given, Node):
            return self._part(given)
        what = f"{of.text} without a value" if given is None else f"{given.text} as a value"
        place = of if given is None else given
        raise not_supported(what, place.begin, place.end)

    def _no_value(self, name: Token) -> GcodeError:
        hint = "define a variable by DEF REAL at the beginning of the main program"
        return not_supported(f"{name.text} in an expression", name.begin, name.end, hint)

    def _stored(self, name: Token) -> str:
        """Return the name here of an R parameter or a variable."""
        if self._names.is_ambiguous(name.text):
            what = f"{name.text} (a variable of more than one program of this text)"
            hint = "give each variable a name of its own"
            raise not_supported(what, name.begin, name.end, hint)
        variable = self._names.find(name.text)
        if variable and variable.sizes:
            what = f"{variable.name} (an array) without an index"
            raise not_supported(what, name.begin, name.end)
        return self._names.stored(name.text)

    def _array(self, name: Token, index: list[Node]) -> Variable | None:
        """Return the array of an element; None for R."""
        written = squeezed(self._text[name.begin : index[-1].end]) if index else name.text
        plain = all(isinstance(part, Node) and self._part(part) for part in index)
        if plain and name.text == "R" and len(index) == 1:
            return None
        variable = self._names.find(name.text)
        if variable is None or len(variable.sizes) != len(index) or not plain:
            what = f"{written}] (no array of that name, or another number of indices)"
            hint = "define it by DEF REAL NAME[10] at the beginning of the main program"
            raise not_supported(what, name.begin, name.end, hint)
        return variable

    def _as_type(self, kind: str, node: Node) -> Node:
        """Return a value as a type keeps it: INT is rounded, BOOL is 0 or 1."""
        node = self._part(node)
        if kind == "INT":
            return self._build.call("ROUND", node, node.begin, node.end)
        if kind == "BOOL":
            zero = constant(0.0, node.end, node.end)
            return self._build.binary(node, "<>", zero, node.begin, node.end)
        return node

    # Words

    def _number(self, begin: int, end: int, _colon: Token, number: Node) -> _Word:
        return self._made("N", number.spanning(begin + 1, end), begin, end)

    def _word(self, begin: int, end: int, letter: Token, number: Node) -> _Word:
        return self._made(letter.text, number.spanning(letter.end, end), begin, end)

    def _assigned(
        self, begin: int, end: int, letter: Token, _equal: Token, right: Node | Token
    ) -> _Word:
        if isinstance(right, Token):
            return self._tool(letter, right, begin, end)
        return self._address(letter.text, right, begin, end)

    def _indexed(
        self, begin: int, end: int, letter: Token, number: Node, _equal: Token, right: Node | Token
    ) -> _Word | Assignment | None:
        name = letter._replace(
            text=squeezed(self._text[begin : number.end]), begin=begin, end=number.end
        )
        if re.fullmatch("R[0-9]+", name.text):
            return self._assignment(self._names.stored(name.text), self._value(right, name), name)
        if name.text in words()["addresses"]:
            return self._address(name.text, self._a_value(right, name), begin, end)
        what = f"{name.text}="
        if meaning := words()["directions"].get(name.text[1:]) if letter.text in "ABC" else None:
            hint = "give A3= B3= C3=, or the angles of the axes"
            raise not_supported(f"{what} ({meaning})", name.begin, name.end, hint)
        if re.fullmatch("[SM][2-9]", name.text):
            self._other_spindle(name.text[1], begin, end)
            return None
        raise not_supported(what, name.begin, name.end)

    def _other_spindle(self, number: str, begin: int, end: int) -> None:
        """Note a word of another spindle: a driven tool or a second spindle."""
        column, length = self._build.place(begin, end)
        what = f"{squeezed(self._text[begin:end])} (spindle {number})"
        self._remarks.append(Remark(UNCHECKED, what, column, length))

    def _named(
        self, begin: int, end: int, name: Token, _equal: Token, right: Node | Token
    ) -> _Named | Assignment:
        if not self._names.is_variable(name.text):
            return _Named(name, end, value=right)
        stored, variable = self._stored(name), self._names.find(name.text)
        kind = variable.kind if variable else "REAL"
        return self._assignment(stored, self._as_type(kind, self._value(right, name)), name)

    def _element(
        self, begin: int, end: int, name: Token, index: list[Node], _equal: Token, right: Node
    ) -> list[Assignment]:
        if name.text in words()["refused"]:
            raise refused(name.text, begin)
        array = self._array(name, index)
        values = [right]
        if isinstance(right, _Called) and right.name in ("SET", "REP"):
            left = left_from(array, index) if array else None
            values = [self._part(part) for part in self._listed(right, left)]
        kind = array.kind if array else "REAL"
        return [
            self._assignment(number_of(array, index, step).value, self._as_type(kind, value), name)
            for step, value in enumerate(values)
        ]

    def _keyword(self, begin: int, end: int, name: Token) -> _Named:
        return _Named(name, end)

    def _command(self, begin: int, end: int, name: Token, *parts: Node | Token) -> _Named:
        return _Named(name, end, arguments=tuple(_arguments(parts)))

    def _assignment(self, target: str | Value, value: Node, name: Token) -> Assignment:
        column, length = self._build.place(name.begin, name.end)
        return Assignment(target, value.result, column, length)

    def _listed(self, listed: _Called, left: int | None) -> list[Node]:
        """Return the values of SET or REP; ``left`` elements are there, if that is known."""
        kind, values = listed.name, listed.arguments
        place = listed.begin, listed.begin + 3
        if kind == "REP":
            given = values[1] if len(values) == 2 else None
            count = given.number if isinstance(given, Node) else left
            if count is None or count != int(count) or not 1 <= len(values) <= 2:
                what = "REP without a number of elements"
                raise not_supported(what, *place, "write REP(0,5), or SET")
            values = values[:1] * int(count)
        nodes = [value for value in values if isinstance(value, Node)]
        if len(nodes) < len(values) or not nodes:
            raise not_supported(f"{kind} with a value left out", *place, "write each value")
        return nodes

    def _made(self, letter: str, value: Node, begin: int, end: int) -> _Word:
        """Return a word with a value, which is a number or is computed."""
        column, length = self._build.place(begin, end)
        written = squeezed(self._text[value.begin : value.end])
        if not _NUMBER.fullmatch(written):
            word = Word(letter, math.nan, f"{letter}[{written}]", column, length)
            return _Word(word, self._part(value).result)
        number = float(written)
        if abs(number) > MAX_NUMBER:
            message = f"the number after {letter} is larger than {MAX_NUMBER:.0f}"
            raise self._build.fault("number-too-large", message, begin, end)
        return _Word(Word(letter, number, f"{letter}{written}", column, length), None)

    def _tool(self, letter: Token, name: Token, begin: int, end: int) -> _Word:
        """Return the word of a tool with a name."""
        if letter.text != "T":
            raise not_supported(f"{letter.text}={name.text}", begin, end)
        tool = name.text[1:-1]
        number = FIRST_NAMED_TOOL + zlib.crc32(tool.encode()) % MOST_NAMED_TOOLS
        column, length = self._build.place(begin, end)
        what = f"the tool {tool!r} has the number T{number} here"
        self._remarks.append(Remark(NOTED, what, column, length))
        return _Word(Word("T", float(number), f"T{number}", column, length), None)

    def _address(self, name: str, right: Node, begin: int, end: int) -> _Word:
        """Return the word of an address with = and its value."""
        letter = words()["addresses"].get(name, name)
        if not isinstance(right, _Called):
            return self._made(letter, right, begin, end)
        mode = right.name
        given = Token("NAME", mode, right.begin, right.begin + len(mode))
        if mode not in words()["axes"] or len(right.arguments) != 1 or len(letter) > 1:
            raise not_supported(f"{name}={mode}(..)", begin, right.end)
        value = self._value(right.arguments[0], given)
        if letter not in _COORDINATES:
            hint = f"{mode} is for coordinates"
            raise not_supported(f"{name}={mode}(..)", right.begin, right.end, hint)
        if letter in "ABC" and (turn := words()["axes"][mode]):
            column, _ = self._build.place(right.begin, right.end)
            self._remarks.append(Remark(DIRECTION, f"{letter} {turn}", column, 1))
        elif mode in ("DC", "ACP", "ACN"):
            hint = f"{mode} is for the rotary axes A, B and C"
            raise not_supported(f"{name}={mode}(..)", begin, right.end, hint)
        value = self._from_here(letter, mode, value, (begin, end))
        column, length = self._build.place(begin, end)
        written = f"{letter}[{squeezed(self._text[right.begin : right.end])}]"
        return _Word(Word(letter, math.nan, written, column, length), value.value)

    def _from_here(self, letter: str, mode: str, value: Node, place: tuple[int, int]) -> Node:
        """Return a coordinate in the distance mode of the line."""
        if letter in _CENTRES and mode == "IC":
            return value
        sums = _Sums(self._build, place)
        if letter in _CENTRES:
            whole = sums.of(value, "*", "_x_absolute") if letter == "I" else value
            return sums.of(whole, "-", _CENTRES[letter])
        modes = _DISTANCE.findall(self._text)
        absolute, incremental = "0" in modes, "1" in modes
        same, other = (incremental, absolute) if mode == "IC" else (absolute, incremental)
        if same:
            return value
        own, foreign = (
            ("_incremental", "_absolute") if mode == "IC" else ("_absolute", "_incremental")
        )
        sign = "+" if mode == "IC" else "-"
        if letter == "X":
            # A diameter, or a radius.
            there = sums.of(sums.of(value, "*", f"_x{own}"), sign, "_x")
            moved = sums.of(there, "/", f"_x{foreign}")
            if other:
                return moved
            return sums.of(sums.of(moved, "*", foreign), "+", sums.of(value, "*", own))
        here = sums.position(letter)
        return sums.of(value, sign, here if other else sums.of(here, "*", foreign))

    def _words_of(self, item: _Named) -> list[_Word]:
        """Return the words of a name, with its value or brackets."""
        name, begin = item.name.text, item.name.begin
        tables = words()
        column, length = self._build.place(begin, item.end)
        if item.value is not None and (name in tables["addresses"] or name in ("TURN", "RPL")):
            value = self._a_value(item.value, item.name)
            if name == "RPL":
                raise not_supported("RPL without ROT or AROT", begin, item.name.end)
            if name == "TURN":
                unit = constant(1.0, item.end, item.end)
                sum_ = self._build.binary(self._part(value), "+", unit, begin, item.end)
                written = f"P[{squeezed(self._text[value.begin : value.end])}+1]"
                return [_Word(Word("P", math.nan, written, column, length), sum_.value)]
            return [self._address(name, value, begin, item.end)]
        if name == "RNDM" and item.value is not None:
            if not self._is_zero(item.value):
                hint = "write RND= at each corner"
                raise not_supported("RNDM (rounding of each corner)", begin, item.end, hint)
            return []
        if name in tables["codes"]:
            code = tables["codes"][name]
            made = [_Word(Word(code[0], float(code[1:]), name, column, length), None)]
            return [*made, self._diameter(item)] if name == "TRACYL" else made
        if name == "BSPLINE":
            return [_Word(Word(name, 1.0, name, column, length), None)]
        if name in tables["turns"]:
            self._remarks.append(Remark(DIRECTION, f"TOOL {tables['turns'][name]}", column, length))
        elif name in tables["diameters"]:
            self._remarks.append(Remark(DIAMETERS, name, column, length))
        elif name in tables["only-zero"]:
            if item.value is None or not self._is_zero(item.value):
                what = f"{name} ({tables['only-zero'][name]})"
                raise not_supported(what, begin, item.name.end, f"only {name}=0 is read")
        elif name == "SETMS" and item.arguments and not self._is_first(item.arguments[0]):
            self._other_spindle("other than 1", begin, item.end)
        elif name in tables["not-needed"]:
            what = f"{name} ({tables['not-needed'][name]}) has no effect here"
            self._remarks.append(Remark(NOTED, what, column, len(name)))
        else:
            raise refused(name, begin, values=item.arguments is not None)
        return []

    def _diameter(self, item: _Named) -> _Word:
        """Return the word of the diameter of TRACYL."""
        given = item.arguments or (None,)
        if not isinstance(given[0], Node) or any(value is not None for value in given[1:]):
            hint = "write the diameter of the cylinder alone, such as TRACYL(40)"
            raise not_supported("TRACYL of this form", item.name.begin, item.end, hint)
        return self._made("TRACYL", given[0], item.name.begin, item.end)

    def _a_value(self, given: Node | Token, of: Token) -> Node:
        """Return the value behind =, which may be counted from here."""
        return given if isinstance(given, Node) else self._value(given, of)

    def _is_first(self, given: Node | Token | None) -> bool:
        return isinstance(given, Node) and given.number == 1.0

    def _is_zero(self, given: Node | Token | None) -> bool:
        return isinstance(given, Node) and given.number == 0.0

    # Control lines

    def _jump(self, begin: int, end: int, *parts: Token | Node) -> Control:
        goto, target = parts[-2:]
        assert isinstance(goto, Token)
        assert isinstance(target, Token)
        direction = goto.text[4:]
        if direction in ("C", "S"):
            hint = "write GOTOF, GOTOB or GOTO and a label or N number"
            raise not_supported("a jump of this form", goto.begin, goto.end, hint)
        number = re.fullmatch("[N:]?([0-9]+)", target.text)
        label = str(int(number[1])) if number else target.text
        condition = (self._value(parts[1], goto).value,) if len(parts) == 4 else ()
        return self._control("s-goto", label, condition, begin, end, (direction,))

    def _condition(self, begin: int, end: int, keyword: Token, condition: Node) -> Control:
        kind = cast(Keyword, f"s-{keyword.text.lower()}")
        return self._control(kind, "", (self._part(condition).value,), begin, end)

    def _count(
        self, begin: int, end: int, _for: Token, name: Token, _equal: Token, first: Node,
        _to: Token, last: Node,
    ) -> Control:  # fmt: skip
        if name.terminal != "REGISTER" and not self._names.is_variable(name.text):
            raise self._no_value(name)
        values = self._part(first).value, self._part(last).value
        return self._control("s-for", self._stored(name), values, begin, end)

    def _again(self, begin: int, end: int, keyword: Token, *parts: Token | Node) -> Control:
        labels = [part.text for part in parts if isinstance(part, Token)]
        count: Node | None = None
        if isinstance(parts[-1] if parts else None, Node):
            count = self._part(cast(Node, parts[-1]))
            *labels, letter, _ = labels
            labels += [letter] if letter != "P" else []
        elif len(labels) > 1 and re.fullmatch("P[0-9]+", labels[-1]):
            count = constant(float(labels.pop()[1:]), end, end)
        if not labels and count is None and keyword.text == "REPEAT":
            return self._control("s-repeat", "", (), begin, end)
        if not 1 <= len(labels) <= (2 if keyword.text == "REPEAT" else 1):
            raise refused(keyword.text, begin)
        value = _one if count is None else count.value
        return self._control("s-again", keyword.text, (value,), begin, end, tuple(labels))

    def _defined(
        self, begin: int, end: int, name: Token, *parts: Any
    ) -> tuple[Token, list[Any] | None, Node | None]:
        index = next((part for part in parts if isinstance(part, list)), None)
        return name, index, next((part for part in parts if isinstance(part, Node)), None)

    def _definition(
        self, begin: int, end: int, keyword: Token, kind: Token, *parts: Any
    ) -> Control:
        if kind.text not in KINDS or isinstance(parts[0], list):
            raise refused("DEF", begin)
        names: list[str | int] = []
        values: list[Node] = []
        for part in parts:
            if isinstance(part, Token):
                continue
            name, index, value = part
            if index is not None:
                numbers, listed = self._defined_array(name, kind.text, index, value)
                names += numbers
                values += listed
            elif len(name.text) < 2:
                hint = f"DEF REAL NAME=1.5, OTHER[3,2] is read; {MOST_ELEMENTS} elements at most"
                raise not_supported(f"DEF {kind.text} of this form", name.begin, name.end, hint)
            else:
                names.append(self._stored(name))
                first = constant(0.0, end, end) if value is None else value
                values.append(self._as_type(kind.text, first))
        given = tuple(each.value for each in values)
        return self._control("s-def", "", given, begin, end, tuple(names))

    def _defined_array(
        self, name: Token, kind: str, index: list[Any], value: Node | None
    ) -> tuple[list[int], list[Node]]:
        """Return the numbers of the parameters of a new array, and a value for each."""
        sizes = [
            squeezed(self._text[part.begin : part.end]) if isinstance(part, Node) else ""
            for part in index
        ]
        if not sizes_of(sizes):
            hint = f"DEF REAL NAME=1.5, OTHER[3,2] is read; {MOST_ELEMENTS} elements at most"
            raise not_supported(f"DEF {kind} of this form", name.begin, name.end, hint)
        variable = self._names.find(name.text)
        numbers = elements(variable) if variable and variable.sizes else []
        zero = constant(0.0, name.end, name.end)
        listed: list[Node] | None = [zero] * len(numbers)
        if value is not None:
            is_list = isinstance(value, _Called) and value.name in ("SET", "REP")
            listed = self._listed(cast(_Called, value), len(numbers)) if is_list else None
        if not numbers or listed is None or len(listed) > len(numbers):
            hint = "write DEF REAL NAME[3]=SET(1,2) or =REP(0) in the main program"
            what = f"this definition of the array {name.text}"
            raise not_supported(what, name.begin, name.end, hint)
        listed += [zero] * (len(numbers) - len(listed))
        return numbers, [self._as_type(kind, part) for part in listed]

    def _procedure(self, begin: int, end: int, keyword: Token, name: Token, *parts: Any) -> Control:
        given = next((part for part in parts if isinstance(part, list)), [])
        for mode in parts:
            if isinstance(mode, Token) and mode.text not in ("DISPLOF", "SBLOF"):
                hint = "write the codes again after the call"
                raise not_supported(f"PROC with {mode.text}", mode.begin, mode.end, hint)
        parameters = parameters_of(given)
        if parameters is None:
            hint = "REAL, INT and BOOL are read, without VAR"
            raise not_supported("PROC with these parameters", begin, end, hint)
        names = tuple(name for part in parameters for name in (part.stored, part.kind))
        return self._control("s-proc", "", (), begin, end, names)

    def _declaration(self, begin: int, end: int, *parts: Any) -> None:
        """EXTERN: the parameters of a subprogram, which its PROC has too."""

    def _parameters(self, begin: int, end: int, *parts: Any) -> list[Any]:
        return [part for part in parts if not isinstance(part, Token)]

    def _defined_as(self, begin: int, end: int, *parts: Any) -> tuple[Any, ...]:
        return parts

    def _message(self, begin: int, end: int, keyword: Token, *parts: Token | Node) -> Remark:
        """Return a message: texts in quotes, and ``#<name>`` for values.

        A value that only a control knows, such as ``$AA_IW[X]``, and one that is computed in the
        message have the name ``?``; they are shown as unknown.
        """
        pieces = parts[:-2] if len(parts) > 1 and _is_comma(parts[-2]) else parts
        text = "".join(map(self._piece, pieces))
        return Remark(SHOWN, text, *self._build.place(begin, end))

    def _piece(self, piece: Token | Node) -> str:
        if isinstance(piece, Token):
            return piece.text
        written = squeezed(self._text[piece.begin : piece.end])
        if _NUMBER.fullmatch(written):
            return f'"{float(written):.10g}"'
        index = getattr(piece, "index", None)
        return f"#<{index if isinstance(index, str) else '?'}>"

    # The whole line

    def _block(self, begin: int, end: int, *items: Any) -> Statement:
        deletable = bool(items) and items[0].__class__ is Token and items[0].terminal == "DELETE"
        rest = [item for item in items if item.__class__ is not Token and item is not None]
        if len(rest) < len(items):
            rest = _without_comments(items)
        number: list[_Word] = []
        if rest and rest[0].__class__ is _Word and rest[0].word.letter == "N":
            number = [rest.pop(0)]
        rest = self._without_label(rest, number[0].word if number else None)
        control = self._control_of(rest)
        if control is not None:
            return Statement(control=control, deletable=deletable)
        if len(rest) == 1 and rest[0].__class__ is _Word and rest[0].word.letter == "O":
            # The number of a program has no effect.
            return Statement(deletable=deletable)
        words: list[_Word] = list(number)
        assignments: list[Assignment] = []
        for item in rest:
            kind = item.__class__
            if kind is _Word:
                self._check_beside(item.word)
                words.append(item)
            elif kind is _Named:
                words += self._words_of(item)
            elif kind is Assignment:
                assignments.append(item)
            elif kind is list:
                assignments += item
            elif kind is Remark:
                self._remarks.append(item)
            else:
                raise not_supported(repr(item.text), item.begin, item.end)
        return Statement(
            tuple(item.word for item in words),
            tuple((at, item.value) for at, item in enumerate(words) if item.value is not None),
            tuple(assignments),
            tuple(self._remarks),
            deletable=deletable,
        )

    def _percent(self, begin: int, end: int, _: Token) -> Statement:
        return Statement(percent=True)

    def _without_label(self, rest: list[Any], number: Word | None) -> list[Any]:
        """Return the parts behind a label and its colon."""
        at = next((k for k, item in enumerate(rest) if item.__class__ is Token), 0)
        if not at:
            return rest
        begin = 0 if number is None else number.column + number.length - 1
        text = self._text[begin : rest[at].begin]
        text = re.sub(r"^\s*/[0-9]?", "", text) if number is None else text
        if not _LABEL.fullmatch(text.strip().upper()):
            return rest
        return rest[at + 1 :]

    def _check_beside(self, word: Word) -> None:
        """Refuse the end and the call of a subprogram beside other words."""
        if word.letter not in "LM":
            return
        begin, end = word.column - 1, word.column - 1 + word.length
        if word.letter == "M" and word.number == 17.0:
            hint = "write M17 in a line of its own"
            raise not_supported("M17 beside other words", begin, end, hint)
        if word.letter == "L":
            raise not_supported(f"{word.written} (call of a subprogram)", begin, end)

    def _control_of(self, rest: list[Any]) -> Control | None:
        """Return the control of a line without its number; None for a line of words."""
        if not rest:
            return None
        for item in rest:
            if item.__class__ is Control:
                if len(rest) > 1:
                    place = rest[0] if rest[0] is not item else rest[1]
                    raise self._beside(item, place)
                return item
        first = rest[0]
        if isinstance(first, _Word):
            return self._plain_control(rest, first.word)
        if not isinstance(first, _Named) or first.value is not None:
            return None
        name, begin, end = first.name.text, first.name.begin, first.end
        if _FRAME.fullmatch(name) and first.arguments is None:
            return self._frame(name, rest[1:], begin)
        if name == "MCALL" and first.arguments is None and len(rest) <= 2:
            if len(rest) == 1:
                return self._control("mcall", "0", (), begin, end)
            return self._cycle(rest[1], "mcall", begin)
        if len(rest) > 1:
            return self._sub_call(first, rest)
        if name in words()["structures"] and not first.arguments:
            kind = cast(Keyword, words()["structures"][name])
            return self._control(kind, "", (), begin, end)
        if cycle := self._cycle(first, "cycle", begin):
            return cycle
        if name in ("HOLES1", "HOLES2") and first.arguments is not None:
            return self._control("s-holes", name[5:], self._values(first), begin, end)
        if name == "CYCLE800" and first.arguments is not None:
            return self._level(first.arguments, begin, end)
        return self._sub_call(first, rest)

    def _beside(self, control: Control, place: Any) -> GcodeError:
        begin, end = control.column - 1, control.column
        if isinstance(place, _Word | Assignment):
            at = place.word if isinstance(place, _Word) else place
            begin, end = at.column - 1, at.column - 1 + at.length
        message = "a control line must stand alone in its line"
        return self._build.fault(
            "control-not-alone", message, begin, end, "write this in another line"
        )

    def _plain_control(self, rest: list[Any], word: Word) -> Control | None:
        """Return the control of a line of M17, M2 or M30, or of L and a number."""
        if word.letter == "P" and len(rest) == 2 and isinstance(rest[1], _Word):
            rest, word = rest[::-1], rest[1].word
        begin, end = word.column - 1, word.column - 1 + word.length
        if len(rest) == 1 and word.letter == "M" and word.number in _ENDS:
            return self._control("s-end", _ENDS[word.number], (), begin, end)
        if re.fullmatch("L[0-9]{1,7}", word.written) and (count := self._repeats(rest[1:])) >= 0:
            return self._control("s-call", word.written, (), begin, end, count=count)
        return None

    def _repeats(self, rest: list[Any]) -> int:
        """Return the repeats of a call, one without P; -1 for other words."""
        if not rest:
            return 1
        if len(rest) > 1 or not isinstance(rest[0], _Word) or rest[0].word.letter != "P":
            return -1
        count = rest[0].word.whole
        return count if count is not None and 0 <= count <= MOST_CALLS else -1

    def _sub_call(self, first: _Named, rest: list[Any]) -> Control | None:
        """Return the call of a subprogram; None for another line."""
        name, begin = first.name.text, first.name.begin
        if name in no_names():
            return None
        if first.arguments and len(rest) == 1:
            if any(
                isinstance(argument, Token) and argument.terminal == "STRING"
                for argument in first.arguments
            ):
                return None
            return self._control("s-call", name, self._values(first), begin, first.end)
        count = -1 if first.arguments else self._repeats(rest[1:])
        if count < 0:
            return None
        return self._control("s-call", name, (), begin, first.end, count=count)

    def _cycle(self, item: Any, kind: Keyword, begin: int) -> Control | None:
        """Return a drilling or turning cycle; None for another part of a line."""
        if not isinstance(item, _Named) or item.arguments is None:
            return None
        if match := re.fullmatch("CYCLE(8[1-9])", item.name.text):
            return self._control(kind, match[1], self._values(item), begin, item.end)
        if kind == "cycle" and (match := re.fullmatch("CYCLE(9[3-8])", item.name.text)):
            # The contour of CYCLE95, the form of CYCLE94 and CYCLE96.
            place, given = (2 if match[1] in ("94", "96") else 0), list(item.arguments)
            names: tuple[str, ...] = ()
            text = given[place] if place < len(given) else None
            if isinstance(text, Token) and text.terminal == "STRING":
                names, given[place] = (text.text.strip('"').upper(),), None
            values = self._values(item._replace(arguments=tuple(given)))
            return self._control("s-turn", match[1], values, begin, item.end, names)
        return None

    def _values(self, item: _Named) -> tuple[Value, ...]:
        """Return the arguments of a cycle or a call; NaN for those that are left out."""
        return tuple(
            _nothing if argument is None else self._value(argument, item.name).value
            for argument in item.arguments or ()
        )

    def _level(
        self, given: tuple[Node | Token | None, ...], begin: int, end: int
    ) -> Control | None:
        """Return a CYCLE800 that leaves the plane as it is; None for another one.

        Its names are none without arguments, ``FR`` for a retraction, or ``0`` for others.
        """
        if any(value is not None and not self._is_zero(value) for value in given[_LEVEL]):
            return None
        retracts = bool(given) and given[0] is not None and not self._is_zero(given[0])
        names = () if not given else ("FR",) if retracts else ("0",)
        return self._control("frame", "CYCLE800", (_nothing,) * 4, begin, end, names)

    def _frame(self, name: str, rest: list[Any], begin: int) -> Control:
        """Return the line of a frame: X, Y, Z and the angle in the plane (RPL)."""
        given: dict[str, Value] = {}
        end = begin + len(name)
        for item in rest:
            if isinstance(item, _Named) and item.name.text == "RPL" and item.value is not None:
                given["RPL"], end = self._value(item.value, item.name).value, item.end
            elif isinstance(item, _Word) and item.word.letter in ("X", "Y", "Z"):
                given[item.word.letter] = item.value or _always(item.word.number)
                end = item.word.column - 1 + item.word.length
            else:
                hint = "its words are X, Y, Z, and RPL= for a rotation"
                raise not_supported(f"{name} with other words", begin, end, hint)
        turns = name.endswith("ROT")
        if "RPL" in given and (not turns or len(given) > 1):
            hint = "write RPL= alone, with ROT or AROT"
            raise not_supported(f"RPL with {name} and other words", begin, end, hint)
        if turns and not given.keys() <= {"Z", "RPL"}:
            hint = "the plane may be turned in itself only: RPL= or Z"
            raise not_supported(f"{name} about X or Y", begin, end, hint)
        values = tuple(given.get(word, _nothing) for word in ("X", "Y", "Z", "RPL"))
        return self._control("frame", name, values, begin, end)

    def _control(
        self, keyword: Keyword, label: str, values: tuple[Value, ...], begin: int, end: int,
        names: tuple[str | int, ...] = (), count: int = 1,
    ) -> Control:  # fmt: skip
        column, length = self._build.place(begin, end)
        return Control(keyword, label, values, column, length, names=names, count=count)


def _one(_: Any) -> float:
    return 1.0


def _always(number: float) -> Value:
    return lambda _: number


def _is_comma(part: Any) -> bool:
    return isinstance(part, Token) and part.terminal == "COMMA"


def _without_comments(items: tuple[Any, ...]) -> list[Any]:
    """Return the parts of a line without comments and block delete, and without EXTERN.

    Raises:
        GcodeError: ``code-not-supported``: a comment is a command for other controls.
    """
    kept: list[Any] = []
    for item in items:
        if item.__class__ is not Token or item.terminal == "COLON":
            kept.append(item)
        elif item.terminal == "COMMENT" and REMARK.fullmatch(item.text):
            raise not_supported("a command in a comment", item.begin, item.end)
    return [part for part in kept if part is not None]


def _arguments(parts: tuple[Any, ...]) -> list[Any]:
    """Return what stands between commas; None for what is left out, none for empty brackets."""
    arguments: list[Any] = [None]
    for part in parts:
        if _is_comma(part):
            arguments.append(None)
        else:
            arguments[-1] = part
    return arguments if parts else []
