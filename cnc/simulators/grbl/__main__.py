"""Serve the GRBL simulator at a pseudo-terminal, until it is interrupted or unplugged."""

from __future__ import annotations

import argparse
import os
import sys

from cnc.simulators.grbl.core import setting_text
from cnc.simulators.grbl.firmware_profile import FIRMWARES
from cnc.simulators.grbl.grbl_simulator import GrblSimulator, ScheduledFault, parse_fault
from cnc.simulators.grbl.ports import PtyServer

LARGEST_SETTING = 65535


def setting(text: str) -> tuple[int, float]:
    """Return number and value of ``110=5000``."""
    number, _, value = text.removeprefix("$").partition("=")
    if not 0 <= int(number) <= LARGEST_SETTING:
        raise ValueError(number)
    return int(number), float(value)


def fault(text: str) -> ScheduledFault:
    """Return a fault, see :func:`cnc.simulators.grbl.grbl_simulator.parse_fault`."""
    try:
        return parse_fault(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def main(arguments: list[str] | None = None) -> int:
    """Serve the simulator, and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m cnc.simulators.grbl", description=__doc__)
    parser.add_argument(
        "--flavour", choices=FIRMWARES, default="grbl", help="the firmware to simulate"
    )
    parser.add_argument(
        "--axes",
        choices=("XYZ", "XYZA", "XYZAB", "XYZABC"),
        default="XYZ",
        help="the axes of the board; GRBL itself has three",
    )
    parser.add_argument(
        "--factor", type=float, default=1.0, help="speed of its clock relative to real time"
    )
    parser.add_argument(
        "--setting",
        type=setting,
        action="append",
        default=[],
        metavar="N=VALUE",
        help="a $ setting; may be repeated",
    )
    parser.add_argument(
        "--fault",
        type=fault,
        action="append",
        default=[],
        metavar="KIND[:N][@byte|line|time:N]",
        help="a fault; may be repeated",
    )
    chosen = parser.parse_args(arguments)
    if not chosen.factor > 0.0:
        parser.error("--factor must be greater than 0")
    if not hasattr(os, "openpty"):
        parser.error("this system has no pseudo-terminals")
    profile = FIRMWARES[chosen.flavour]
    if profile.name == "grbl" and chosen.axes != "XYZ":
        parser.error("GRBL has three axes; for more choose --flavour grblhal")
    profile = profile.with_axes(chosen.axes)
    unknown = [number for number, _ in chosen.setting if number not in profile.settings]
    if unknown:
        parser.error(f"this firmware has no setting ${unknown[0]}")
    simulator = GrblSimulator(profile, settings=dict(chosen.setting))
    for scheduled in chosen.fault:
        simulator.inject(
            scheduled.fault, byte=scheduled.byte, line=scheduled.line, time=scheduled.time
        )
    with PtyServer(simulator, chosen.factor) as server:
        changed = ", ".join(setting_text(number, value) for number, value in chosen.setting)
        settings = f" with {changed}" if changed else ""
        return server.serve(f"a simulated {chosen.flavour} board at {server.name}{settings}")


if __name__ == "__main__":
    sys.exit(main())
