"""System variables of FANUC's macros: positions and modal codes as a program reads them, and what
it does by setting one.

Source: FANUC Series 0i, "System variables". Distances are in the units of the program.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from cnc.gcode.codes.system_parameters import feed_word
from cnc.gcode.state.block_buffer import BlockBuffer
from cnc.gcode.state.coordinates import SYSTEM_CODES, Coordinates
from cnc.gcode.state.modal_groups import FEED_MODES, PLANES, ModalState
from cnc.gcode.state.source_location import SourceLocation
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.parameters import Parameters
from cnc.model import parameter_numbers as numbers
from cnc.model.blocks import Stop

_LAST_PLAIN = G.G33
"""Motion codes beyond are cycles, which have a group of their own."""
_PLANE_CODES = {plane: code.code for code, plane in PLANES.items()}
_FEED_CODES = {mode: code.code for code, mode in FEED_MODES.items()}


def bind(
    parameters: Parameters,
    state: ModalState,
    here: SourceLocation,
    coordinates: Coordinates,
    out: BlockBuffer,
    position: Callable[[], list[float]],
) -> None:
    """Show the state, and take what a program does by setting a variable.

    #4001 and on are the codes in effect by FANUC's groups, #4109 F, #4119 S (rpm), #4120 T; #5001
    and on and #5041 and on the position in the coordinate system, #5021 and on that of the machine,
    which ``position`` tells in mm.
    """
    groups: dict[int, Callable[[], float]] = {
        1: lambda: 0.0 if state.motion is None or state.motion > _LAST_PLAIN else state.motion.code,
        2: lambda: _PLANE_CODES[state.plane],
        3: lambda: (G.G90 if state.absolute else G.G91).code,
        5: lambda: _FEED_CODES[state.feed_mode],
        6: lambda: (G.G21 if state.scale == 1.0 else G.G20).code,
        7: lambda: state.compensation.code,
        9: lambda: (
            G.G80.code if state.motion is None or state.motion <= _LAST_PLAIN else state.motion.code
        ),
        10: lambda: (G.G98 if state.initial_level else G.G99).code,
        13: lambda: (G.G96 if state.constant_surface else G.G97).code,
        14: lambda: SYSTEM_CODES[coordinates.system].code,
        109: lambda: feed_word(state),
        119: lambda: 0.0 if state.speed is None or state.constant_surface else state.speed,
        120: lambda: float(state.tool or 0),
    }
    for group, read in groups.items():
        parameters.bind(numbers.MODAL_CODES + group, read)
    coordinates.bind_numbers(numbers.MACHINE_POSITION, position, lambda: state.scale)
    for first in (numbers.BLOCK_END, numbers.CURRENT_POSITION):
        coordinates.bind_numbers(
            first, lambda: coordinates.to_program(position()), lambda: state.scale
        )
    # A program may set these two and read them again; they have no other effect here.
    for number in (numbers.NO_SINGLE_BLOCK, numbers.NO_OVERRIDES):
        kept = [0.0]
        parameters.bind(number, partial(kept.__getitem__, 0), partial(kept.__setitem__, 0))
    parameters.bind(
        numbers.OPERATOR_STOP, lambda: 0.0, lambda _: out.add(Stop(here.file, here.line))
    )
