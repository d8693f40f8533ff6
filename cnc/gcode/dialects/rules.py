"""The rules of a dialect by topic: each record is a table of its file.

The keys of a table are the fields of its record; linuxcnc.toml explains them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

from cnc.gcode.reader.words import G, LineWords
from cnc.model.blocks import PathControl
from cnc.model.choices import WrapRule
from cnc.model.units import decimal_text


@dataclass(frozen=True, slots=True)
class LineRules:
    """Reading of a line: ``[lines]``."""

    bspline: bool
    dollar: bool
    first_bracket: bool
    most_number: int
    program_number: bool
    program_end: bool
    decimal_points: bool
    repeated: str
    same_code_twice: bool
    last_of_group: bool
    both_coolants: bool
    aborts: bool
    one_by_one: bool
    extruder: str


@dataclass(frozen=True, slots=True)
class MotionRules:
    """Modes and words of moves: ``[motion]``."""

    at_start: G | None
    assumed: bool
    after_g80: Literal["none", "previous", "assumed"]
    corners: Literal["", "lines", "rounds", "all"]
    path_stop: PathControl
    path_words: str
    wrap: WrapRule
    polar: Literal["", "ngc", "siemens"]
    cylinder: Literal["", "radius", "mapped", "siemens"]
    direction_words: bool


@dataclass(frozen=True, slots=True)
class FeedRules:
    """F words: ``[feed]``."""

    units_first: bool
    at_start: float
    of_all_axes: bool
    length_units: list[int]


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
class ArcRules:
    """Arcs: ``[arcs]``."""

    turns: bool
    idle_center: bool
    as_grbl: bool
    radius_first: bool
    straight: bool
    mm: ArcTolerance
    inch: ArcTolerance


@dataclass(frozen=True, slots=True)
class OffsetRules:
    """Coordinate systems and transforms: ``[offsets]``."""

    written: list[int]
    current: bool
    add: Literal["no", "yes", "unclear"]
    more_systems: int
    system_word: bool
    basic_system: bool
    shift_stays: bool
    local_shift: bool
    rotation: bool
    transforms: Literal["fanuc", "mach3"]
    scale_unit: float


@dataclass(frozen=True, slots=True)
class HomeRules:
    """Reference positions, machine coordinates and probing: ``[home]``."""

    beside_motion: bool
    directly: bool
    needs_axes: bool
    machine_in_incremental: bool | Literal["unclear"]
    probe_ends_motion: bool


@dataclass(frozen=True, slots=True)
class ToolRules:
    """Lengths and radii of tools: ``[tools]``."""

    length_axes: str
    memory: bool
    unclear: bool
    diameters: bool
    length_in_increments: Literal["left", "added", "unclear"]
    compensation_again: Literal["", "same", "zero"]
    own_offsets: bool
    edges: bool


@dataclass(frozen=True, slots=True)
class SpindleRules:
    """Words of the spindle: ``[spindle]``."""

    stops_after_move: bool
    power: str
    orient_angle: str
    orient_settings: bool


@dataclass(frozen=True, slots=True)
class DwellRules:
    """G4: ``[dwell]``."""

    units: dict[str, float]
    point: dict[str, float]
    turns: str
    short_is_doubtful: bool

    def units_in(self, words: LineWords) -> dict[str, float]:
        """Return the letters that are the time of G4 in a line, with their units.

        A letter that needs a decimal point may be an axis: it is the time if no other word is, and
        G4 the only G-code.
        """
        certain = {letter: unit for letter, unit in self.units.items() if unit}
        if len(words.g) > 1 or not words.rest.keys().isdisjoint(certain):
            return certain
        return self.units

    def line(self, seconds: float) -> str:
        """Return a line that waits for so many seconds, rounded to 0.1 ms."""
        unit = self.units.get("P")
        if not unit:
            return f"G4 F{decimal_text(seconds, 4)}"
        return f"G4 P{decimal_text(seconds, 4)}" if unit == 1.0 else f"G4 P{round(seconds / unit)}"


@dataclass(frozen=True, slots=True)
class CallRules:
    """Calls of subprograms: ``[calls]``."""

    repeats_in_number: bool
    by_sequence: bool
    profiles: bool


@dataclass(frozen=True, slots=True)
class CycleRules:
    """Canned cycles: ``[cycles]``."""

    initial_level: bool | Literal["unclear"]
    hole_patterns: bool
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


@dataclass(frozen=True, slots=True)
class TurningRules:
    """Lathes: ``[turning]``."""

    lathe: bool
    starts_in_zx: bool
    diameters: bool
    increments: str
    integer_unit: float
    least_increments: bool
    tap_side: list[int]
    retract_is_distance: bool
    two_line_cycles: bool
    turret_offsets: Literal["", "P", "L"]


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
        contact: First parameter of the place of contact of G31, besides 5061; 0 for none.
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

    contact: int
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
