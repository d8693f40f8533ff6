"""Decoding of an upload ``{"text": "..."}`` in pieces, so that no long step stops the machine.

The JSON parser of Python holds the interpreter for the whole body, a second for a large program.
Here each piece is a short text of its own.
"""

from __future__ import annotations

import codecs
import json
import re
from collections.abc import Iterator

from cnc.model.diagnostics import Diagnostic, UsageError

PIECE = 1 << 16
"""Characters that are decoded at a time."""
_HEAD = re.compile(r'\s*\{\s*"text"\s*:\s*"')
_HEAD_PART = re.compile(r'\s*(?:\{\s*(?:"(?:t(?:e(?:x(?:t(?:"\s*(?::\s*"?)?)?)?)?)?)?)?)?')
_HIGH, _LOW, _FOUR = "[dD][89abAB][0-9a-fA-F]{2}", "[dD][c-fC-F][0-9a-fA-F]{2}", "[0-9a-fA-F]{4}"
_PLAIN = re.compile(
    r'(?:[^"\\\x00-\x1f]|\\["\\/bfnrt]'
    rf"|\\u(?!{_HIGH}){_FOUR}|\\u{_HIGH}\\u{_LOW}"
    # Half a character, where the next bytes cannot be the other half.
    rf"|\\u{_HIGH}(?=[^\\]|\\[^u]|\\u(?!{_LOW}){_FOUR}))*"
)
_TAIL = re.compile(r'"\s*\}\s*')
LONGEST_ESCAPE = 12
"""Characters of two escapes, which may be one character together."""


class UploadDecoder:
    """Decodes the body of an upload.

    Attributes:
        done: Whether the text is complete.
    """

    def __init__(self) -> None:
        self.done = False
        self._decoder = codecs.getincrementaldecoder("utf-8")()
        self._rest = ""
        self._inside = False

    def feed(self, data: bytes, *, last: bool = False) -> Iterator[str]:
        """Yield the parts of the text in the next bytes of the body.

        Raises:
            UsageError: ``upload-format``.
        """
        try:
            self._rest += self._decoder.decode(data, last)
        except UnicodeDecodeError:
            raise _wrong("its bytes are not UTF-8") from None
        if not self._inside and not self._begins():
            if last:
                raise _wrong("it has no text")
            return
        while self._rest and not self.done:
            piece, self._rest = self._rest[:PIECE], self._rest[PIECE:]
            found = _PLAIN.match(piece)
            assert found is not None
            end = found.end()
            stays = piece[end:] + self._rest
            if end:
                yield json.loads(f'"{piece[:end]}"')
            self._rest = stays
            if not end or stays.startswith('"'):
                break
        self._finish(last=last)

    def _begins(self) -> bool:
        head = _HEAD.match(self._rest)
        if head is None:
            if not _HEAD_PART.fullmatch(self._rest):
                raise _wrong("it is not an object with the key text alone")
            return False
        self._rest, self._inside = self._rest[head.end() :], True
        return True

    def _finish(self, *, last: bool) -> None:
        rest = self._rest
        if rest.startswith('"'):
            if _TAIL.fullmatch(rest):
                self._rest, self.done = "", True
            elif last or not re.fullmatch(r'"\s*', rest):
                raise _wrong("something follows its text")
        elif len(rest) >= LONGEST_ESCAPE and not _PLAIN.match(rest[: LONGEST_ESCAPE + 1]):
            raise _wrong("its text has a wrong escape")
        elif rest and rest[0] < " ":
            raise _wrong("its text has a control character that is not escaped")
        if last and not self.done:
            raise _wrong("it ends within its text")


def _wrong(reason: str) -> UsageError:
    hint = 'send {"text": "..."} as JSON'
    return UsageError(
        Diagnostic("upload-format", f"the upload cannot be read: {reason}", hint=hint)
    )
