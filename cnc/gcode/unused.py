"""Words that nothing in their line has use for."""

from __future__ import annotations

from cnc.errors import GcodeError
from cnc.gcode.modal import NURBS, Modal
from cnc.gcode.words import LineWords, fault

_HINTS = {
    "D": "D belongs to G41 and G42 (the tool's number), G41.1 and G42.1 (its diameter) and G96 (the highest speed)",
    "E": "numbers have no exponent",
    "F": "under G93 an F word belongs to the move in its line",
    "H": "H belongs to G43, G43.2 and G44: the number of the offset",
    "I": "I, J and K belong to G2 and G3 (the centre's offset in the plane's two axes), to G5 and G5.1 (the control point's)",
    "J": "I, J and K belong to G2 and G3 (the centre's offset in the plane's two axes), to G5 and G5.1 (the control point's)",
    "K": "I, J and K belong to G2 and G3 (the centre's offset in the plane's two axes), G5 and G5.1; K to G33 and G33.1: the pitch",
    "L": "L belongs to G10 (what is set), to canned cycles (the repeats) and to G5.2 (the order)",
    "PL": "PL belongs to the control points of a BSPLINE",
    "PW": "PW belongs to the control points of a BSPLINE",
    "SD": "SD belongs to BSPLINE: the degree",
    "O": "subprograms are not supported",
    "P": "P belongs to G4, G5, G5.2, G10, G64, to cycles with a dwell (G82, G86, G88, G89, G74, G84) and to the turns of an arc",
    "Q": "Q belongs to G5, G64 and to G73 and G83: the bite",
    "R": "R belongs to G2 and G3 (the radius), to canned cycles and to G10 L1, L2, L10 and L11",
}


def unused(words: LineWords, state: Modal) -> GcodeError:
    """The error for the leftmost word that is left."""
    word = min(words.rest.values(), key=lambda word: word.column)
    if state.motion == NURBS and word.letter in "KURPW":
        message = f"{word.written} after the last knot: the curve was complete"
        return fault("nurbs-still-active", message, word, "go on with G0, G1, G2, G3 or another G6.2")
    return fault("word-unused", f"{word.written} has no use in this line", word, _HINTS.get(word.letter, ""))
