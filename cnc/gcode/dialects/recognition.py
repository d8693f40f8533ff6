"""Recognition of a program's controller by the evidence in its first lines.

The evidence is data: ``recognise.toml``. Nothing here reads the program.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Iterator
from functools import lru_cache
from importlib.resources import files
from typing import Literal, NamedTuple, cast, get_args

from cnc.model.choices import DialectName, MachineKind
from cnc.model.diagnostics import Diagnostic, GcodeError

LINES = 400
"""Lines in which evidence is searched."""
LONGEST = 400
"""Characters of a line in which evidence is searched."""

_COMMENT = re.compile(r"\([^()]*\)|[(;].*")
_Y_WORD = re.compile(r"(?:^|[\s0-9.])Y\s*[-+#\[]?\s*[0-9.]")
_QUOTED = re.compile(r'"[^"]*"')


class _Evidence(NamedTuple):
    """A pattern that points to a language.

    Attributes:
        language: The language.
        kind: The language in words, if it is not a dialect.
        points: Weight.
        what: The finding in words.
        place: The part of a line that is searched.
        pattern: The pattern.
    """

    language: str
    kind: str
    points: int
    what: str
    place: Literal["code", "comment", "line"]
    pattern: re.Pattern[str]


class Reason(NamedTuple):
    """Evidence in a program: the words, what they are, and their line from 1."""

    written: str
    what: str
    line: int

    def __str__(self) -> str:
        """Return the reason as reports name it."""
        return f"{self.written} in line {self.line} ({self.what})"


class Recognition(NamedTuple):
    """The language of a program.

    Attributes:
        dialect: The dialect; ``auto`` if nothing points to one.
        reasons: The evidence for it.
        refusal: A language that is not read, or a machine of another kind, in words; else empty.
        rival: Another dialect with evidence of its own; empty if there is none.
    """

    dialect: DialectName = "auto"
    reasons: tuple[Reason, ...] = ()
    refusal: str = ""
    rival: str = ""

    def described(self) -> str:
        """Return the dialect and its reasons as one line."""
        if not self.reasons:
            return "auto: nothing in the first lines points to a controller"
        return f"{self.dialect}, by " + "; ".join(map(str, self.reasons))


class _Table(NamedTuple):
    evidence: tuple[_Evidence, ...]
    extends: dict[str, str]
    enough: int


@lru_cache(maxsize=1)
def _table() -> _Table:
    data = tomllib.loads(files(__package__).joinpath("recognise.toml").read_text(encoding="utf-8"))
    rows = tuple(
        _Evidence(
            each["for"],
            each.get("is", ""),
            each["points"],
            each["what"],
            each.get("in", "code"),
            re.compile(each["pattern"], re.IGNORECASE),
        )
        for each in data["evidence"]
    )
    return _Table(rows, data["extends"], data["enough"])


def evidence() -> list[tuple[str, int, str]]:
    """Return language, points and description of each piece of evidence, for the reference."""
    return [(each.kind or each.language, each.points, each.what) for each in _table().evidence]


def recognise(lines: Iterable[str]) -> Recognition:
    """Return the language of a program, from its first lines."""
    table = _table()
    found: dict[str, list[tuple[_Evidence, Reason]]] = {}
    has_y = False
    left = list(table.evidence)
    for number, line in _first(lines):
        code = _QUOTED.sub('""', _COMMENT.sub(" ", line)).upper().strip()
        comments = _COMMENT.findall(line)
        has_y = has_y or _Y_WORD.search(code) is not None
        for each in tuple(left):
            texts = {"code": [code], "comment": comments, "line": [line]}[each.place]
            for text in texts:
                if match := each.pattern.search(text):
                    left.remove(each)
                    reason = Reason(_shown(match[0]), each.what, number)
                    found.setdefault(each.language, []).append((each, reason))
                    break
    if has_y:
        found.pop("lathe", None)
    return _choice(table, found)


def _first(lines: Iterable[str]) -> Iterator[tuple[int, str]]:
    for number, line in enumerate(lines, start=1):
        if number > LINES:
            return
        if text := line.strip()[:LONGEST]:
            yield number, text


def _shown(written: str) -> str:
    text = " ".join(written.split())
    return text if len(text) <= 40 else f"{text[:37]}..."


def _choice(table: _Table, found: dict[str, list[tuple[_Evidence, Reason]]]) -> Recognition:
    """Weigh the evidence by language."""
    for special, base in table.extends.items():
        if special in found:
            found[special] = found.pop(base, []) + found[special]
    points = {language: sum(each.points for each, _ in rows) for language, rows in found.items()}
    ranked = sorted(points, key=lambda language: -points[language])
    if not ranked or points[ranked[0]] < table.enough:
        return Recognition()
    best = ranked[0]
    reasons = tuple(reason for _, reason in found[best])
    rivals = [each for each in ranked[1:] if points[each] >= table.enough and _is_dialect(each)]
    if len(ranked) > 1 and points[ranked[1]] == points[best]:
        return Recognition(rival=" or ".join(sorted((best, ranked[1]))), reasons=())
    if best == "lathe":
        is_lathe = points[best] > table.enough
        return Recognition(refusal="lathe", reasons=reasons) if is_lathe else Recognition()
    if not _is_dialect(best):
        return Recognition(refusal=found[best][0][0].kind, reasons=reasons)
    return Recognition(cast(DialectName, best), reasons, rival=rivals[0] if rivals else "")


def _is_dialect(language: str) -> bool:
    return language in get_args(DialectName)


def refuse(recognition: Recognition, kind: MachineKind, file: str) -> None:
    """Refuse a program that is of a language that is not read, or for another kind of machine.

    Args:
        recognition: The language of the program.
        kind: Kind of the machine.
        file: The program, for messages.

    Raises:
        GcodeError: ``not-gcode``, ``program-for-lathe``, ``program-for-printer``.
    """
    if not recognition.reasons:
        return
    line, why = recognition.reasons[0].line, "; ".join(map(str, recognition.reasons))
    if recognition.refusal == "lathe":
        message = f"this is a lathe's program in FANUC's language, by {why}"
        hint = "G99, U, W and T0101 have another meaning in the dialects that are read"
        raise GcodeError(Diagnostic("program-for-lathe", message, file, line, hint=hint))
    elif recognition.refusal:
        message = f"this looks like {recognition.refusal}, by {why}"
        hint = "cncrun reads G-code; let the CAM system write G-code, or name a --dialect"
        raise GcodeError(Diagnostic("not-gcode", message, file, line, hint=hint))
    elif recognition.dialect == "marlin" and kind not in ("printer", "laser"):
        message = f"this is a 3D printer's program, by {why}; the machine is a {kind}"
        hint = 'use a machine file with kind = "printer", or --dialect marlin'
        raise GcodeError(Diagnostic("program-for-printer", message, file, line, hint=hint))
