"""Tables of text."""

import io
import sys

import pytest

from cnc.model.diagnostics import printable
from cnc.report.summary import aligned, has_styles, join, styled


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_columns_are_as_wide_as_their_widest_cell():
    rows = [["axis", "steps"], ["X", "35 836"], ["Z", "0"]]
    assert [join(row) for row in aligned(rows, right=[1])] == [
        "axis   steps",
        "X     35 836",
        "Z          0",
    ]


def test_a_line_has_no_blanks_at_its_end():
    assert join(aligned([["a", "long"], ["b", ""]])[1]) == "b"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("größe ³.nc", "größe ³.nc"),
        ("a\x1b[2Jb\n", "a\\x1b[2Jb\\n"),
        ("\udcff.nc", "\\udcff.nc"),  # a byte of a file name that is not text
    ],
)
def test_text_does_not_control_the_terminal(text, shown):
    assert printable(text) == shown


@pytest.mark.skipif(sys.platform == "win32", reason="its console shows the codes as text")
def test_only_a_terminal_has_styles(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert has_styles(Terminal())
    assert not has_styles(io.StringIO())
    monkeypatch.setenv("NO_COLOR", "1")
    assert not has_styles(Terminal())
    monkeypatch.delenv("NO_COLOR")
    monkeypatch.setenv("TERM", "dumb")
    assert not has_styles(Terminal())


def test_a_style_ends_after_its_text():
    assert styled("ok", "green") == "\x1b[32mok\x1b[0m"
