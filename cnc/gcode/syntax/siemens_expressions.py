"""Expressions of SINUMERIK in the words of RS274/NGC.

R parameters and variables become named parameters, and elements of arrays numbered ones. Source:
Siemens, "SINUMERIK 840D sl/828D Programming Manual, Job Planning", "Arithmetic functions",
"Priority of the operations" and "Round up (ROUNDUP)".
"""

from __future__ import annotations

import re

from cnc.gcode.syntax.siemens_arrays import R_PARAMETERS, number_of
from cnc.gcode.syntax.siemens_variables import Variable, Variables, arguments, variable_name
from cnc.gcode.syntax.words import fault
from cnc.model.diagnostics import GcodeError

_OPERAND = re.compile(
    r"\s*[-+]?\s*(?:[0-9]+\.?[0-9]*|\.[0-9]+|R[0-9]+|[A-Z_](?=\s*\[)|[A-Z_]{2}[A-Z0-9_]*)", re.I
)
_ELEMENT = re.compile(r"(?<![A-Z0-9_$])([A-Z_][A-Z0-9_]*)\s*(\[)", re.I)
_NAME = re.compile(r"(?<![A-Z0-9_])[A-Z_][A-Z0-9_]*", re.I)
_OPERATOR = re.compile(r"\s*(\*\*|==|<>|<=|>=|[-+*/<>]|\bMOD\b|\bAND\b|\bOR\b)", re.I)
_COMPARED = {"==": "~EQ", "<>": "~NE", "<=": "~LE", ">=": "~GE", "<": "~LT", ">": "~GT"}
_LEVELED = re.compile(r"==|<>|<=|>=|<|>|\b(?:AND|XOR|OR)\b", re.I)
_LOGIC = ("AND", "XOR", "OR")
"""Logic operators, the one that binds tightest first. Comparisons bind less than all of them."""
_OWN_FUNCTION = re.compile(r"(?<![A-Z0-9_])(POT|ATAN2)\s*(\()", re.I)
_ARCTANGENT = "~~"
"""Stands for ATAN of RS274/NGC, which is no function of SINUMERIK."""
_TRUTHS = {"TRUE": "1", "FALSE": "0"}
_WORD_OPERATORS = {"MOD", "AND", "OR", "XOR"}
_FUNCTIONS = {
    **{name: name for name in ("SIN", "COS", "TAN", "ASIN", "ACOS", "SQRT", "ABS", "ROUND")},
    "LN": "LN",
    "EXP": "EXP",
    "TRUNC": "~FIX",
    "ROUNDUP": "FUP",
}


