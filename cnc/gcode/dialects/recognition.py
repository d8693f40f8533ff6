"""Recognition of a program's controller by the evidence in its first lines.

The evidence is data: ``recognise.toml``. Nothing here reads the program.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from importlib.resources import files
from typing import Literal, NamedTuple, cast, get_args

from cnc.gcode.dialects import Dialect
from cnc.model.choices import DialectName, MachineKind
from cnc.model.diagnostics import Diagnostic, GcodeError

LINES = 400
"""Lines in which evidence is searched."""
LONGEST = 400
"""Characters of a line in which evidence is searched."""
MOST_REASONS = 6
"""Reasons for a lathe that are named, the strongest first."""
STRONG = 2
"""Points of evidence for a lathe that milling programs do not have."""
DRIVEN = 3
"""Evidence for a lathe in a program with Y, as a multiple of the evidence without Y."""
_FIVE_DIGITS = "fanuc or haas"
"""Name of the evidence that does not tell FANUC's language from Haas'."""
_LATHES = {"auto": "lathe", "fanuc": "lathe", "haas": "lathe", "siemens": "siemens-lathe"}
"""Evidence for a lathe of each language that means something else on a lathe.

``auto`` is no language.
"""

_AROUND = " \t\r\n\x0c\2\x11\x12\x13\x14\x1a\x7f"
"""Characters that mean nothing around a line. Zero bytes inside a line are a sign of UTF-16."""
_COMMENT = re.compile(r"\([^()]*\)|[(;].*")
_Y_WORD = re.compile(r"(?:^|[\s0-9.])Y\s*[-+#\[]?\s*[0-9.]")
_X_AND_Z = re.compile(r"X\s*[-+]?[0-9.]+.*Z\s*[-+]?[0-9.]+")
_QUOTED = re.compile(r'"[^"]*"')
_WORD = re.compile(r"(?<![A-Z0-9_])[A-Z]\s*[-+.#\[0-9]|[%$#@]|^<")
_LONG_WORD = re.compile(r"[^\W\d_]{2}")
_ANY_WORD = re.compile(r"(?<![A-Z])[A-Z#]\s*[-+#\[<]?\s*[0-9.]")
_PROSE = re.compile(r"[A-Z]{2}")


class _Evidence(NamedTuple):
    """A pattern that points to a language.

    Attributes:
        language: The language.
        kind: The language in words, if it is not a dialect.
        points: Weight. Below 0 it speaks against the language.
        what: The finding in words.
        place: The part of a line that is searched; "first" is the first line with code besides %,
            "later" those behind it, "name" the name of the file.
        pattern: The pattern.
        prints: Whether only a 3D printer's program has it.
    """

    language: str
    kind: str
    points: int
    what: str
    place: Literal["first", "later", "code", "comment", "line", "name"]
    pattern: re.Pattern[str]
    prints: bool


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
        lathe: The evidence for a lathe in FANUC's, Haas' or SINUMERIK's language.
        turns: Whether that evidence is enough to refuse the program on another machine.
        prints: Whether the program heats or feeds filament.
        five_digits: Whether the program number of a FANUC program may be one of Haas', too.
    """

    dialect: DialectName = "auto"
    reasons: tuple[Reason, ...] = ()
    refusal: str = ""
    rival: str = ""
    lathe: tuple[Reason, ...] = ()
    turns: bool = False
    prints: bool = False
    five_digits: bool = False

    def described(self) -> str:
        """Return the dialect and its reasons as one line."""
        reasons = self.reasons or (() if self.dialect == "auto" else self.lathe)
        if not reasons:
            return "auto: nothing in the first lines points to a controller"
        return f"{self.dialect}, by " + "; ".join(map(str, reasons))


class _Table(NamedTuple):
    evidence: tuple[_Evidence, ...]
    extends: dict[str, str]
    enough: int


