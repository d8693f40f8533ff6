"""The warning of a distance without a decimal point, which some controls count in 0.001 mm."""

from __future__ import annotations

from cnc.gcode.dialects import Dialect
from cnc.gcode.state.source_location import SourceLocation
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.statement import Statement
from cnc.gcode.syntax.words import AXES, Word

_DISTANCES = AXES | frozenset("IJKR")
_Q_IS_DISTANCE = frozenset((G.G73.code, G.G76.code, G.G83.code))


def report_missing(
    statement: Statement, dialect: Dialect, here: SourceLocation, *, collected: bool
) -> bool:
    """Report the first distance without a decimal point; return whether there is one.

    Args:
        statement: The line.
        dialect: The dialect.
        here: Place of the line.
        collected: Whether the line belongs to a NURBS.
    """
    word = _without_point(statement, repeats=dialect.cycles.repeats, collected=collected)
    if word is None:
        return False
    message = f"{word.written} has no decimal point: it is read as mm, inches or degrees"
    hint = f"other controls would read a thousandth of it or less: write {word.written}."
    here.report_warning("decimal-point-missing", message, word, hint)
    return True


def _without_point(statement: Statement, *, repeats: str, collected: bool) -> Word | None:
    """Return the first distance or angle that is not 0 and has no decimal point.

    In a line that is ``collected`` for a NURBS, and in that of G6.2, only axis words are distances:
    K is a knot and R a weight. A letter of ``repeats`` counts holes, unless an arc's centre has
    another letter beside it. Q is a distance in the line of a cycle that pecks or shifts.
    """
    words = statement.words
    codes = {word.number for word in words if word.letter == "G"}
    letters = AXES if collected or G.G6_2.code in codes else _DISTANCES
    if letters is _DISTANCES and not any(word.letter in "IJ" for word in words):
        letters -= frozenset(repeats)
    if not codes.isdisjoint(_Q_IS_DISTANCE):
        letters |= {"Q"}
    return next(
        (
            word
            for word in words
            if word.letter in letters
            and (word.number < 0.0 or word.number > 0.0)  # a computed one is no number yet
            and "." not in word.written
        ),
        None,
    )
