"""Words of Fagor's cycles for holes: Z is the level R, I the bottom, K the dwell.

In G83 I is a peck with its sign, and J the number of pecks. Source: Autodesk, post "FAGOR
8037/8055", its cycles.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from cnc.gcode.state.modal_groups import Code, ModalState
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.words import LineWords, Word, fault, whole
from cnc.model.diagnostics import GcodeError

MOST_PECKS = 10_000
"""Most pecks of a hole."""


Make = Callable[[LineWords, Code | None], None]
"""A function that makes the holes of a line."""


def with_own_words(make: Make, state: ModalState) -> Make:
    """Return the function with the words of a line as Fagor's controls have them."""

    def make_own(words: LineWords, code: Code | None) -> None:
        cycle, at = state.motion, code.word if code else words.first()
        assert cycle is not None
        _take_plane_and_depth(words, state, cycle, at)
        try:
            make(words, code)
        except GcodeError as error:
            if error.diagnostic.code != "cycle-word-missing":
                raise
            message = f"{cycle.written} needs Z, the level, and I, the bottom"
            raise fault("cycle-word-missing", message, at, "give both in its first line") from None

    return make_own


def _take_plane_and_depth(words: LineWords, state: ModalState, cycle: G, at: Word) -> None:
    """Give the words of a cycle the letters that the other controls have: R, Z, P and Q.

    Raises:
        GcodeError: ``cycle-plane``, ``cycle-distance-mode``, ``cycle-word-missing``,
            ``value-out-of-range``, ``word-unused``.
    """
    rest = words.rest
    for letter in "RPQ":
        if word := rest.get(letter):
            message = f"{word.written} is no word of {cycle.written} on Fagor's controls"
            raise fault("word-unused", message, word, "Z is the level, I the bottom, K the dwell")
    if state.plane != "XY":
        message = f"{cycle.written} is supported in the plane G17 only"
        raise fault("cycle-plane", message, at, "give G17 before")
    if not state.absolute:
        message = f"{cycle.written} under G91 is not supported"
        raise fault("cycle-distance-mode", message, at, "give G90 before")
    depth, level = rest.pop("I", None), rest.pop("Z", None)
    if "K" in rest:
        rest["P"] = rest.pop("K")
    if level is not None:
        rest["R"] = level
    if cycle != G.G83:
        if depth is not None:
            rest["Z"] = depth
        return
    count = rest.pop("J", None)
    if level is None and depth is None and count is None:
        return
    if level is None or depth is None or count is None:
        message = f"{cycle.written} needs Z, I and J together"
        raise fault("cycle-word-missing", message, at, "give the level, a peck, their number")
    pecks = whole(count, "the number of pecks", 1, MOST_PECKS)
    rest["Z"] = replace(depth, number=level.number + depth.number * pecks)
    rest["Q"] = replace(depth, number=-depth.number)
