"""Dialects: legal codes, meanings that differ between controllers, and defaults.

Each dialect is a TOML file in this folder. Its key ``base`` names a file whose keys it starts from.
``known.toml`` has the names of codes that no dialect supports, for error messages.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from typing import Any, Literal, get_args

from cnc.gcode.dialects.rules import (
    Alias,
    ArcTolerance,
    CycleRules,
    NotedCode,
    VariableNumbers,
    near,
)
from cnc.gcode.reader.parser import Flavour
from cnc.gcode.reader.words import G_OF_TENTHS, M_OF_NUMBER, G, LineWords, M, Word, fault
from cnc.model.blocks import PathControl
from cnc.model.choices import DialectName, GcodeSystem, WrapRule
from cnc.model.diagnostics import Diagnostic, GcodeError, UsageError

NAMES: tuple[str, ...] = get_args(DialectName)
WITH_CODES = tuple(name for name in NAMES if name != "heidenhain")
"""Dialects whose programs have G-codes."""


@dataclass(frozen=True, slots=True)
class Dialect:
    """The rules of a dialect. The TOML files explain every key."""

    name: str
    g: frozenset[G]
    m: frozenset[M]
    axes: frozenset[str]
    nurbs: tuple[str, ...]
    motion: G | None
    units_before_feed: bool
    arc_turns: bool
    arc_idle_center: bool
    grbl_arcs: bool
    most_line_number: int
    arc_radius_first: bool
    path_stop: PathControl
    path_words: frozenset[str]
    offsets: tuple[int, ...]
    offsets_current: bool
    offsets_add: Literal["no", "yes", "unclear"]
    more_systems: int
    system_word: bool
    shift_stays: bool
    rotation: bool
    offset_memory: bool
    tool_offset_unclear: bool
    offset_diameters: bool
    diameters: bool
    stops_after_move: bool
    length_in_increments: Literal["left", "added", "unclear"]
    length_axes: str
    home_beside_motion: bool
    home_needs_axes: bool
    home_directly: bool
    machine_in_incremental: bool
    motion_assumed: bool
    repeated: str
    same_code_twice: bool
    last_of_group: bool
    both_coolants: bool
    repeats_in_call: bool
    sequence_calls: bool
    skip_parameters: int
    program_number: bool
    decimal_points: bool
    program_end: bool
    flavour: Flavour
    siemens: bool
    dollar: bool
    initial_level: bool | Literal["unclear"]
    lenient: bool
    first_bracket: bool
    after_g80: Literal["none", "previous", "assumed"]
    local_calls: bool
    hole_patterns: bool
    profile_subroutines: bool
    length_units: list[int]
    scale_unit: float
    extruder: str
    corners: Literal["", "lines", "rounds", "all"]
    figures: Literal["fanuc", "mach3"]
    orient_angle: str
    spindle_power: str
    first_feed: float
    turret_offsets: Literal["", "P", "L"]
    wrap: WrapRule
    feed_of_all_axes: bool
    compensation_again: Literal["", "same", "zero"]
    own_tool_offsets: bool
    dwell: dict[str, float]
    dwell_point: dict[str, float]
    dwell_turns: str
    lathe: bool
    increments: str
    integer_unit: float
    tap_side: frozenset[float]
    retract_is_distance: bool
    two_line_cycles: bool
    cycles: CycleRules
    arc_mm: ArcTolerance
    arc_inch: ArcTolerance
    noted: Mapping[tuple[str, float], NotedCode]
    variables: VariableNumbers
    aliases: Mapping[float, Alias]

    @property
    def systems(self) -> int:
        """Number of coordinate systems, from G54 on."""
        return 9 if G.G59_3 in self.g else 6

    def dwell_units(self, words: LineWords) -> dict[str, float]:
        """Return the letters that are the time of G4 in a line, with their units.

        A letter that needs a decimal point may be an axis: it is the time if no other word is, and
        G4 the only G-code.
        """
        certain = {letter: unit for letter, unit in self.dwell.items() if unit}
        if len(words.g) > 1 or not words.rest.keys().isdisjoint(certain):
            return certain
        return self.dwell

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


def _read(name: str) -> dict[str, Any]:
    table = tomllib.loads(files(__name__).joinpath(f"{name}.toml").read_text(encoding="utf-8"))
    if base := table.pop("base", ""):
        table = _merged(_read(base), table)
    for key in "gm":
        table[key] += " " + table.pop(f"more_{key}", "")
    missing = table.pop("less_g", "").split()
    table["g"] = " ".join(code for code in table["g"].split() if code not in missing)
    return table


_ADDED = ("noted", "aliases", "cycles", "variables")
"""Tables that a dialect adds to those of its base; other keys replace those of the base."""


def _merged(base: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """Return the keys of a base with those of a dialect over them."""
    return base | own | {key: base[key] | own.get(key, {}) for key in _ADDED}


def _codes(text: str) -> list[float]:
    return [float(code) for code in text.split()]


LATHES = ("fanuc", "haas")
"""Dialects with another language for lathes, in a file of their own."""


@lru_cache(maxsize=2 * len(NAMES) + 12)
def load(name: str, *, lenient: bool = False, lathe: GcodeSystem | None = None) -> Dialect:
    """Return the dialect of a name.

    Args:
        name: The name.
        lathe: On a lathe, the system of its G-codes (FANUC and Haas); None on another machine.
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
    if lathe and name in LATHES:
        return _lathe(name, lathe, lenient=lenient)
    table = _read(name)
    own_codes = table.pop("own_codes")
    if lenient and own_codes:
        table |= {"lenient": True, "program_end": False, "same_code_twice": True}
    elif lenient and name != "auto":
        auto = _read("auto")
        builders = {code[1:] for code in table["noted"] if code[0] == "M"}
        if table["flavour"] in ("macro-b", "siemens"):
            builders |= _BUILDERS
        table["g"] += " " + auto["g"]
        table["m"] += " " + " ".join(code for code in auto["m"].split() if code not in builders)
        table["nurbs"] = sorted({*table["nurbs"], *auto["nurbs"]})
        table |= {key: auto[key] for key in _LENIENT}
        # Of the M-codes a builder's may have the same number.
        noted = {code: note for code, note in auto["noted"].items() if code[0] == "G"}
        table["noted"] = noted | table["noted"]
    return _dialect(name, table)


