"""Words of a line for editors: their tokens, their meaning in the dialect, and their completion."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from functools import cache
from importlib import resources
from typing import Literal, NamedTuple

from cnc.editor.analysis import windows
from cnc.editor.document import Document
from cnc.editor.symbols import names_of
from cnc.gcode.dialects import Dialect
from cnc.gcode.reader.lines import events_of_lines
from cnc.gcode.reader.parser import language_of
from cnc.gcode.reader.tables import grammar
from cnc.machine.models import Machine

# Meanings.


@cache
def texts() -> dict[str, dict[str, str]]:
    """Return the meanings by the tables of ``codes.toml``."""
    file = resources.files(__package__) / "codes.toml"
    return tomllib.loads(file.read_text(encoding="utf-8"))


def meaning(letter: str, number: float, rules: Dialect, machine: Machine | None = None) -> str:
    """Return what a G or M code does in a dialect; empty if the dialect does not have it.

    Args:
        letter: G or M.
        number: Its number.
        rules: The dialect.
        machine: The machine, whose builder's codes count before the dialect.
    """
    if letter == "M" and machine is not None and number in machine.program.codes:
        return "a code of this machine: [program.codes] of the machine file says what it does"
    noted = rules.noted.get((letter, number))
    if noted is not None and not noted.needs:
        return f"{noted.name}; no effect here"
    legal = {float(code) for code in rules.m}
    if letter == "G":
        alias = rules.aliases.get(number)
        number = number if alias is None else alias.code
        legal = {code / 10 for code in rules.g if code >= 0}
    if number not in legal:
        return ""
    key = f"{number:g}"
    on_lathe = rules.turning.lathe or (
        (key in ("70", "71", "72") and not rules.cycles.hole_patterns)
        or (key == "76" and not rules.cycles.fine_boring)
    )
    listed = texts()
    lathe = listed["lathe"].get(key) if letter == "G" and on_lathe else None
    text = lathe or listed[letter.lower()].get(key, "")
    if letter == "G" and alias is not None:
        return f"{text} (as G{key}{' ' + alias.word if alias.word else ''})"
    return text


_WORD = re.compile(
    r"(?P<letter>[A-Z])[ \t]*(?P<number>[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+))", re.IGNORECASE
)


class Meaning(NamedTuple):
    """A word of a line with its meaning: begin and end in characters from 0."""

    begin: int
    end: int
    word: str
    text: str


def meaning_at(
    document: Document, line: int, character: int, rules: Dialect, machine: Machine | None = None
) -> Meaning | None:
    """Return the word at a character of a line and its meaning; None for none."""
    code = document.code(line)
    listed = texts().get(rules.flavour, {})
    for name in sorted(listed, key=len, reverse=True):
        pattern = r"(?<![A-Z0-9_])" + r"[ \t]+".join(map(re.escape, name.split())) + r"(?![A-Z_])"
        for match in re.finditer(pattern, code, re.IGNORECASE):
            if match.start() <= character < match.end():
                return Meaning(*match.span(), name, listed[name])
    for match in _WORD.finditer(code):
        if not match.start() <= character < match.end():
            continue
        letter, number = match["letter"].upper(), float(match["number"])
        text = ""
        if letter in "GM":
            text = meaning(letter, number, rules, machine)
            text = text or f"not in the dialect {rules.name}"
        elif rules.flavour != "klartext":
            text = texts()["letters"].get(letter, "")
        if text:
            word = re.sub(r"[ \t]", "", match[0]).upper()
            return Meaning(*match.span(), word, text)
    return None


# Completion.


class Completion(NamedTuple):
    """A text that can stand at the place of the cursor.

    Attributes:
        text: The text.
        meaning: What it does.
        kind: Its kind.
        begin: First character that it replaces, from 0.
    """

    text: str
    meaning: str
    kind: Literal["code", "keyword", "variable", "subprogram"]
    begin: int


def completions(
    document: Document, line: int, character: int, rules: Dialect, machine: Machine | None = None
) -> list[Completion]:
    """Return the texts that can be completed at a character of a line; none in a comment."""
    text = document.line(line)[:character]
    if re.search(r"\([^)]*$|;", text):
        return []
    if match := re.search(r"#[ \t]*(<[^<>]*)?$", text):
        begin = len(text) if match[1] is None else match.start(1)
        return _named(document, rules, "variable", begin)
    calls = r"(?:O[ \t]*|CALL[ \t]+LBL[ \t]+|(?:M[ \t]*98|G[ \t]*65)(?![0-9]).*P[ \t]*)"
    if match := re.search(calls + r"(<?[A-Z0-9_]*)$", text, re.IGNORECASE):
        return _named(document, rules, "subprogram", match.start(1))
    match = re.search(r"[A-Z][A-Z0-9.]*$", text, re.IGNORECASE)
    begin, written = (match.start(), match[0].upper()) if match else (len(text), "")
    out = [code for code in codes(rules, machine, begin) if code.text.startswith(written)]
    out += [
        Completion(name, text_of, "keyword", begin)
        for name, text_of in texts().get(rules.flavour, {}).items()
        if name.startswith(written)
    ]
    if rules.flavour == "siemens" and written:
        out += _named(document, rules, "variable", begin)
        out += _named(document, rules, "label", begin)
    return out


def codes(rules: Dialect, machine: Machine | None, begin: int = 0) -> Iterator[Completion]:
    """Yield the codes of a dialect with their meaning; those without effect come last."""
    if rules.flavour == "klartext":
        return
    own = (code / 10 for code in sorted(rules.g) if code >= 0)
    numbers = [("G", code) for code in own if code not in rules.spelled]
    numbers += [("G", number) for number in rules.aliases if ("G", number) not in numbers]
    numbers += [("M", float(code)) for code in sorted(rules.m)]
    if machine is not None:
        numbers += [("M", float(code)) for code in machine.program.codes if code not in rules.m]
    numbers += [key for key in rules.noted if key not in numbers]
    for letter, number in numbers:
        if text := meaning(letter, number, rules, machine):
            yield Completion(f"{letter}{number:g}", text, "code", begin)


def _named(
    document: Document,
    rules: Dialect,
    kind: Literal["variable", "subprogram", "label"],
    begin: int,
) -> list[Completion]:
    names = names_of(document, rules.flavour, kind)
    shown: Literal["variable", "subprogram"] = "variable" if kind == "variable" else "subprogram"
    return [Completion(name, "of this program", shown, begin) for name in names]


# Semantic tokens, from the tokens of the grammar.

TOKEN_TYPES = (
    "comment", "keyword", "number", "variable", "function", "operator", "string", "property",
    "label",
)  # fmt: skip
_TYPE_OF_TERMINAL = {
    "COMMENT": "comment", "TAIL": "comment", "STRUCTURE": "comment",
    "NUMBER": "number", "STRING": "string", "FILE": "string", "MESSAGE": "string",
    "NAME": "variable", "REGISTER": "variable", "SYSTEM": "variable", "PARAMETER": "variable",
    "FUNCTION": "function", "ATAN": "function", "EXISTS": "function",
    "LETTER": "property", "AXIS": "property", "ADDRESS": "property", "RADIUS": "property",
    "FEED": "property", "SPEED": "property", "LENGTH": "property",
    "LABEL": "label", "TARGET": "label", "O": "label", "LBL": "keyword",
    "SIGN": "operator", "SLASH": "operator", "EQUAL": "operator", "COMPARE": "operator",
    "LOGIC": "operator", "TIMES": "operator", "POWER": "operator", "PLUS_LIKE": "operator",
    "COLON": "operator", "COMMA": "operator", "CORNER": "property", "BLANKS": "", "BLANK": "",
}  # fmt: skip
"""Type of a token by its terminal; others are keywords."""


class Token(NamedTuple):
    """A token: its line from 1, begin and end in characters from 0, and its type."""

    line: int
    begin: int
    end: int
    type: int


def tokens(document: Document, rules: Dialect, first: int, last: int) -> Iterator[Token]:
    """Yield the tokens of lines in order. A line that is wrong has those before its error."""
    language = language_of(rules.flavour)
    made = grammar(language.grammar)
    types = [_TYPE_OF_TERMINAL.get(str(name), "keyword") for name in made.terminals]
    letter = (
        [str(name) for name in made.terminals].index("LETTER")
        if rules.flavour != "klartext"
        else -1
    )
    keyword, label, number, variable = map(
        TOKEN_TYPES.index, ("keyword", "label", "number", "variable")
    )
    for window in windows(document, rules, first, last):
        reading = events_of_lines(window.data, *window.places, language)
        starts = window.places[0].tolist()
        firsts = reading.results.first.tolist()
        events = reading.events
        for index, start in enumerate(starts):
            span = slice(firsts[index], firsts[index + 1])
            kinds = events.kind[span]
            are_tokens = kinds > 0
            row: list[Token] = []
            after = -1
            for kind, begin, end in sorted(
                zip(
                    kinds[are_tokens].tolist(), events.begin[span][are_tokens].tolist(),
                    events.end[span][are_tokens].tolist(), strict=True,
                ),
                key=lambda token: token[1],
            ):  # fmt: skip
                name = types[kind - 1]
                if not name or end <= begin:
                    continue
                token = TOKEN_TYPES.index(name)
                if kind - 1 == letter:
                    written = window.data[begin : begin + 1].upper()
                    if written in b"GM":
                        token, after = keyword, keyword
                    elif written in b"NO":
                        token, after = label, label
                    else:
                        after = -1
                elif token == number and after >= 0:
                    token, after = after, -1
                elif token == number and window.data[begin - 1 : begin] == b"#":
                    token, begin = variable, begin - 1
                elif token == label:
                    after = label
                else:
                    after = -1
                row.append(Token(window.first + index, begin - start, end - start, token))
            yield from _in_characters(row, window.data, start)


def _in_characters(row: list[Token], data: bytes, start: int) -> Iterator[Token]:
    """Yield the tokens of a line with places in characters in place of bytes."""
    if not row or data[start : start + row[-1].end].isascii():
        yield from row
        return
    for token in row:
        begin, end = (len(data[start : start + at].decode(errors="ignore")) for at in token[1:3])
        yield token._replace(begin=begin, end=end)
