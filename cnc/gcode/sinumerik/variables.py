"""Variables of SINUMERIK: R parameters, DEF, the parameters of PROC, arrays, and their names here.

A variable of the main program has a name for all programs. One of a subprogram, or a parameter of
its PROC, belongs to the call. An element of an array is a parameter with a number. Source: Siemens,
"SINUMERIK 840D sl/828D Programming Manual, Job Planning", "User data" and "Subprogram technique".
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Iterable, Sequence
from functools import cache
from importlib.resources import files
from itertools import product
from typing import Any

from cnc.gcode.kernels.arithmetic import ADD, DIVIDE, FIX, MODULO, MULTIPLY, NUMBER
from cnc.gcode.reader.expressions import Instruction, Node, constant
from cnc.gcode.reader.lines import read_line
from cnc.gcode.reader.parameters import Parameters, Variable, Variables
from cnc.gcode.reader.statements import Token, carried_out
from cnc.gcode.reader.syntax_errors import about_character
from cnc.gcode.reader.words import fault
from cnc.model.diagnostics import GcodeError

GRAMMAR = "sinumerik"
KINDS = ("REAL", "INT", "BOOL")
R_PARAMETERS = range(1_000_000, 1_010_000)
"""Numbers of R[0], R[1], .."""
_FIRST_ARRAY = 20_000_000_000
ROW = 100_000
"""Distance between the numbers of two elements whose first index differs by 1."""
SPAN = ROW * ROW
"""Distance between two arrays."""
MOST_ELEMENTS = 10_000
DEFINING = re.compile(rb"\b(?:DEF|PROC)\b|%_N_", re.IGNORECASE)
"""What every line has that defines variables, or begins a program."""
_SUBPROGRAM = re.compile(r"\s*(?:%_N_\w+_(SPF|MPF)\b|(?:N[0-9]+\s*)?(PROC)\s)", re.IGNORECASE)


def written_name(stored: str) -> str:
    """Return an R parameter or a variable as a program writes it, from its name here."""
    return stored[1 if stored[1:2] == "r" or stored[0] == "p" else 2 :].upper()


class _Declarations:
    """The rules of the grammar for lines that define variables; all others have no meaning."""

    def __init__(self, *, local: bool, arrays: int) -> None:
        self.found: list[Variable] = []
        self._local, self._arrays = local, arrays

    def token(self, token: Token) -> Token:
        """Return the token."""
        return token

    def number(self, begin: int, end: int, value: float) -> Token:
        """Return the text of a number; empty for one that is not whole."""
        return Token("NUMBER", f"{value:.0f}" if value.is_integer() else "", begin, end)

    def __getattr__(self, name: str) -> Any:
        return lambda begin, end, *parts: parts

    def _defined(self, begin: int, end: int, name: Token, *rest: Any) -> tuple[str, Any]:
        """Return a name, and its sizes if it is an array."""
        return name.text, rest[0] if rest and isinstance(rest[0], list) else None

    def _index(self, begin: int, end: int, *parts: Any) -> list[str]:
        """Return the texts of the indices; empty for one that is no number."""
        return [
            part.text if isinstance(part, Token) else ""
            for part in parts
            if not (isinstance(part, Token) and part.terminal == "COMMA")
        ]

    def _definition(self, begin: int, end: int, _: Token, kind: Token, *parts: Any) -> None:
        if kind.text not in KINDS:
            return
        for part in parts:
            if not isinstance(part, tuple) or isinstance(part, Token):
                continue
            name, written = part
            sizes = None if written is None else sizes_of(written)
            if sizes is None and len(name) > 1:
                self.found.append(Variable(name, kind.text, self._local))
            elif sizes and not self._local and name != "R":
                first = _FIRST_ARRAY + SPAN * self._arrays
                self.found.append(Variable(name, kind.text, self._local, sizes, first))
                self._arrays += 1

    def _procedure(self, begin: int, end: int, *parts: Any) -> None:
        given = next((part for part in parts if isinstance(part, list)), [])
        self.found += parameters_of(given) or ()

    def _parameters(self, begin: int, end: int, *parts: Any) -> list[Any]:
        return [part for part in parts if not isinstance(part, Token)]


def defined_variables(lines: Iterable[str], *, in_subprogram: bool = False) -> Variables:
    """Return the variables that lines define by DEF and PROC.

    Args:
        lines: The lines, at least those with DEFINING.
        in_subprogram: Whether the first line belongs to a subprogram.
    """
    local = in_subprogram
    variables: list[Variable] = []
    for line in lines:
        if border := _SUBPROGRAM.match(line):
            local = (border[1] or "SPF").upper() == "SPF"
        reading = read_line(line, GRAMMAR)
        if not reading.results.status[0]:
            rules = _Declarations(
                local=local, arrays=sum(bool(variable.sizes) for variable in variables)
            )
            carried_out(reading, 0, line, rules)
            variables += rules.found
    return tuple(dict.fromkeys(variables))


def sizes_of(written: Sequence[str]) -> tuple[int, ...]:
    """Return the sizes of an array; empty for one without elements, or with too many."""
    if len(written) > 2 or not all(text.isdigit() for text in written):
        return ()
    sizes = tuple(map(int, written))
    return sizes if 0 < math.prod(sizes) <= MOST_ELEMENTS else ()


def parameters_of(given: Iterable[Sequence[Token]]) -> Variables | None:
    """Return the parameters of a PROC by their words; None for forms that are not supported."""
    parameters = []
    for words in given:
        texts = [word.text if isinstance(word, Token) else "" for word in words]
        if len(texts) != 2 or texts[0] not in KINDS or len(texts[1]) < 2:
            return None
        parameters.append(Variable(texts[1], texts[0], True))
    return tuple(parameters)


def elements(variable: Variable) -> list[int]:
    """Return the numbers of the elements of an array; the last index counts first."""
    steps = (ROW, 1)[2 - len(variable.sizes) :]
    return [
        variable.first + sum(index * step for index, step in zip(indices, steps, strict=True))
        for indices in product(*(range(size) for size in variable.sizes))
    ]


def left_from(variable: Variable, indices: Sequence[Node]) -> int | None:
    """Return the number of elements from one on; None if its indices are computed."""
    place = 0
    for index, size in zip(indices, variable.sizes, strict=True):
        if index.number is None:
            return None
        place = place * size + int(index.number)
    return math.prod(variable.sizes) - place


def number_of(variable: Variable | None, indices: Sequence[Node], step: int = 0) -> Node:
    """Return the number of the parameter ``step`` places behind an element of an array, or of R.

    The last index counts first. The element itself must be checked: behind a wrong last index, a
    right element of the next row may follow.
    """
    begin, end = indices[0].begin, indices[-1].end
    first = R_PARAMETERS.start if variable is None else variable.first

    def of(*parts: Sequence[Instruction] | float | int) -> tuple[Instruction, ...]:
        """Return instructions, from instructions, numbers (float) and operations (int)."""
        code: list[Instruction] = []
        for part in parts:
            if isinstance(part, float):
                code.append(Instruction(NUMBER, part, begin + 1, end - begin))
            elif isinstance(part, int):
                code.append(Instruction(part, 0.0, begin + 1, end - begin))
            else:
                code += part
        return tuple(code)

    row = indices[0].code if len(indices) > 1 else of(0.0)
    last = of(indices[-1].code, float(step), ADD)
    if step and len(indices) > 1:
        assert variable is not None
        size = float(variable.sizes[1])
        row = of(row, last, size, DIVIDE, FIX, ADD)
        last = of(last, size, MODULO)
    node = Node(of(float(first), row, float(ROW), MULTIPLY, ADD, last, ADD), begin, end)
    if all(index.number is not None for index in indices):
        return constant(node.value(Parameters()), begin, end)
    return node


def bind_arrays(parameters: Parameters, variables: Iterable[Variable]) -> None:
    """Bind the numbers of R parameters and of the elements of arrays; show names as written."""
    parameters.written = written_name

    def read(place: int) -> float:
        return parameters.name(f"_r{place}", 1)

    def write(place: int, value: float) -> None:
        parameters.set_name(f"_r{place}", value, 1)

    parameters.bind_row(R_PARAMETERS, read, write)
    for variable in variables:
        if variable.sizes:
            _bind(parameters, variable)


def _bind(parameters: Parameters, variable: Variable) -> None:
    """Bind the numbers of an array. Those around it are errors that name the array."""
    indices = {number - variable.first + SPAN // 2 for number in elements(variable)}
    values: dict[int, float] = {}

    def checked(place: int) -> int:
        if place in indices:
            return place
        shown = ",".join(str(size) for size in variable.sizes)
        last = " and ".join(f"0 to {size - 1}" for size in variable.sizes)
        message = f"an index is outside of {variable.name}[{shown}]"
        raise fault("parameter-number", message, column=1, hint=f"its indices are {last}")

    def write(place: int, value: float) -> None:
        values[checked(place)] = value

    begin = variable.first - SPAN // 2
    row = range(begin, begin + SPAN)
    parameters.bind_row(row, lambda place: values.get(checked(place), 0.0), write)


# The words of SINUMERIK (``dialects/siemens_words.toml``), and the errors that name one.

_NAME = re.compile(r'"[^"]*"?|;.*|([A-Z_][A-Z_]+[0-9]*)', re.IGNORECASE)
_JUMP = re.compile(r"\bGOTO[BCFS]?\b", re.IGNORECASE)
_HEAD = re.compile(r"\s*(?:N[0-9]+\s*)?(DEF|PROC|REPEATB?)\b", re.IGNORECASE)
_CLOSING = {"(": ")", "[": "]"}
_FORMS = {
    "DEF": "write DEF REAL NAME=1.5, OTHER[3,2]; the types are REAL, INT and BOOL",
    "PROC": "REAL, INT and BOOL are read, without VAR",
}


@cache
def words() -> dict[str, dict[str, str]]:
    """Return the tables of words."""
    file = files("cnc.gcode.dialects").joinpath("siemens_words.toml")
    return tomllib.loads(file.read_text(encoding="utf-8"))


@cache
def no_names() -> frozenset[str]:
    """Return the words that are no names of subprograms."""
    tables = ("not-needed", "only-zero", "refused", "codes", "turns", "diameters")
    return frozenset(name for table in tables for name in words()[table]) | {"BSPLINE"}


def not_supported(what: str, begin: int, end: int, hint: str = "") -> GcodeError:
    """Return the error of something that is not supported."""
    hint = hint or "this looks like SINUMERIK; docs/reference/sinumerik.md lists what is read"
    return fault(
        "code-not-supported", f"{what} is not supported", column=begin + 1,
        length=max(end - begin, 1), hint=hint,
    )  # fmt: skip


def refused(name: str, begin: int, *, values: bool = False) -> GcodeError:
    """Return the error of a word that would change the path, or that is not known.

    Args:
        name: The word.
        begin: Its place.
        values: Whether values in brackets follow it.
    """
    what = words()["refused"].get(name)
    hint = words()["instead"].get(name, "")
    if what is None and values:
        what = "call of a subprogram with values"
        hint = "write its moves in place of the call, or hand values over in R parameters"
    what = what or "a name, or a word that is not known"
    return not_supported(f"{name} ({what})", begin, begin + len(name), hint)


def describe(text: str, place: int, wanted: frozenset[str]) -> GcodeError:
    """Return the error of a line that is not in the grammar.

    Args:
        text: The line.
        place: Position at which the grammar stopped.
        wanted: Names of the terminals that it would have accepted there.
    """
    char = text[place : place + 1]
    if char and not char.isascii():
        message, hint = about_character(char)
        return fault("character-unknown", message, column=place + 1, hint=hint)
    for match in _NAME.finditer(text):
        if match[1] and match.start() <= place and match[1].upper() in words()["refused"]:
            return refused(match[1].upper(), match.start())
    if jump := _JUMP.search(text[: place + 1].rstrip() + " "):
        hint = "write GOTOF, GOTOB or GOTO and a label or N number"
        return not_supported("a jump of this form", *jump.span(), hint)
    if char == '"':
        return fault("bracket-not-closed", 'this " is not closed', column=place + 1)
    is_end = not text[place:].strip() or char == ";"
    open_ = _open_brackets(text[:place])
    if is_end and open_:
        begin = open_[-1]
        return fault("bracket-not-closed", f"this {text[begin]} is not closed", column=begin + 1)
    if (head := _HEAD.match(text)) and head[1].upper() in _FORMS:
        word = head[1].upper()
        return not_supported(f"{word} of this form", *head.span(1), _FORMS[word])
    if char and char in ")]" and not open_:
        return fault("bracket-not-open", f"a {char} without its bracket before", column=place + 1)
    if "NUMBER" in wanted and "LEFT" in wanted:
        return not_supported("an expression that is not complete", place, place + 1)
    if is_end:
        end = len(text[:place].rstrip())
        return not_supported("a line that ends here", end - 1, end)
    return not_supported(repr(char), place, place + 1)


def _open_brackets(text: str) -> list[int]:
    """Return the places of brackets that are open at the end of a text."""
    brackets: list[int] = []
    quoted = False
    for at, char in enumerate(text):
        quoted ^= char == '"'
        if char in _CLOSING and not quoted:
            brackets.append(at)
        elif char in ")]" and not quoted and brackets:
            brackets.pop()
    return brackets
