"""System variables of FANUC's macros: positions, modal codes and stops.

Distances are in the units of the program. Source: FANUC Series 0i, "System variables".
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from cnc.gcode.core.context import Context
from cnc.gcode.core.coordinates import SYSTEM_CODES, bind_numbers
from cnc.gcode.core.modal_groups import FEED_MODES, PLANES, ModalState
from cnc.gcode.reader.words import G, Word, fault
from cnc.model import parameter_numbers as numbers
from cnc.model.blocks import Stop
from cnc.model.units import per_minute

# System parameters: the modal state as a program reads it, such as ``#<_metric>``.
#
# Source: LinuxCNC, "Named Parameters", predefined named parameters. Coordinates and tools bind
# their own.

VERSION = (2.9, 0.0)
"""LinuxCNC's version of the language: #<_vmajor>, #<_vminor>."""

_PLANE_OF_CODE = {plane: float(code) for code, plane in PLANES.items()}


ReadState = Callable[[ModalState], float]
"""Returns a number of the modal state."""


def bind_system_parameters(context: Context) -> None:
    """Show the modal state as parameters."""
    here = context.here
    readers: dict[str, ReadState] = {
        "_vmajor": lambda state: VERSION[0],
        "_vminor": lambda state: VERSION[1],
        "_task": lambda state: 0.0,
        "_remap_level": lambda state: 0.0,
        "_line": lambda state: here.line,
        "_motion_mode": lambda state: G.G80 if state.motion is None else state.motion,
        "_plane": lambda state: _PLANE_OF_CODE[state.plane],
        "_ccomp": lambda state: state.compensation,
        "_metric": lambda state: state.scale == 1.0,
        "_imperial": lambda state: state.scale != 1.0,
        "_absolute": lambda state: state.absolute,
        "_incremental": lambda state: not state.absolute,
        "_inverse_time": lambda state: state.feed_mode == "inverse-time",
        "_units_per_minute": lambda state: state.feed_mode == "per-minute",
        "_units_per_rev": lambda state: state.feed_mode == "per-revolution",
        "_retract_r_plane": lambda state: not state.initial_level,
        "_retract_old_z": lambda state: bool(state.initial_level),
        "_spindle_rpm_mode": lambda state: not state.constant_surface,
        "_spindle_css_mode": lambda state: state.constant_surface,
        "_ijk_absolute_mode": lambda state: state.arc_absolute,
        "_lathe_diameter_mode": lambda state: state.diameter,
        "_lathe_radius_mode": lambda state: not state.diameter,
        "_spindle_on": lambda state: state.spindle != "off",
        "_spindle_cw": lambda state: state.spindle == "cw",
        "_mist": lambda state: state.mist,
        "_flood": lambda state: state.flood,
        "_speed_override": lambda state: state.speed_override,
        "_feed_override": lambda state: state.feed_override,
        "_adaptive_feed": lambda state: state.adaptive_feed,
        "_feed_hold": lambda state: state.feed_stop,
        "_feed": feed_word,
        "_rpm": lambda state: 0.0 if state.speed is None or state.constant_surface else state.speed,
        "_current_tool": lambda state: state.loaded,
        "_selected_tool": lambda state: 0 if state.tool is None else state.tool,
    }
    for name, read in readers.items():
        context.parameters.bind(name, _reader(context, read))


def _reader(context: Context, read: ReadState) -> Callable[[], float]:
    return lambda: float(read(context.state))


def feed_word(state: ModalState) -> float:
    """Return the F word in effect as it was written."""
    if state.feed is None:
        return 0.0
    return (
        state.feed.rotary if state.feed_mode == "per-revolution" else per_minute(state.feed.rotary)
    )


_LAST_PLAIN = G.G34
"""Higher motion codes are cycles, which are a group of their own."""
_PLANE_CODES = {plane: code.code for code, plane in PLANES.items()}
_FEED_CODES = {mode: code.code for code, mode in FEED_MODES.items()}