@lru_cache(maxsize=1)
def _table() -> _Table:
    data = tomllib.loads(files(__package__).joinpath("recognise.toml").read_text(encoding="utf-8"))
    rows = tuple(
        _Evidence(
            row["for"],
            row.get("is", ""),
            row["points"],
            row["what"],
            row.get("in", "code"),
            re.compile(row["pattern"], re.IGNORECASE),
            row.get("prints", False),
        )
        for row in data["evidence"]
    )
    return _Table(rows, data["extends"], data["enough"])


def evidence() -> list[tuple[str, int, str]]:
    """Return language, points and description of each piece of evidence, for the reference."""
    return [(row.kind or row.language, row.points, row.what) for row in _table().evidence]


def recognise(lines: Iterable[str], named: DialectName = "auto", file: str = "") -> Recognition:
    """Return the language of a program, from its first lines and the ending of its file's name.

    Evidence for a lathe is that of the ``named`` language, or of the one that is recognised.
    """
    table = _table()
    evidence_for: dict[str, list[tuple[_Evidence, Reason]]] = {}
    has_y, plane, begun = False, None, False
    prose: Reason | None = None
    has_words = False
    left = list(table.evidence)
    for number, line in first_lines(lines):
        code = code_of(line)
        comments = comments_of(line)
        has_y = has_y or _Y_WORD.search(code) is not None
        has_words = has_words or _WORD.search(code) is not None
        if prose is None and _PROSE.search(code):
            prose = Reason(_shown(line), "no line has a word of G-code", number)
        if plane is None and (both := _X_AND_Z.search(code)):
            plane = Reason(_shown(both[0]), "moves in X and Z, and no Y in the first lines", number)
        places = {"code": [code], "comment": comments, "line": [line], "name": [file],
                  "later" if begun else "first": [code]}  # fmt: skip
        begun = code != "%" and (begun or (code != "" and not _is_text(code)))
        for item in tuple(left):
            for text in places.get(item.place, ()):
                if match := item.pattern.search(text):
                    left.remove(item)
                    reason = Reason(_shown(match[0]), item.what, number)
                    evidence_for.setdefault(item.language, []).append((item, reason))
                    break
    lathes = {kind: evidence_for.pop(kind, []) for kind in set(_LATHES.values())}
    five_digits = bool(evidence_for.pop(_FIVE_DIGITS, ()))
    if prose and not has_words and not evidence_for:
        return Recognition(refusal="plain text", reasons=(prose,))
    choice = _choice(table, evidence_for)
    choice = choice._replace(five_digits=five_digits and choice.dialect == "fanuc")
    if choice.dialect == "fagor" and not has_y:
        refusal = "a program of a Fagor control without a Y word, which may be for a lathe"
        return choice._replace(dialect="auto", refusal=refusal)
    kind = _LATHES.get(choice.dialect if named == "auto" else named)
    if choice.refusal or kind is None:
        return choice
    lathe = lathes[kind]
    lathe.sort(key=lambda row: -row[0].points)
    if not lathe or lathe[0][0].points < STRONG:
        return choice
    points = sum(evidence.points for evidence, _ in lathe)
    reasons = [reason for _, reason in lathe]
    if has_y:
        # A lathe with driven tools may have a Y axis.
        if points <= DRIVEN * table.enough:
            return choice
    elif plane:
        points += 1
        reasons.append(plane)
    return choice._replace(lathe=tuple(reasons[:MOST_REASONS]), turns=points > table.enough)


def _is_text(code: str) -> bool:
    """Return whether a line has words of a language, and none of G-code."""
    return _LONG_WORD.search(code) is not None and _ANY_WORD.search(code) is None


def code_of(line: str) -> str:
    """Return a line in capitals, without its comments and the texts in its quotes."""
    return _QUOTED.sub('""', _COMMENT.sub(" ", line)).upper().strip()


def comments_of(line: str) -> list[str]:
    """Return the comments of a line."""
    return _COMMENT.findall(line)


