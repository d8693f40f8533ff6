"""System variables of FANUC's macros: positions, modal codes and stops.

Distances are in the units of the program. Source: FANUC Series 0i, "System variables".
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from cnc.gcode.codes.system_parameters import feed_word
from cnc.gcode.state.block_buffer import BlockBuffer
from cnc.gcode.state.coordinates import SYSTEM_CODES, Coordinates
from cnc.gcode.state.modal_groups import FEED_MODES, PLANES, ModalState
from cnc.gcode.state.position_parameters import bind_numbers
from cnc.gcode.state.source_location import SourceLocation
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.parameters import Parameters
from cnc.model import parameter_numbers as numbers
from cnc.model.blocks import Stop

_LAST_PLAIN = G.G33
"""Higher motion codes are cycles, which are a group of their own."""
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
    """Show the state as variables, and act on the variables that a program sets.

    #4001 to #4014 are the codes in effect by FANUC's groups, #4109 is F, #4119 S (rpm) and #4120 T.
    #5001 and #5041 are the first of the position in the coordinate system, #5021 of the machine
    position.

    Args:
        parameters: The parameters of the program.
        state: The modal state.
        here: Place of the current line.
        coordinates: The coordinate systems.
        out: Receives the stops.
        position: Returns the machine position in mm.
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
    bind_numbers(coordinates, numbers.MACHINE_POSITION, position, lambda: state.scale)
    for first in (numbers.BLOCK_END, numbers.CURRENT_POSITION):
        bind_numbers(
            coordinates, first, lambda: coordinates.to_program(position()), lambda: state.scale
        )
    # A program may set these two and read them again; they have no other effect here.
    for number in (numbers.NO_SINGLE_BLOCK, numbers.NO_OVERRIDES):
        kept = [0.0]
        parameters.bind(number, partial(kept.__getitem__, 0), partial(kept.__setitem__, 0))
    parameters.bind(
        numbers.OPERATOR_STOP, lambda: 0.0, lambda _: out.add(Stop(here.file, here.line))
    )
