"""Texts in an editor: lines, edits, places in the units of the protocol."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from cnc.editor.document import Document, Span, TextEdit, characters, units
from cnc.gcode.reader.source_text import split

TEXTS = st.text(st.sampled_from("aX1 (\n\r\u00e9\U0001f600\x0c\u2028"), max_size=40)


def place(text: str, offset: int) -> tuple[int, int]:
    """Return line from 1 and character from 0 of an offset that divides no \\r\\n."""
    pieces = Document.of("", text[:offset]).pieces
    return len(pieces), len(pieces[-1])


@given(TEXTS)
def test_lines_are_those_of_the_reader(text: str) -> None:
    document = Document.of("a", text)
    assert document.text == text
    data = text.encode()
    lines = split(data, whole=True)
    wanted = [data[a:b].decode() for a, b in zip(lines.begin, lines.end, strict=True)]
    if not text or text[-1] in "\r\n":
        wanted.append("")
    assert [document.line(number) for number in range(1, document.count + 1)] == wanted


@given(TEXTS, TEXTS, st.integers(0, 40), st.integers(0, 40))
def test_an_edit_gives_the_text_that_a_slice_gives(text: str, new: str, a: int, b: int) -> None:
    begin, end = sorted((min(a, len(text)), min(b, len(text))))
    if any(text[at - 1 : at + 1] == "\r\n" for at in (begin, end)):
        return  # no place of the protocol
    document = Document.of("a", text)
    edit = TextEdit(*place(text, begin), *place(text, end), new)
    changed = document.edited([edit], 2)
    wanted = text[:begin] + new + text[end:]
    assert changed.text == wanted
    assert changed.pieces == Document.of("a", wanted).pieces
    assert document.text == text


@given(TEXTS, st.integers(0, 40))
def test_places_in_units_come_back(text: str, at: int) -> None:
    line = text.replace("\n", " ").replace("\r", " ")
    character = min(at, len(line))
    for encoding in ("utf-8", "utf-16", "utf-32"):
        unit = units(line, character, encoding)
        assert characters(line, unit, encoding) == character
    assert units("\u00e9\U0001f600X", 2, "utf-16") == 3
    assert units("\u00e9\U0001f600X", 2, "utf-8") == 6


def test_spans_have_line_and_characters() -> None:
    document = Document.of("a", "G0\r\nX1 Y2\n")
    begin = document.text.index("Y2")
    assert document.span(begin, begin + 2) == Span(2, 3, 5)
