"""System parameters: the modal state as a program reads it, such as ``#<_metric>``.

Source: LinuxCNC, "Named Parameters", predefined named parameters. Coordinates and tools bind their
own.
"""

from __future__ import annotations

from collections.abc import Callable

from cnc.gcode.state.modal_groups import PLANES, ModalState
from cnc.gcode.state.source_location import SourceLocation
from cnc.gcode.syntax.code_numbers import G
from cnc.gcode.syntax.parameters import Parameters
from cnc.model.units import per_minute

VERSION = (2.9, 0.0)
"""LinuxCNC's version of the language: #<_vmajor>, #<_vminor>."""

_PLANE_CODES = {plane: float(code) for code, plane in PLANES.items()}


def bind(parameters: Parameters, state: ModalState, here: SourceLocation) -> None:
    """Show the modal state as parameters."""
    readers: dict[str, Callable[[], float]] = {
        "_vmajor": lambda: VERSION[0],
        "_vminor": lambda: VERSION[1],
        "_task": lambda: 0.0,
        "_remap_level": lambda: 0.0,
        "_line": lambda: here.line,
        "_motion_mode": lambda: G.G80 if state.motion is None else state.motion,
        "_plane": lambda: _PLANE_CODES[state.plane],
        "_ccomp": lambda: state.compensation,
        "_metric": lambda: state.scale == 1.0,
        "_imperial": lambda: state.scale != 1.0,
        "_absolute": lambda: state.absolute,
        "_incremental": lambda: not state.absolute,
        "_inverse_time": lambda: state.feed_mode == "inverse-time",
        "_units_per_minute": lambda: state.feed_mode == "per-minute",
        "_units_per_rev": lambda: state.feed_mode == "per-revolution",
        "_retract_r_plane": lambda: not state.initial_level,
        "_retract_old_z": lambda: bool(state.initial_level),
        "_spindle_rpm_mode": lambda: not state.constant_surface,
        "_spindle_css_mode": lambda: state.constant_surface,
        "_ijk_absolute_mode": lambda: state.arc_absolute,
        "_lathe_diameter_mode": lambda: state.diameter,
        "_lathe_radius_mode": lambda: not state.diameter,
        "_spindle_on": lambda: state.spindle != "off",
        "_spindle_cw": lambda: state.spindle == "cw",
        "_mist": lambda: state.mist,
        "_flood": lambda: state.flood,
        "_speed_override": lambda: state.speed_override,
        "_feed_override": lambda: state.feed_override,
        "_adaptive_feed": lambda: state.adaptive_feed,
        "_feed_hold": lambda: state.feed_stop,
        "_feed": lambda: feed_word(state),
        "_rpm": lambda: 0.0 if state.speed is None or state.constant_surface else state.speed,
        "_current_tool": lambda: state.loaded,
        "_selected_tool": lambda: 0 if state.tool is None else state.tool,
    }
    for name, read in readers.items():
        parameters.bind(name, _as_float(read))


def _as_float(read: Callable[[], float]) -> Callable[[], float]:
    return lambda: float(read())


def feed_word(state: ModalState) -> float:
    """Return the F word in effect as it was written."""
    if state.feed is None:
        return 0.0
    return (
        state.feed.rotary if state.feed_mode == "per-revolution" else per_minute(state.feed.rotary)
    )