def first_lines(lines: Iterable[str]) -> Iterator[tuple[int, str]]:
    """Yield the lines in which evidence is searched: their numbers from 1, and their texts."""
    for number, line in enumerate(lines, start=1):
        if number > LINES:
            return
        text = line.rstrip(_AROUND).lstrip(_AROUND + "\0")
        if "\0" in text:
            text = line.strip()
        if text := text[:LONGEST]:
            yield number, text


def _shown(written: str) -> str:
    text = " ".join(written.split())
    return text if len(text) <= 40 else f"{text[:37]}..."


def _choice(table: _Table, evidence_for: dict[str, list[tuple[_Evidence, Reason]]]) -> Recognition:
    """Weigh the evidence by language."""
    for special, base in table.extends.items():
        if special in evidence_for:
            evidence_for[special] = evidence_for.pop(base, []) + evidence_for[special]
    points = {
        language: sum(item.points for item, _ in rows) for language, rows in evidence_for.items()
    }
    ranked = sorted(points, key=lambda language: -points[language])
    if not ranked or points[ranked[0]] < table.enough:
        return Recognition()
    best = ranked[0]
    reasons = tuple(reason for evidence, reason in evidence_for[best] if evidence.points > 0)
    rivals = [item for item in ranked[1:] if points[item] >= table.enough and _is_dialect(item)]
    if len(ranked) > 1 and points[ranked[1]] == points[best]:
        return Recognition(rival=" or ".join(sorted((best, ranked[1]))), reasons=())
    if not _is_dialect(best):
        return Recognition(refusal=evidence_for[best][0][0].kind, reasons=reasons)
    prints = any(evidence.prints for evidence, _ in evidence_for[best])
    rival = rivals[0] if rivals else ""
    return Recognition(cast(DialectName, best), reasons, rival=rival, prints=prints)


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
    refuse_lathe(recognition, kind, file)
    if not recognition.reasons:
        return
    line, why = recognition.reasons[0].line, "; ".join(map(str, recognition.reasons))
    if recognition.refusal:
        message = f"this looks like {recognition.refusal}, by {why}"
        hint = "cncrun reads G-code; let the CAM system write G-code, or name a --dialect"
        raise GcodeError(Diagnostic("not-gcode", message, file, line, hint=hint))
    elif recognition.prints and kind not in ("printer", "laser"):
        message = (
            f"this looks like a program for a 3D printer's firmware, by {why}; "
            f"the machine is a {kind}"
        )
        hint = 'use a machine file with kind = "printer", or --dialect marlin'
        raise GcodeError(Diagnostic("program-for-printer", message, file, line, hint=hint))


def refuse_lathe(recognition: Recognition, kind: MachineKind, file: str) -> None:
    """Refuse a program for a lathe on another machine, where its words mean something else.

    Args:
        recognition: The evidence in the program.
        kind: Kind of the machine.
        file: The program, for messages.

    Raises:
        GcodeError: ``program-for-lathe``.
    """
    if not recognition.turns or kind == "lathe":
        return
    line, why = recognition.lathe[0].line, "; ".join(map(str, recognition.lathe))
    message = f"this looks like a program for a lathe, by {why}; the machine is a {kind}"
    hint = (
        'set kind = "lathe" under [machine] of the machine file; on a mill X is no diameter, and '
        "G98, G99, U, W and T0101 mean something else"
    )
    raise GcodeError(Diagnostic("program-for-lathe", message, file, line, hint=hint))


def lathe_dialect(recognition: Recognition, file: str) -> DialectName:
    """Return the dialect of a program on a lathe under ``auto``.

    Raises:
        GcodeError: ``lathe-dialect-unclear``: X may be a diameter or a radius.
    """
    if recognition.dialect != "auto":
        return recognition.dialect
    if recognition.lathe:
        return "fanuc"
    message = "nothing in the first lines says whether X is a diameter or a radius, as in LinuxCNC"
    hint = 'name the dialect, such as --dialect fanuc, or dialect = "fanuc" under [program]'
    raise GcodeError(Diagnostic("lathe-dialect-unclear", message, file, 1, hint=hint))


