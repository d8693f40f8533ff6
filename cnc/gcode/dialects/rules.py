"""Parts of the rules of a dialect: arcs, cycles, codes without effect, numbers of variables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

from cnc.gcode.reader.words import LineWords


@dataclass(frozen=True, slots=True)
class ArcTolerance:
    """Tolerances of arcs.

    In centre format the radii at both ends may differ by ``slack``, or by ``relative`` times the
    larger one, but never by more than ``limit``.

    Attributes:
        slack: Allowed difference of the radii, mm.
        relative: Allowed difference of the radii, as a fraction of the larger one.
        limit: Largest difference of the radii, mm.
        reach: In R format, allowed difference of half the chord and the radius, mm.
    """

    slack: float
    relative: float
    limit: float
    reach: float


@dataclass(frozen=True, slots=True)
class CycleRules:
    """Differences of dialects in canned cycles.

    Attributes:
        repeats: Letters of the number of repeats.
        plane_and_depth: Whether Z is the level R, I the bottom, and K the dwell, as on Fagor.
        no_hole: Whether 0 repeats only store the words of the cycle.
        turns: Whether words of rotary axes turn them before each hole.
        retract_optional: Whether the hole begins at the level of the position without R.
        pecks_shrink: Whether pecks have I, J and K: the first, its decrease, the smallest.
        words_stay: Whether R, depth, P and Q stay in effect for another cycle.
        dwell_needed: Whether P must be given.
        peck_dwell: Whether P of G73 and G83 is a dwell at the bottom.
        idle_dwell: Whether P of a cycle without a dwell has no effect, and stays for a later one.
        clearance: Retraction of G73, and distance of G83 from the bottom, mm.
        feed_out_to: Height to which G74, G84 and G89 retract at feed.
        tap_dwell: Dwell once after the spindle was reversed, or before each reversal.
        fine_boring: Whether G76 is fine boring, and not a thread.
        heights: R and depth of a line under the other one of G90 and G91; see linuxcnc.toml.
        starts_spindle: Whether G74 and G84 start the spindle themselves, at the speed of S; with
            a warning if "unclear".
    """

    repeats: str
    plane_and_depth: bool
    no_hole: bool
    turns: bool
    retract_optional: bool
    pecks_shrink: bool
    words_stay: bool
    dwell_needed: bool
    peck_dwell: bool
    idle_dwell: bool
    clearance: float
    feed_out_to: Literal["clear", "retract"]
    tap_dwell: Literal["after", "before-each"]
    fine_boring: bool
    heights: Literal["kept", "line", "unclear"]
    starts_spindle: bool | Literal["unclear"]


class NotedCode(NamedTuple):
    """A code of the controller that has no effect here.

    Attributes:
        name: The function of the code on its controller.
        words: Letters of the words that belong to it.
        needs: Letters of which one must stand in the line; empty for a code that needs none. Such
            a code is distinguished by its words from one with the same number.
        unchecked: Whether the control does something of its own, such as the letters of a text. A
            check goes on without it, and a run refuses the code.
    """

    name: str
    words: str
    needs: str
    unchecked: bool

    def applies(self, words: LineWords) -> bool:
        """Return whether a line with this code has the words that it needs."""
        rest = words.rest.keys()
        return not self.needs or (not rest.isdisjoint(self.needs) and rest <= set(self.words))


class Alias(NamedTuple):
    """Another number for a code, such as G71 for G21.

    Attributes:
        code: The number of the code that is meant.
        word: Letter and number of a word that belongs to it; empty for none.
        without: Letters of words that give the number another meaning.
    """

    code: float
    word: str
    without: str


class VariableNumbers(NamedTuple):
    """Numbers of the macro variables that differ between controllers.

    Each row of an offset is the variable of offset 1, and the number of offsets.

    Attributes:
        length: Geometry of the lengths (H).
        wear: Wear of the lengths.
        radius: Geometry of the radii (D), or of the diameters.
        radius_wear: Wear of the radii, or of the diameters.
        wear_is_length: Variables of the wear that hold the whole length on controls with another
            memory: first and last; empty for none.
        origins: First axis of the external offset; G54 to G59 follow it, and the next axis 100
            later. 0 for none.
        more_origins: Origin of G54.1 P1 by a second number; 0 for none.
        common: First and last of more common variables; empty for none. Those of them that are
            10000 more than a common variable are the same one.
        control: Variables whose value only the control knows: first and last of each group.
    """

    length: list[list[int]]
    wear: list[list[int]]
    radius: list[list[int]]
    radius_wear: list[list[int]]
    wear_is_length: list[list[int]]
    origins: int
    more_origins: int
    common: list[int]
    control: list[list[int]]


# Codes that a typing error may have turned into another one.


def near(written: str, legal: frozenset[float]) -> list[str]:
    """Return codes that a typing error may have turned into the one written.

    The errors are a missing point, another digit after it, a digit too many, two digits swapped.
    """
    before, point, _ = written.lstrip("0").partition(".")
    places = range(1, len(before))
    if point:
        slips = [before, *(f"{before}.{digit}" for digit in range(1, 6))]
    else:
        slips = [f"{before[:at]}.{before[at:]}" for at in places if before[at:].strip("0")]
        slips += [before[:at] + before[at + 1 :] for at in places]
        slips += [
            before[: at - 1] + before[at] + before[at - 1] + before[at + 1 :] for at in places
        ]
    numbers = dict.fromkeys(float(slip) for slip in slips if slip)
    return [f"{number:g}" for number in numbers if number in legal][:3]
