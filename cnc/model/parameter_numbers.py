"""Numbers of the parameters that show or keep the state of the machine.

Where a number is the first of a place, the axes X Y Z A B C U V W follow from it in turn. Sources:
LinuxCNC, "Numbered Parameters"; for the external offset, G54.1 and the system variables FANUC
Series 0i, "System variables".
"""

from __future__ import annotations

AXES_PER_PLACE = 9

# Kept between programs.

G28_POSITION = 5161
G30_POSITION = 5181
EXTERNAL_OFFSET = 5201
"""FANUC's offset of all coordinate systems."""
SHIFT_IN_EFFECT = 5210
"""1 while the shift of G92 is in effect, else 0."""
SHIFT = 5211
"""The shift of G92."""
CURRENT_SYSTEM = 5220
"""The coordinate system in use, 1 for G54."""
G54_ORIGIN = 5221
G54_1_ORIGIN = 7001
"""The origin of FANUC's G54.1 P1."""
SYSTEMS = ("G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3")
"""Names of the coordinate systems, in the order of their origins."""
SYSTEM_STEP = 20
"""From the origin of a coordinate system to the next one's."""
ROTATION = 9
"""From the origin of a coordinate system to its rotation about Z, in degrees."""
MOST_G54_1_SYSTEMS = 48

# Answers of the board.

PROBE_POSITION = 5061
"""Position of the last contact of a probe."""
PROBE_CONTACT = 5070
"""1 where the last probing move made contact, else 0."""
INPUT_VALUE = 5399
"""Result of M66."""

# Shown to programs.

CURRENT_TOOL = 5400
"""Number and data of the tool in the spindle."""
POSITION = 5420
"""Position in the coordinate system in use."""

# System variables of FANUC's macros.

ALARM = 3000
"""A program that sets it stops with an alarm."""
NO_SINGLE_BLOCK = 3003
NO_OVERRIDES = 3004
OPERATOR_STOP = 3006
"""A program that sets it to 1 waits for the operator."""
MODAL_CODES = 4000
"""The code in effect of FANUC's group n is this number + n."""
BLOCK_END = 5001
"""Position at the end of the last block in the coordinate system in use."""
MACHINE_POSITION = 5021
CURRENT_POSITION = 5041


def place(first: int) -> range:
    """The parameters of a place for all axes."""
    return range(first, first + AXES_PER_PLACE)


def origin(system: int) -> int:
    """The first parameter of G54 (0) to G59.3 (8)."""
    return G54_ORIGIN + SYSTEM_STEP * system