# What the first lines of a program leave open, and how they are read.
#
# Units without a code, comments that name other units, words that two controllers read differently.

_BEGIN = re.compile(r"[0-9]*\s*BEGIN\s+PGM\b")
_INCH = re.compile(r"G\s*0?20(?![0-9.])")
_MM = re.compile(r"G\s*0?21(?![0-9.])")
_OTHER_INCH = re.compile(r"G\s*700?(?![0-9.])")
_OTHER_MM = re.compile(r"G\s*710?(?![0-9.])")

_STATED = r"UNITS?(?:\s+ARE)?(?:\s*[:=]\s*|\s+)(?:IN\s+)?"
_STATES_INCH = re.compile(
    _STATED + r"(?:IN\b(?!\s*\w)|(?:INCH|INCHES|IMPERIAL)\b)"
    r"|\b(?:DIMENSIONS?|COORDINATES?|VALUES?|MEASUREMENTS?)\s+(?:ARE\s+)?IN\s+INCH(?:ES)?\b"
    r"|\bINCH\s+(?:MODE|UNITS|PROGRAM)\b"
)
_STATES_MM = re.compile(
    _STATED + r"(?:MM|MILLIMET(?:ER|RE)S?|METRIC)\b"
    r"|\b(?:DIMENSIONS?|COORDINATES?|VALUES?|MEASUREMENTS?)\s+(?:ARE\s+)?IN\s+"
    r"(?:MM|MILLIMET(?:ER|RE)S?)\b"
    r"|\b(?:METRIC|MM)\s+(?:MODE|UNITS|PROGRAM)\b"
)
_HINTS_AT_INCH = re.compile(
    rf"{_STATES_INCH.pattern}|\bINCH(?:ES)?\b|\bIMPERIAL\b"
    r"|(?:[0-9]*\.[0-9]+|[0-9]+/[0-9]+)(?:\s*IN\b|\")"
)
_CODES_OF_UNITS = {"siemens": "G70, G71, G700 or G710", "fagor": "G70 or G71"}
_FUNCTIONS = re.compile(r"\b(?:ATAN|FIX|FUP|MOD)\b")
_LOGIC = re.compile(r"(?<![A-Z_<])(?:AND|OR|XOR)(?![A-Z_>])")
_COMPARISON = re.compile(r"(?<![A-Z_<])(?:EQ|NE|GT|GE|LT|LE)(?![A-Z_>])")

_HAAS = (
    (re.compile(r"G\s*10(?=.*L1[23])"), "R of G10 L12 and L13 as a radius (Haas: a diameter)"),
    (re.compile(r"#\s*2[0-6][0-9]{2}(?![0-9])"), "#2001 and on as FANUC numbers offsets"),
    (re.compile(r"G(?:73|83)(?=.*P)"), "P of G73 and G83 without effect (Haas: a dwell)"),
    (re.compile(r"G51(?=.*[PIJK]\s*[0-9]+(?![0-9.]))"), "a scale without a point in thousandths"),
    (re.compile(r"M98\s*P\s*[0-9]{5,8}(?![0-9.])(?!.*L)"), "P of M98 with the number of repeats"),
)
"""Words that FANUC and Haas read differently, without a warning where they stand."""


class AssumedReading(NamedTuple):
    """What the first lines leave open.

    Attributes:
        units: What is assumed of the units; empty if a code names them.
        doubt: The warning of a comment that names other units.
        differences: Words with another meaning on another controller, and the one taken.
    """

    units: str = ""
    doubt: Diagnostic | None = None
    differences: tuple[str, ...] = ()

    def described(self) -> list[str]:
        """Return the assumptions, for the summary."""
        return [*self.differences, *([self.units] if self.units else [])]