_BUILDERS = {
    str(code) for code in (*range(50, 54), *range(61, 69), *range(70, 74), *range(428, 431))
}
"""M-codes of LinuxCNC that are a builder's codes on FANUC, Haas and Siemens."""

_LENIENT = (
    "lenient", "axes", "arc_turns", "arc_idle_center", "home_beside_motion", "program_end",
    "dollar", "program_number", "units_before_feed", "same_code_twice", "both_coolants",
)  # fmt: skip
"""Keys in which ``auto`` is at least as tolerant as any dialect."""


_LENIENT_ON_LATHES = (
    "lenient",
    "arc_idle_center",
    "program_end",
    "dollar",
    "same_code_twice",
)


def _lathe(name: str, system: GcodeSystem, *, lenient: bool) -> Dialect:
    """Return the language of FANUC's and Haas' lathes; the system gives numbers their meaning."""
    table = _read(f"{name}-lathe")
    if lenient:
        auto = _read("auto")
        table |= {key: auto[key] for key in _LENIENT_ON_LATHES}
    numbers = table.pop("systems")[system]
    table["aliases"] |= {code: {"is": other} for code, other in numbers.items()}
    if system != "A":
        table["increments"] = ""
    return _dialect(name, table)


def _dialect(name: str, table: dict[str, Any]) -> Dialect:
    arc = table["arc"]
    return Dialect(
        name=name,
        g=frozenset(G(round(code * 10)) for code in _codes(table["g"])),
        m=frozenset(M(int(code)) for code in _codes(table["m"])),
        axes=frozenset(table["axes"]),
        nurbs=tuple(table["nurbs"]),
        motion=G(round(float(table["motion"]) * 10)) if table["motion"] else None,
        path_words=frozenset(table["path_words"]),
        tap_side=frozenset(_codes(table["tap_side"])),
        offsets=tuple(table["offsets"]),
        cycles=CycleRules(**table["cycles"]),
        arc_mm=ArcTolerance(arc["slack"], arc["relative"], arc["limit"], arc["reach"]),
        arc_inch=ArcTolerance(arc["slack_inch"], arc["relative"], arc["limit_inch"], arc["reach"]),
        noted=dict(_noted(table["noted"])),
        variables=VariableNumbers(**table["variables"]),
        aliases={
            float(code): Alias(float(each["is"]), each.get("word", ""), each.get("without", ""))
            for code, each in table["aliases"].items()
        },
        **{key: table[key] for key in _PLAIN},
    )