class Cursor:
    """A place in a line, from which expressions are taken."""

    def __init__(self, text: str, variables: Variables) -> None:
        self.text = text
        self.variables: dict[str, Variable] = {}
        self.ambiguous: set[str] = set()
        for each in variables:
            if each.name in self.variables:
                self.ambiguous.add(each.name)
            self.variables[each.name] = each
        self.at = 0

    def skip(self) -> bool:
        """Pass blanks; return whether a word follows."""
        while self.at < len(self.text) and self.text[self.at] in " \t":
            self.at += 1
        return self.at < len(self.text)

    def is_variable(self, name: str) -> bool:
        """Whether a name is that of a variable."""
        return name.startswith("_") or name.upper() in self.variables

    def stored(self, name: str) -> str:
        """Return the name here of an R parameter or a variable."""
        if re.fullmatch(r"R[0-9]+", name, re.I):
            return f"_r{int(name[1:])}"
        if name.upper() in self.ambiguous:
            what = f"{name.upper()} (a variable of more than one program of this text)"
            raise self.fault(what, len(name), "give each variable a name of its own")
        known = self.variables.get(name.upper())
        if known and known.sizes:
            raise self.fault(f"{known.name} (an array) without an index", len(name), "")
        return known.stored if known else variable_name(name)

    def expression(self) -> str:
        """Take an expression; return it in the words of RS274/NGC."""
        return self.ngc(self.written_value())

    def written_value(self) -> str:
        """Take an expression; return it as it is written."""
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
                self.at = closing(self.text, self.at) + 1
            elif operand is None:
                raise self.fault("an expression that is not complete", 1, "")
            operator = _OPERATOR.match(self.text, self.at)
            if operator is None:
                return self.text[begin : self.at]
            self.at = operator.end()

    def _blank_before_bracket(self) -> None:
        """Pass blanks before a bracket, and the index of an array."""
        end = self.at
        while end < len(self.text) and self.text[end] in " \t":
            end += 1
        if self.text[end : end + 1] == "(":
            self.at = end
        elif self.text[end : end + 1] == "[":
            self.at = closing(self.text, end) + 1

    def ngc(self, expression: str) -> str:
        """Return an expression in the words of RS274/NGC."""
        text, at, out = self._in_order(expression.strip()), 0, []
        while found := _ELEMENT.search(text, at):
            end = closing(text, found.start(2))
            number = self.element(found[1], text[found.end() : end])
            out += [self._without_arrays(text[at : found.start()]), f"#[{number}]"]
            at = end + 1
        return "".join((*out, self._without_arrays(text[at:])))

    def _in_order(self, text: str) -> str:
        """Return an expression with brackets for the order of AND, XOR and OR."""
        if not _LEVELED.search(text):
            return text
        parts, operators, begin, at = [], [], 0, 0
        while at < len(text):
            if text[at] in "([":
                end = closing(text, at)
                inner = self._in_order(text[at + 1 : end])
                text = text[: at + 1] + inner + text[end:]
                at += len(inner) + 2
            elif found := _LEVELED.match(text, at):
                parts.append(text[begin:at])
                operators.append(found[0].upper())
                begin = at = found.end()
            else:
                at += 1
        parts.append(text[begin:])
        compared = [each for each in operators if each in _COMPARED]
        if compared and (len(operators) > 1):
            what = f"{' and '.join(operators[:2])} without brackets"
            hint = "SINUMERIK compares last: write brackets, as in (R1>2) AND (R2<5)"
            raise self.fault(what, 1, hint)
        if len({*operators}) < 2:
            return text
        for operator in _LOGIC:
            joined, kept = [parts[0]], []
            for each, part in zip(operators, parts[1:], strict=True):
                if each == operator:
                    joined[-1] = f"{joined[-1]} {each} {part}"
                else:
                    joined.append(part)
                    kept.append(each)
            parts = [f"({part})" if f" {operator} " in part else part for part in joined]
            operators = kept
        return parts[0]

    def element(self, written: str, index: str) -> str:
        """Return the expression for the number of an element of an array, or of R."""
        known, indices = self.array(written, index)
        return number_of(R_PARAMETERS.start if known is None else known.first, indices)

    def array(self, written: str, index: str) -> tuple[Variable | None, list[str]]:
        """Return an array with the expressions of its indices; None for R."""
        name = written.upper()
        indices = [self.ngc(each) for each in arguments(index)]
        if name == "R" and len(indices) == 1:
            return None, indices
        known = None if name in self.ambiguous else self.variables.get(name)
        if known is None or len(known.sizes) != len(indices):
            what = f"{name}[{index}] (no array of that name, or another number of indices)"
            hint = "define it by DEF REAL NAME[10] at the beginning of the main program"
            raise self.fault(what, len(name), hint)
        return known, indices

    def _without_arrays(self, text: str) -> str:
        text = self._without_own_functions(text)
        text = re.sub(r"==|<>|<=|>=|<|>", lambda found: f" {_COMPARED[found[0]]} ", text)
        text = _NAME.sub(lambda found: self._named(found[0]), text)
        return text.replace("(", "[").replace(")", "]").replace(_ARCTANGENT, "ATAN")

    def _without_own_functions(self, text: str) -> str:
        """Return an expression with POT and ATAN2 in the functions of RS274/NGC."""
        while found := _OWN_FUNCTION.search(text):
            end = closing(text, found.start(2))
            given = arguments(text[found.end() : end])
            count = 1 if found[1].upper() == "POT" else 2
            if len(given) != count:
                raise self.fault(f"{found[1]} with {len(given)} values", len(found[1]), "")
            new = (
                f"(({given[0]})**2)" if count == 1 else f"({_ARCTANGENT}({given[0]})/({given[1]}))"
            )
            text = text[: found.start()] + new + text[end + 1 :]
        return text

    def _named(self, written: str) -> str:
        """Return a name of an expression in the words of RS274/NGC."""
        name = written.upper()
        if re.fullmatch(r"R[0-9]+", name):
            return f"#<{self.stored(name)}>"
        if self.is_variable(written):
            return f"#<{self.stored(written)}>"
        if name in _FUNCTIONS:
            return _FUNCTIONS[name]
        if name in _WORD_OPERATORS or f"~{name}" in _COMPARED.values():
            return name
        if name in _TRUTHS:
            return _TRUTHS[name]
        hint = "define a variable by DEF REAL at the beginning of the main program"
        raise self.fault(f"{name} in an expression", len(name), hint)

    def fault(self, what: str, length: int, hint: str) -> GcodeError:
        """Return the error of something at this place that is not supported."""
        hint = hint or "this looks like SINUMERIK; docs/reference/language.md lists what is read"
        return fault(
            "code-not-supported", f"{what} is not supported", column=self.at + 1, length=length,
            hint=hint,
        )  # fmt: skip


def closing(text: str, begin: int) -> int:
    """Return the position of the bracket that closes the one at ``begin``."""
    depth = 0
    for at in range(begin, len(text)):
        depth += (text[at] in "([") - (text[at] in ")]")
        if depth == 0:
            return at
    raise fault("bracket-not-closed", f"this {text[begin]} is not closed", column=begin + 1)
