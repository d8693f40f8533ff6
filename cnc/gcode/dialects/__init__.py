"""Dialects: legal codes, meanings that differ between controllers, and defaults.

Each dialect is a TOML file in this folder. Its key ``base`` names a file whose keys it starts from.
linuxcnc.toml, from which all start, explains the keys.
``known.toml`` has the names of codes that no dialect supports, for error messages.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any, get_args

from cnc.gcode.dialects.rules import (
    Alias,
    ArcRules,
    ArcTolerance,
    CallRules,
    CycleRules,
    DwellRules,
    FeedRules,
    HomeRules,
    LineRules,
    MotionRules,
    NotedCode,
    OffsetRules,
    SpindleRules,
    ToolRules,
    TurningRules,
    VariableNumbers,
    near,
)
from cnc.gcode.reader.parser import Flavour, Syntax
from cnc.gcode.reader.words import G_OF_TENTHS, M_OF_NUMBER, G, M, Word, fault
from cnc.model.choices import DialectName, GcodeSystem
from cnc.model.diagnostics import Diagnostic, GcodeError, UsageError
from cnc.model.units import decimal_text

if TYPE_CHECKING:
    from cnc.gcode.reader.parameters import Variables

NAMES: tuple[str, ...] = get_args(DialectName)


@dataclass(frozen=True, slots=True)
class Dialect:
    """The rules of a dialect."""

    name: str
    flavour: Flavour
    lenient: bool
    g: frozenset[G]
    m: frozenset[M]
    axes: frozenset[str]
    nurbs: tuple[str, ...]
    lines: LineRules
    motion: MotionRules
    feed: FeedRules
    arcs: ArcRules
    offsets: OffsetRules
    home: HomeRules
    tools: ToolRules
    spindle: SpindleRules
    dwell: DwellRules
    calls: CallRules
    cycles: CycleRules
    turning: TurningRules
    variables: VariableNumbers
    noted: Mapping[tuple[str, float], NotedCode]
    aliases: Mapping[float, Alias]
    spelled: Mapping[float, list[str]]

    @property
    def systems(self) -> int:
        """Number of coordinate systems, from G54 on."""
        return 9 if G.G59_3 in self.g else 6

    def syntax(self, variables: Variables = ()) -> Syntax:
        """Return the syntax of a program that defines some variables of SINUMERIK."""
        return Syntax(
            self.flavour,
            siemens=self.lines.bspline,
            dollar=self.lines.dollar,
            lenient=self.lenient,
            first_bracket=self.lines.first_bracket,
            dialect=self.name,
            variables=variables,
        )

    def check_g(self, word: Word) -> G:
        """Return the code of a G word.

        Raises:
            GcodeError: The dialect does not have it.
        """
        tenths = word.tenths
        if tenths is not None and tenths in self.g:
            return G_OF_TENTHS[tenths]
        raise _refused(word, self, "g", math.nan if tenths is None else tenths / 10)

    def check_m(self, word: Word) -> M:
        """Return the code of an M word.

        Raises:
            GcodeError: The dialect does not have it.
        """
        number = word.whole
        if number is not None and number in self.m and "-" not in word.written:
            return M_OF_NUMBER[number]
        raise _refused(word, self, "m", word.number)


@lru_cache
def _file(name: str) -> dict[str, Any]:
    """Return the table of a file of this folder; it must not be changed."""
    return tomllib.loads(files(__name__).joinpath(f"{name}.toml").read_text(encoding="utf-8"))


def _read(name: str) -> dict[str, Any]:
    """Return the keys of a dialect. Those of its base are added to each of its tables."""
    own = _file(name)
    table: dict[str, Any] = _read(own["base"]) if "base" in own else {"g": "", "m": ""}
    for key, value in own.items():
        table[key] = table.get(key, {}) | value if isinstance(value, dict) else value
    for key in "gm":
        table[key] += " " + table.pop(f"more_{key}", "")
    missing = table.pop("less_g", "").split()
    table["g"] = " ".join(code for code in table["g"].split() if code not in missing)
    return table


def _codes(text: str) -> list[float]:
    return [float(code) for code in text.split()]


@lru_cache(maxsize=1)
def with_codes() -> tuple[str, ...]:
    """Return the dialects whose programs have G-codes."""
    return tuple(name for name in NAMES if _read(name)["flavour"] != "klartext")


def has_lathe_language(name: str) -> bool:
    """Return whether a dialect has another language for lathes, in a file of its own."""
    return bool(_read(name)["lathe"])


@lru_cache(maxsize=2 * len(NAMES) + 12)
def load(
    name: str,
    *,
    lenient: bool = False,
    lathe: GcodeSystem | None = None,
    least_increments: bool = False,
) -> Dialect:
    """Return the dialect of a name.

    Args:
        name: The name.
        lathe: On a lathe, the system of its G-codes (FANUC and Haas); None on another machine.
        least_increments: On such a lathe, whether lengths without a decimal point are counts of
            the least input increment (parameter 3401, bit 0 DPI, is 0).
        lenient: Read as ``auto`` reads a program that it recognised as one of this dialect: the
            words mean what they mean here, but the codes of ``auto`` are legal too, and common
            slips are warnings.

    Raises:
        UsageError: ``unknown-dialect``.
    """
    if name not in NAMES:
        raise UsageError(
            Diagnostic(
                "unknown-dialect",
                f"there is no dialect {name!r}",
                hint=f"one of {', '.join(NAMES)}",
            )
        )
    table = _read(name)
    if lathe and table["lathe"]:
        table = _read(table["lathe"])
        _translate_numbers(table, lathe)
        if least_increments:
            table["turning"]["least_increments"] = True
            table["lines"]["decimal_points"] = False
        if lenient:
            _take(table, _LENIENT_ON_LATHES)
    elif lenient and table["own_codes"]:
        table["lenient"] = True
        table["lines"] |= {"program_end": False, "same_code_twice": True}
    elif lenient and name != "auto":
        auto = _read("auto")
        builders = table["builders"].split()
        builders += [code[1:] for code in table["noted"] if code[0] == "M"]
        table["g"] += " " + auto["g"]
        table["m"] += " " + " ".join(code for code in auto["m"].split() if code not in builders)
        table["nurbs"] = sorted({*table["nurbs"], *auto["nurbs"]})
        _take(table, _LENIENT)
        # Of the M-codes a builder's may have the same number.
        noted = {code: note for code, note in auto["noted"].items() if code[0] == "G"}
        table["noted"] = noted | table["noted"]
    return _dialect(name, table)


_LENIENT_ON_LATHES = {
    "": ("lenient",),
    "arcs": ("idle_center",),
    "lines": ("program_end", "dollar", "same_code_twice"),
}
_LENIENT = {
    "": ("lenient", "axes"),
    "arcs": ("turns", "idle_center"),
    "home": ("beside_motion",),
    "feed": ("units_first",),
    "lines": ("program_end", "dollar", "program_number", "same_code_twice", "both_coolants"),
}
"""Keys in which ``auto`` is at least as tolerant as any dialect, by table."""


def _take(table: dict[str, Any], keys: Mapping[str, tuple[str, ...]]) -> None:
    """Give a dialect the values of ``auto`` for some keys."""
    auto = _read("auto")
    for topic, names in keys.items():
        to, values = (table[topic], auto[topic]) if topic else (table, auto)
        to |= {name: values[name] for name in names}


def _translate_numbers(table: dict[str, Any], system: GcodeSystem) -> None:
    """Give the numbers of codes of FANUC's and Haas' lathes the meaning of a system."""
    numbers = table["systems"][system]
    table["aliases"] |= {code: {"is": meant} for code, meant in numbers.items()}


def _dialect(name: str, table: dict[str, Any]) -> Dialect:
    motion, arcs = table["motion"], table["arcs"]
    start = G(round(float(motion["at_start"]) * 10)) if motion["at_start"] else None
    legal = set(_codes(table["g"]))
    return Dialect(
        name=name,
        flavour=table["flavour"],
        lenient=table["lenient"],
        g=frozenset(G(round(code * 10)) for code in _codes(table["g"])),
        m=frozenset(M(int(code)) for code in _codes(table["m"])),
        axes=frozenset(table["axes"]),
        nurbs=tuple(table["nurbs"]),
        lines=LineRules(**table["lines"]),
        motion=MotionRules(**motion | {"at_start": start}),
        feed=FeedRules(**table["feed"]),
        arcs=ArcRules(**arcs | {unit: ArcTolerance(**arcs[unit]) for unit in ("mm", "inch")}),
        offsets=OffsetRules(**table["offsets"]),
        home=HomeRules(**table["home"]),
        tools=ToolRules(**table["tools"]),
        spindle=SpindleRules(**table["spindle"]),
        dwell=DwellRules(**table["dwell"]),
        calls=CallRules(**table["calls"]),
        cycles=CycleRules(**table["cycles"]),
        turning=TurningRules(**table["turning"]),
        variables=VariableNumbers(**table["variables"]),
        noted={
            code: note
            for code, note in _noted(table["noted"])
            if code[0] != "G" or note.needs or code[1] not in legal
        },
        aliases={
            float(code): Alias(float(meant["is"]), meant.get("word", ""), meant.get("without", ""))
            for code, meant in table["aliases"].items()
        },
        spelled={float(code): words for code, words in table["spelled"].items()},
    )


def _noted(table: dict[str, Any]) -> Iterator[tuple[tuple[str, float], NotedCode]]:
    """Yield the codes of ``[noted]``: letter and number, and the note."""
    for code, keys in table.items():
        words = keys.get("words", "PQ" if code[0] == "M" else "")
        unchecked = keys.get("unchecked", False)
        note = NotedCode(keys["name"], words, keys.get("needs", ""), unchecked)
        yield (code[0], float(code[1:])), note


@lru_cache(maxsize=len(NAMES))
def _legal(name: str) -> dict[str, frozenset[float]]:
    """Return the codes of a dialect as numbers, by ``g`` and ``m``."""
    table = _read(name)
    return {kind: frozenset(_codes(table[kind])) for kind in "gm"}


_USER_CODES = range(100, 200)
"""M-codes of LinuxCNC that run a file of the user."""


def _refused(word: Word, dialect: Dialect, kind: str, code: float) -> GcodeError:
    """Return the error of a code: other dialects have it, other controllers, or none."""
    name = word.written
    if "-" in name:
        return fault("code-unknown", f"{name} is unknown", word, "codes are not negative")
    builder = (
        f'a builder\'s code gets its effect in the machine file: [program.codes] {name} = "..", or '
        f'{{ file = ".." }} for a call of a macro'
    )
    if own := _file("known").get(dialect.name, {}).get(f"{kind}{code:g}"):
        hint = _file("known")["instead"].get(
            f"{dialect.name}-{kind}", builder if kind == "m" else ""
        )
        return fault("code-not-supported", f"{name} ({own}) is not supported", word, hint)
    elsewhere = [
        name_of_other
        for name_of_other in with_codes()
        if name_of_other != "auto" and code in _legal(name_of_other)[kind]
    ]
    if elsewhere:
        hint = f"use --dialect {' or '.join(elsewhere)}{f'; {builder}' if kind == 'm' else ''}"
        if (note := load("fanuc").noted.get((kind.upper(), code))) and note.needs:
            hint = f"with {note.needs} it is FANUC's {note.name}, which has no use here: remove it"
        return fault(
            "code-not-in-dialect", f"{name} is not in the {dialect.name} dialect", word, hint
        )
    if printer := kind == "m" and _file("known")["printer"].get(f"{code:g}"):
        message = f"{name} ({printer}) is not supported"
        if dialect.flavour == "macro-b":
            message = f"{name} is not supported: a builder's code, or {printer}"
        return fault("code-not-supported", message, word, builder)
    if meaning := _file("known")[kind].get(f"{code:g}"):
        hint = builder if kind == "m" else _file("known")["instead"].get(f"g{code:g}", "")
        return fault("code-not-supported", f"{name} ({meaning}) is not supported", word, hint)
    if kind == "m" and dialect.name == "linuxcnc" and code in _USER_CODES:
        message = f"{name} (a command of the user's own, M100 to M199) is not supported"
        return fault("code-not-supported", message, word, builder)
    similar = " or ".join(
        f"{kind.upper()}{name_of_other}"
        for name_of_other in near(decimal_text(word.number, 3), _legal(dialect.name)[kind])
    )
    hint = f"did you mean {similar}?" if similar else ""
    if kind == "m":
        hint = f"{hint} {builder}" if hint else builder
    return fault("code-unknown", f"{name} is unknown", word, hint)
