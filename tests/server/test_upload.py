"""The decoder of uploads against the JSON parser of Python."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cnc.model.diagnostics import UsageError
from cnc.server.library import TextLines
from cnc.server.routes import UploadDecoder

TEXT = st.text(st.characters(codec="utf-8"), max_size=60)


def decoded(body, cuts=()):
    decoder, parts, last = UploadDecoder(), [], 0
    for cut in [*sorted(cuts), len(body)]:
        parts += decoder.feed(body[last:cut])
        last = cut
    parts += decoder.feed(b"", last=True)
    assert decoder.done
    return "".join(parts)


@given(TEXT, st.booleans(), st.lists(st.integers(0, 200), max_size=8))
def test_every_text_is_decoded_however_it_is_cut(text, ascii_only, cuts):
    body = json.dumps({"text": text}, ensure_ascii=ascii_only).encode()
    assert decoded(body, [min(cut, len(body)) for cut in cuts]) == text


def test_a_long_text_is_decoded_in_pieces():
    text = 'G1 X1 "quoted" \\ \n' * 20_000
    body = json.dumps({"text": text}).encode()
    assert decoded(body, range(0, len(body), 9999)) == text


@pytest.mark.parametrize(
    "body",
    [
        b"", b"{", b"{}", b"[]", b'"text"', b'{"text": 1}', b'{"text": "a', b'{"text": "a"',
        b'{"text": "a"} x', b'{"text": "a", "b": 1}', b'{"other": "a"}', b'{"text": "a\nb"}',
        b'{"text": "\\x"}', b'{"text": "\\u12g4"}', b'{"text": "\xff"}', b'{"text": "a\\"}',
    ],
)  # fmt: skip
def test_another_body_is_refused(body):
    with pytest.raises(UsageError, match="upload-format"):
        decoded(body)


@given(
    st.lists(
        st.text(st.characters(codec="ascii", exclude_characters="\r\n"), max_size=5), max_size=30
    ),
    st.booleans(),
    st.integers(1, 35),
    st.integers(1, 35),
)
def test_lines_are_those_of_the_text(tmp_path_factory, lines, ends, first, count):
    file = tmp_path_factory.mktemp("text") / "a.nc"
    text = "\n".join(lines) + ("\n" if ends and lines else "")
    file.write_bytes(text.encode())
    expected = text.split("\n")
    if expected[-1] == "":
        expected.pop()
    found = TextLines(file)
    found.STRIDE = 1000
    assert found.total == len(expected)
    assert found.lines(first, count) == expected[first - 1 : first - 1 + count]


def test_lines_far_inside_a_long_text(tmp_path):
    file = tmp_path / "a.nc"
    file.write_text("".join(f"N{number}\n" for number in range(1, 12_346)))
    found = TextLines(file)
    assert found.total == 12_345
    for first in (1, 999, 1000, 1001, 2000, 12_000, 12_345):
        assert found.lines(first, 2)[0] == f"N{first}"
    assert found.lines(12_346, 5) == []
