"""Errors for words without a use in their line."""

from __future__ import annotations

from cnc.gcode.state.modal_groups import ModalState
from cnc.gcode.state.source_location import SourceLocation
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.words import LineWords, fault
from cnc.model.diagnostics import GcodeError

_OFFSETS = (
    "I, J and K belong to G2 and G3 (the centre's offset in the plane's two axes), "
    "to G5 and G5.1 (the control point's)"
)
_HINTS = {
    "D": "D belongs to G41 and G42 (the tool's number), G41.1 and G42.1 (its diameter) "
    "and G96 (the highest speed)",
    "E": "numbers have no exponent; E belongs to M66 to M68 (the channel) and to G76 (the taper)",
    "F": "under G93 an F word belongs to the move in its line",
    "H": "H belongs to G43, G43.2 and G44 (the number of the offset) "
    "and to G76 (the spring passes)",
    "I": _OFFSETS,
    "J": _OFFSETS,
    "K": "I, J and K belong to G2 and G3 (the centre's offset in the plane's two axes), "
    "G5 and G5.1; K to G33 and G33.1: the pitch",
    "L": "L belongs to G10 (the kind of offset), canned cycles and M98 (the repeats), "
    "G5.2 (the order) and M66 (the mode)",
    "PL": "PL belongs to the control points of a BSPLINE",
    "PW": "PW belongs to the control points of a BSPLINE",
    "SD": "SD belongs to BSPLINE: the degree",
    **dict.fromkeys(("A3", "B3", "C3"), "it belongs to G0, G1 and BSPLINE under TRAORI"),
    "O": "a program's number stands in a line of its own",
    "P": "P belongs to G4, G5, G5.2, G10, G64, G76, M50 to M53, M62 to M66, M98, "
    "to cycles with a dwell and to the turns of an arc",
    "Q": "Q belongs to G5, G64, G73 and G83 (the peck), G10 L1, G76, M19, M61 and M66 to M68",
    "R": "R belongs to G2 and G3 (the radius), canned cycles, "
    "G10 (a rotation, or the tool's radius), G76 and M19",
}


_USERS = {"D": "G41 or G42", "H": "G43"}
_CENTRE = frozenset("IJK")
_SPINDLE_ON = (3.0, 4.0)


def take_idle(words: LineWords, state: ModalState, here: SourceLocation) -> bool:
    """Take words that controllers ignore, with a warning.

    These are centre words of a traverse, and H and D without a code that uses them if they stand
    beside T and have its number, so that G43 and G41 without H and D mean the same offsets.

    Returns:
        Whether no other word is left.
    """
    if words.rest.keys() <= {"D", "H"}:
        if "T" not in words.users or any(word.number != state.tool for word in words.rest.values()):
            return False
        use, hint = (
            f"no effect without {_USERS[words.first().letter]}",
            "remove it, or give the code",
        )
    elif state.motion == G.G0 and words.rest.keys() <= _CENTRE:
        use, hint = "no use in a traverse (G0) and is ignored", "remove it, or give G2 or G3"
    else:
        return False
    word = words.first()
    here.report_warning("word-idle", f"{word.written} has {use}", word, hint)
    words.rest.clear()
    return True


def unused(words: LineWords, state: ModalState) -> GcodeError:
    """Return the error for the leftmost remaining word."""
    word = words.first()
    if state.motion == G.G6_2 and word.letter in "KURPW":
        message = f"{word.written} after the last knot: the curve is complete"
        return fault(
            "nurbs-still-active", message, word, "go on with G0, G1, G2, G3 or another G6.2"
        )
    hint = _HINTS.get(word.letter, "")
    if word.letter == "P" and any(code.number in _SPINDLE_ON for code in words.m):
        hint = "it is the power in per cent on Snapmaker's machines; here S gives the speed"
    return fault("word-unused", f"{word.written} has no use in this line", word, hint)
