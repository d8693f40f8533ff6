"""One form for the text of a program: blanks, capitals, zeros of numbers, the order of words.

The compact style leaves out block numbers too, and words that repeat what is in effect. Comments
stay. Lines are written in the order in which they stand, so that line numbers stay.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np

from cnc.gcode.dialects import Dialect
from cnc.gcode.kernels import layout as kernel
from cnc.gcode.reader.lines import MAX_LINE, Language, events_of_lines
from cnc.gcode.reader.parser import language_of
from cnc.gcode.reader.source_text import BOM, Text, windows_from
from cnc.gcode.reader.tables import grammar
from cnc.model.choices import TextStyle

_KINDS = {
    "LETTER": kernel.LETTER, "NUMBER": kernel.NUMBER, "SIGN": kernel.SIGN, "SLASH": kernel.SLASH,
    "COMMENT": kernel.REMARK, "TAIL": kernel.REMARK, "NAME": kernel.AS_WRITTEN,
    **dict.fromkeys(
        (
            "LOGIC", "COMPARE", "TIMES", "PLUS_LIKE", "PLAIN", "CONDITION", "CALL", "RESULT",
            "GOTO", "IF", "THEN", "WHILE", "DO", "END",
        ),
        kernel.OPERATOR,
    ),
}  # fmt: skip
_SINUMERIK_KINDS = {
    "LETTER": kernel.LETTER, "PARAMETER": kernel.LETTER, "NUMBER": kernel.NUMBER,
    "SIGN": kernel.SIGN,
    "COMMENT": kernel.REMARK, "TAIL": kernel.REMARK,
}  # fmt: skip
_KLARTEXT_KINDS = {
    "NUMBER": kernel.NUMBER, "SIGN": kernel.SIGN, "COMMENT": kernel.REMARK,
    "STRING": kernel.AS_WRITTEN, "FILE": kernel.AS_WRITTEN, "STRUCTURE": kernel.AS_WRITTEN,
}  # fmt: skip
_GROUPS = frozenset(
    (
        "word", "bspline", "assignment", "program", "oword", "jump", "branch", "then", "loop",
        "end", "number", "assigned", "indexed", "named", "element", "keyword", "command",
        "condition", "count", "again", "definition", "procedure", "declaration", "message",
        "valued", "turn",
    )
)  # fmt: skip
"""Rules with which a group begins."""
_FLOW = re.compile(
    rb"[#\[=GMOgmo](?:(?<=[#\[=])|(?<=[Gg])[Oo][Tt][Oo]"
    rb"|(?<=[GMgm])[ \t]*0*(?:9[789]|6[56]|7[0-6])(?![0-9])"
    rb"|(?<=[Oo])[ \t]*(?:<|[0-9]+[ \t]*[A-Za-z]))"
)
"""Words of a program in which a line may follow another one than that before it, or be named.

It begins with a set of bytes and takes no case for another: so the search is four times as fast.
"""


@cache
def _meaning(language: Language) -> kernel.Meaning:
    """Return the meaning of the symbols of a language's grammar."""
    name, tables = language.grammar, grammar(language.grammar)
    kinds, other, names = {
        "sinumerik": (_SINUMERIK_KINDS, kernel.AS_WRITTEN, kernel.END_NAMES),
        "klartext": (_KLARTEXT_KINDS, kernel.CAPITALS, kernel.STAY),
    }.get(name, (_KINDS, kernel.PLAIN, kernel.MEANINGLESS))
    return kernel.Meaning(
        np.array([kinds.get(terminal, other) for terminal in tables.terminals], np.uint8),
        np.array([rule in _GROUPS for rule in tables.rules], np.uint8),
        names,
        int(name == "klartext"),
    )


def _style(name: TextStyle, rules: Dialect, *, flow: bool) -> kernel.Style:
    """Return what a style does to a program; ``flow`` if lines may follow others than the last."""
    words = rules.flavour in ("ngc", "macro-b", "none") and rules.name != "marlin"
    compact = name == "compact"
    return kernel.Style(
        blanks=int(not compact or rules.flavour in ("siemens", "klartext")),
        ordered=int(words),
        numbered=int(not compact or flow or not words),
        repeated=int(not compact or flow or not words),
    )


def formatted(path: Path, rules: Dialect, style: TextStyle) -> Iterator[bytes]:
    """Yield the text of a program in a style, in parts.

    Args:
        path: the file.
        rules: its dialect.
        style: the style.
    """
    text, language = Text.of_file(path), language_of(rules.flavour)
    text.language = language
    form = _style(style, rules, flow=style == "compact" and _has_flow(text))
    state = np.array([-1.0, np.nan, 0.0])
    space = kernel.draft(MAX_LINE)
    with path.open("rb") as file:
        if file.read(len(BOM)) == BOM:
            yield BOM
    for window, _ in windows_from(text):
        reading = events_of_lines(window.data, *window.places, language)
        out = np.empty(4 * len(window.data) + 64, np.uint8)
        size = kernel.format_lines(
            np.frombuffer(window.data, np.uint8), window.places, reading.events, reading.results,
            _meaning(language), form, state, space, out,
        )  # fmt: skip
        yield out[:size].tobytes()


def _has_flow(text: Text) -> bool:
    """Return whether a line may follow another one than that before it, or be named by another."""
    return any(_FLOW.search(window.data) for window, _ in windows_from(text))
