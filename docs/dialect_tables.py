"""Tables of the dialects for the reference, from the data of :mod:`cnc.gcode.dialects`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from cnc.editor.words import texts
from cnc.gcode import dialects
from cnc.gcode.dialects import Dialect
from cnc.gcode.dialects.recognition import evidence

NAMES = tuple(name for name in dialects.with_codes() if name != "paper")

TOPICS = {
    "straight moves, arcs, pockets": "G0 G1 G2 G3 G9 G12 G13 G53 G53.1",
    "dwell, path": "G4 G61 G61.1 G64",
    "splines": "G5 G5.1 G5.2 G5.3 G6.2",
    "spindle-synchronised": "G33 G33.1 G34 G35",
    "probes": "G31 G38.2 G38.3 G38.4 G38.5 M78 M79",
    "cycles, profiles, patterns of holes": "G70 G71 G72 G73 G74 G76 G80 G81 G82 G83 G84 G85 G86 "
    "G88 G89 G98 G99",
    "planes": "G17 G18 G19",
    "units, distance, diameters": "G7 G8 G20 G21 G90 G90.1 G91 G91.1",
    "feed": "G93 G94 G95",
    "spindle": "G96 G97 M3 M4 M5 M19",
    "coordinate systems": "G10 G52 G54 G54.1 G55 G56 G57 G58 G59 G59.1 G59.2 G59.3 G92 G92.1 G92.2 "
    "G92.3",
    "polar mode, scaling, mirroring, rotation": "G15 G16 G50 G50.1 G51 G51.1 G68 G68.2 G69",
    "tools, tool length": "G43 G43.1 G43.2 G44 G49 M6 M61",
    "face of turned parts": "G12.1 G13.1",
    "mantle of turned parts": "G7.1",
    "tool-tip control": "G43.4 G43.5 M428 M429 M430",
    "cutter compensation": "G40 G41 G41.1 G42 G42.1",
    "reference positions": "G28 G28.1 G30 G30.1",
    "macros, subprograms": "G65 G66 G67 M97 M98 M99",
    "coolant, overrides": "M7 M8 M9 M48 M49 M50 M51 M52 M53",
    "inputs, outputs": "M62 M63 M64 M65 M66 M67 M68",
    "saved modes": "M70 M71 M72 M73",
    "stops": "M0 M1 M2 M30 M60",
}
"""Codes by function. A code in no topic stands under "other"."""

_WORDS = {
    "none": "",
    "assumed": "G0 or G1 before the cycle, with a warning",
    "previous": "G0 to G3 before the cycle",
    "exact-path": "exact path",
    "exact-stop": "stop after each move",
    "no": "",
    "unclear": "refused",
    "added": "yes",
    "left": "",
    "shortest": "shortest way",
    "sign": "by the sign",
    "in-turn": "within the turn",
    "ngc": "RS274/NGC",
    "macro-b": "macro B",
    "siemens": "SINUMERIK",
    "all": "after lines and arcs",
    "lines": "between lines",
    "rounds": "rounds only",
    "kept": "stay",
    "line": "counted again",
    "clear": "R",
    "retract": "the level of G98 or G99",
    "same": "no effect with the same radius",
    "zero": "no effect with a radius of 0",
}
"""Values of keys in words."""


def _word(value: object) -> str:
    """Return a value of a key in a word or two."""
    if isinstance(value, bool):
        return "yes" if value else ""
    return _WORDS.get(str(value), str(value))


def _seconds(rules: Dialect) -> str:
    """Return the letters of G4 with their units."""
    units = {1.0: "s", 0.1: "0.1 s", 0.01: "0.01 s", 0.001: "ms"}
    found = [f"{letter} ({units[unit]})" for letter, unit in rules.dwell.units.items() if unit]
    found += [f"{letter} with a point ({units[u]})" for letter, u in rules.dwell.point.items() if u]
    found += [f"{letter} (turns)" for letter in rules.dwell.turns]
    return ", ".join(found)


def _first_motion(rules: Dialect) -> str:
    """Return the motion of a first move without a code."""
    if rules.motion.at_start is not None:
        return rules.motion.at_start.written
    return "G0, with a warning" if rules.motion.assumed else "error"


def _arc(rules: Dialect) -> str:
    """Return the allowed difference of the radii of an arc."""
    arc = rules.arcs.mm
    share = f", or {arc.relative:.1%} up to {arc.limit:.3g} mm" if arc.relative else ""
    return f"{arc.slack:.3g} mm{share}"


MEANINGS: dict[str, Callable[[Dialect], str]] = {
    "expressions and control flow": lambda rules: (
        "" if rules.flavour == "none" else _word(rules.flavour)
    ),
    "needs M2, M30 or a pair of `%`": lambda rules: _word(rules.lines.program_end),
    "first move without a motion code": _first_motion,
    "motion after G80": lambda rules: _word(rules.motion.after_g80),
    "time of G4": _seconds,
    "G61": lambda rules: _word(rules.motion.path_stop),
    "tolerance of the radii of an arc": _arc,
    "P turns of an arc": lambda rules: _word(rules.arcs.turns),
    "R of an arc before I, J, K": lambda rules: _word(rules.arcs.radius_first),
    "forms of G6.2": lambda rules: ", ".join(rules.nurbs),
    "L of G10": lambda rules: " ".join(str(number) for number in sorted(rules.offsets.written)),
    "G10 L2 adds under G91": lambda rules: _word(rules.offsets.add),
    "systems of G54.1 (G505 ..)": lambda rules: str(rules.offsets.more_systems or ""),
    "tool offset acts on": lambda rules: "all axes" if len(rules.tools.length_axes) > 1 else "Z",
    "Z moves by the tool length in the line of G43 under G91": lambda rules: _word(
        rules.tools.length_in_increments
    ),
    "memory of offsets by H and D": lambda rules: _word(rules.tools.memory),
    "repeats of a cycle": lambda rules: ", ".join(rules.cycles.repeats),
    "clearance of G73 and G83, mm": lambda rules: f"{rules.cycles.clearance:g}",
    "R and depth when G90 or G91 changes": lambda rules: _word(rules.cycles.heights),
    "G76 is fine boring": lambda rules: _word(rules.cycles.fine_boring),
    "`,C` and `,R`": lambda rules: _word(rules.motion.corners),
    "M7 and M8 in one line": lambda rules: _word(rules.lines.both_coolants),
    "M5 in the line of a move acts behind it": lambda rules: _word(rules.spindle.stops_after_move),
    "last of two words counts": lambda rules: ", ".join(rules.lines.repeated),
    "a code may stand twice in a line": lambda rules: _word(rules.lines.same_code_twice),
    "last of two codes of a group counts": lambda rules: _word(rules.lines.last_of_group),
    "G41 under G41": lambda rules: _word(rules.tools.compensation_again) or "error",
    "moves of a rotary axis that repeats": lambda rules: _word(rules.motion.wrap),
    "F counts along all axes": lambda rules: _word(rules.feed.of_all_axes),
    "feed before the first F, mm/min": lambda rules: (
        f"{rules.feed.at_start:g}" if rules.feed.at_start else ""
    ),
    "warning of a distance without a decimal point": lambda rules: _word(
        rules.lines.decimal_points
    ),
}
"""Meanings that differ, by what they are about."""


def page() -> str:
    """Return the page of the codes and meanings of each dialect, and of the evidence for it."""
    rules = [dialects.load(name) for name in NAMES]
    lines = [
        "# Codes by dialect",
        "",
        "Made from the data of the dialects (`cnc/gcode/dialects`).",
        "",
        "## Functions",
        "",
        "What `cncrun lsp` shows. A dialect may write a function with another number, as below.",
        "",
        "| code | function |",
        "| --- | --- |",
        *_functions(),
        "",
    ]
    for topic, codes in by_topic().items():
        rows = ((code, ["yes" if _has(each, code) else "" for each in rules]) for code in codes)
        lines += [f"## {topic[0].upper()}{topic[1:]}", "", *_table("code", rows), ""]
    meanings = ((title, [meaning(each) for each in rules]) for title, meaning in MEANINGS.items())
    lines += ["## Meanings", "", "An empty cell is a no.", "", *_table("", meanings), ""]
    lines += [
        "## Codes without effect",
        "",
        "| code | dialects | function |",
        "| --- | --- | --- |",
    ]
    noted = sorted({(key, note.name) for each in rules for key, note in each.noted.items()})
    for key, function in noted:
        users = [
            each.name for each in rules if key in each.noted and each.noted[key].name == function
        ]
        lines.append(f"| {key[0]}{key[1]:g} | {', '.join(users)} | {function} |")
    lines += ["", "## Evidence for `auto`", "", "| dialect or language | points | evidence |"]
    lines.append("| --- | --- | --- |")
    lines += [f"| {name} | {points} | {what} |" for name, points, what in evidence()]
    return "\n".join(lines) + "\n"


def _functions() -> Iterator[str]:
    """Yield a row for each code, with its function; then those of lathes."""
    listed = texts()
    for table, letter in (("g", "G"), ("m", "M")):
        yield from (f"| {letter}{code} | {text} |" for code, text in listed[table].items())
    yield from (f"| G{code} on lathes | {text} |" for code, text in listed["lathe"].items())


def by_topic() -> dict[str, list[str]]:
    """Return the codes of all dialects by topic, each once."""
    rules = [dialects.load(name) for name in NAMES]
    codes = [code.written for code in sorted({g for each in rules for g in each.g if g >= 0})]
    codes += [f"M{number}" for number in sorted({m for each in rules for m in each.m})]
    topics = {topic: text.split() for topic, text in TOPICS.items()}
    named = {code for listed in topics.values() for code in listed}
    topics["other"] = [code for code in codes if code not in named]
    return {
        topic: found
        for topic, listed in topics.items()
        if (found := [code for code in listed if code in codes])
    }


def _has(rules: Dialect, code: str) -> bool:
    """Return whether a dialect has a code."""
    return code in {each.written for each in rules.g if each >= 0} or code in {
        f"M{each}" for each in rules.m
    }


def _table(first: str, rows: Iterator[tuple[str, Sequence[str]]]) -> Iterator[str]:
    """Yield a table with a column for each dialect."""
    yield f"| {first} | " + " | ".join(NAMES) + " |"
    yield "| --- |" + " --- |" * len(NAMES)
    for title, cells in rows:
        yield f"| {title} | " + " | ".join(cells) + " |"