def assumed_reading(
    lines: Sequence[str], rules: Dialect, file: str, recognition: Recognition | None
) -> AssumedReading:
    """Return what the first lines of a program leave open.

    Args:
        lines: The lines.
        rules: The dialect in which they are read.
        file: The program, for the warning.
        recognition: The evidence by which the dialect was chosen; None if it was named.
    """
    differences = []
    if rules.name == "auto":
        names = " and ".join(differing_functions(lines))
        differences += [f"{names} as LinuxCNC computes them, not FANUC"] if names else []
    if recognition is not None and recognition.five_digits:
        differences.append(_as_fanuc(lines))
    if rules.flavour == "klartext":
        begins = any(_BEGIN.match(code_of(line)) for _, line in first_lines(lines))
        return AssumedReading("" if begins else "millimetres, as there is no BEGIN PGM")
    inch, mm = _codes_of_units(lines, rules)
    units = ""
    if not (inch or mm):
        codes = _CODES_OF_UNITS.get(rules.name, "G20 or G21")
        units = f"millimetres, as no {codes} is in the first lines"
    doubt = _doubt(lines, file, inch=inch, mm=mm)
    return AssumedReading(units, doubt, tuple(differences))


def _as_fanuc(lines: Sequence[str]) -> str:
    """Return how a program is read whose number may be one of FANUC's or of Haas'."""
    codes = [code_of(line) for _, line in first_lines(lines)]
    words = [text for pattern, text in _HAAS if any(pattern.search(code) for code in codes)]
    listed = f": {', '.join(words)}" if words else ""
    return f"FANUC, not Haas, whose program numbers have five digits, too{listed}"


def _codes_of_units(lines: Sequence[str], rules: Dialect) -> tuple[bool, bool]:
    """Return whether the first lines have a code for inches, and one for mm."""
    codes = [code_of(line) for _, line in first_lines(lines)]
    # G70 and G71 are cycles on Haas' and FANUC's controls.
    more = 70 in rules.aliases
    inch, mm = (
        any(own.search(code) or (more and old_code.search(code)) for code in codes)
        for own, old_code in ((_INCH, _OTHER_INCH), (_MM, _OTHER_MM))
    )
    return inch, mm


def _doubt(lines: Sequence[str], file: str, *, inch: bool, mm: bool) -> Diagnostic | None:
    """Return the warning of a comment that names other units than those that are read."""
    if inch and mm:
        return None
    comments = [
        (number, comment.upper())
        for number, line in first_lines(lines)
        for comment in comments_of(line)
    ]
    named = inch or mm
    if not named and any(_STATES_MM.search(text) for _, text in comments):
        return None
    pattern = _STATES_MM if inch else _STATES_INCH if mm else _HINTS_AT_INCH
    for number, text in comments:
        if match := pattern.search(text):
            written = " ".join(match[0].split())
            read = "inches" if inch else "millimetres"
            why = "" if named else ", as no code of the first lines names the units"
            message = f"the comment says {written}, but numbers are read as {read}{why}"
            hint = "write the code of the units at the start of the program"
            return Diagnostic(
                "units-doubtful", message, file, number, hint=hint, severity="warning"
            )
    return None


def differing_functions(lines: Sequence[str]) -> tuple[str, ...]:
    """Return the functions in the first lines that FANUC and LinuxCNC compute differently.

    They are named with the arguments for which they differ.
    """
    codes = [code_of(line) for _, line in first_lines(lines)]
    functions = {name for code in codes for name in _FUNCTIONS.findall(code)}
    # Of comparisons, which are 0 or 1, the bits and the truth are the same.
    plain = [code for code in codes if not _COMPARISON.search(code)]
    logic = {name for code in plain for name in _LOGIC.findall(code)}
    groups = (functions, "negative numbers"), (logic, "other numbers than 0 and 1")
    return tuple(f"{', '.join(sorted(names))} of {of}" for names, of in groups if names)