def bind_macro_variables(context: Context, position: Callable[[], list[float]]) -> None:
    """Show the state as variables, and act on the variables that a program sets.

    #4001 to #4014 are the codes in effect by FANUC's groups, #4109 is F, #4119 S (rpm) and #4120 T.
    #5001 and #5041 are the first of the position in the coordinate system, #5021 of the machine
    position.

    Args:
        context: The parameters, and what they show.
        position: Returns the machine position in mm.
    """
    parameters, coordinates = context.parameters, context.coordinates
    out, here = context.out, context.here
    groups: dict[int, ReadState] = {
        1: lambda state: (
            0.0 if state.motion is None or state.motion > _LAST_PLAIN else state.motion.code
        ),
        2: lambda state: _PLANE_CODES[state.plane],
        3: lambda state: (G.G90 if state.absolute else G.G91).code,
        5: lambda state: _FEED_CODES[state.feed_mode],
        6: lambda state: (G.G21 if state.scale == 1.0 else G.G20).code,
        7: lambda state: state.compensation.code,
        9: lambda state: (
            G.G80.code if state.motion is None or state.motion <= _LAST_PLAIN else state.motion.code
        ),
        10: lambda state: (G.G98 if state.initial_level else G.G99).code,
        13: lambda state: (G.G96 if state.constant_surface else G.G97).code,
        14: lambda state: SYSTEM_CODES[coordinates.system].code,
        109: feed_word,
        119: lambda state: 0.0 if state.speed is None or state.constant_surface else state.speed,
        120: lambda state: float(state.tool or 0),
    }
    for group, read in groups.items():
        parameters.bind(numbers.MODAL_CODES + group, _reader(context, read))

    def scale() -> float:
        return context.state.scale

    bind_numbers(coordinates, numbers.MACHINE_POSITION, position, scale)
    for first in (numbers.BLOCK_END, numbers.CURRENT_POSITION):
        bind_numbers(
            coordinates,
            first,
            lambda: coordinates.to_program(position()),
            scale,
        )
    # A program may set these two and read them again; they have no other effect here.
    for number in (numbers.NO_SINGLE_BLOCK, numbers.NO_OVERRIDES):
        kept = [0.0]
        parameters.bind(number, partial(kept.__getitem__, 0), partial(kept.__setitem__, 0))
    parameters.bind(
        numbers.OPERATOR_STOP, lambda: 0.0, lambda _: out.add(Stop(here.file, here.line))
    )


# Macro variables that only a control knows: timers, counts of parts, inputs, data of tool life.
#
# A check takes them as 0 until the program sets them, with one warning a variable. A run refuses
# them. Which numbers they have is data of the dialect.


def bind_control_variables(context: Context) -> None:
    """Bind the variables to the parameters of a program."""
    kept: dict[int, float] = {}
    for first, last in context.dialect.variables.control:
        _bind(context, range(first, last + 1), kept)


def _bind(context: Context, row: range, kept: dict[int, float]) -> None:
    def read(place: int) -> float:
        number = row[place]
        if number not in kept:
            _report(context, number)
            kept[number] = 0.0
        return kept[number]

    def write(place: int, value: float) -> None:
        if row[place] not in kept:
            _report(context, row[place])
        kept[row[place]] = value

    context.parameters.bind_row(row, read, write)


def _report(context: Context, number: int) -> None:
    """Refuse a variable, or report it where a check goes on."""
    here = context.here
    written = f"#{number}"
    place = here.text.find(written)
    length = len(written) if place >= 0 else len(here.text)
    at = Word("#", float(number), written, max(place, 0) + 1, length)
    message = f"#{number} belongs to the control: a timer, a count, an input or an output"
    if context.policy.missing_programs == "error":
        raise fault("parameter-number", message, at, "a run needs a program without it")
    here.report_warning(
        "control-variable",
        f"{message}; it is 0 here until the program sets it",
        at,
        "a run refuses it",
    )