_PLAIN = (
    "units_before_feed", "arc_turns", "arc_idle_center", "arc_radius_first", "path_stop",
    "offsets_current", "offsets_add", "more_systems", "shift_stays", "rotation", "offset_memory",
    "tool_offset_unclear", "length_axes",
    "offset_diameters", "diameters", "grbl_arcs", "most_line_number", "stops_after_move",
    "length_in_increments", "home_beside_motion", "home_needs_axes", "machine_in_incremental",
    "program_number", "decimal_points", "program_end", "flavour", "siemens", "dollar",
    "initial_level", "lenient", "first_bracket", "after_g80", "local_calls", "scale_unit",
    "extruder", "corners", "figures", "dwell", "dwell_point", "dwell_turns", "lathe", "increments",
    "integer_unit", "retract_is_distance", "two_line_cycles", "orient_angle", "turret_offsets",
    "motion_assumed", "repeated", "same_code_twice", "last_of_group", "both_coolants",
    "repeats_in_call", "sequence_calls", "system_word",
    "skip_parameters", "hole_patterns", "profile_subroutines", "wrap", "feed_of_all_axes",
    "length_units", "home_directly", "spindle_power", "first_feed", "compensation_again",
    "own_tool_offsets",
)  # fmt: skip
"""Keys whose values are those of the file."""


def _noted(table: dict[str, Any]) -> Iterator[tuple[tuple[str, float], NotedCode]]:
    """Yield the codes of ``[noted]``: letter and number, and the note."""
    for code, each in table.items():
        words = each.get("words", "PQ" if code[0] == "M" else "")
        unchecked = each.get("unchecked", False)
        note = NotedCode(each["name"], words, each.get("needs", ""), unchecked)
        yield (code[0], float(code[1:])), note


@lru_cache(maxsize=1)
def _known() -> dict[str, dict[str, str]]:
    return tomllib.loads(files(__name__).joinpath("known.toml").read_text(encoding="utf-8"))


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
    if own := _known().get(dialect.name, {}).get(f"{kind}{code:g}"):
        hint = _known()["instead"].get(f"{dialect.name}-{kind}", builder if kind == "m" else "")
        return fault("code-not-supported", f"{name} ({own}) is not supported", word, hint)
    elsewhere = [other for other in WITH_CODES if other != "auto" and code in _legal(other)[kind]]
    if elsewhere:
        hint = f"use --dialect {' or '.join(elsewhere)}{f'; {builder}' if kind == 'm' else ''}"
        if (note := load("fanuc").noted.get((kind.upper(), code))) and note.needs:
            hint = f"with {note.needs} it is FANUC's {note.name}, which has no use here: remove it"
        return fault(
            "code-not-in-dialect", f"{name} is not in the {dialect.name} dialect", word, hint
        )
    if printer := kind == "m" and _known()["printer"].get(f"{code:g}"):
        message = f"{name} ({printer}) is not supported"
        if dialect.flavour == "macro-b":
            message = f"{name} is not supported: a builder's code, or {printer}"
        return fault("code-not-supported", message, word, builder)
    if meaning := _known()[kind].get(f"{code:g}"):
        hint = builder if kind == "m" else _known()["instead"].get(f"g{code:g}", "")
        return fault("code-not-supported", f"{name} ({meaning}) is not supported", word, hint)
    if kind == "m" and dialect.name == "linuxcnc" and code in _USER_CODES:
        message = f"{name} (a command of the user's own, M100 to M199) is not supported"
        return fault("code-not-supported", message, word, builder)
    similar = " or ".join(
        f"{kind.upper()}{other}"
        for other in near(f"{word.number:.3f}".rstrip("0").rstrip("."), _legal(dialect.name)[kind])
    )
    hint = f"did you mean {similar}?" if similar else ""
    if kind == "m":
        hint = f"{hint} {builder}" if hint else builder
    return fault("code-unknown", f"{name} is unknown", word, hint)
