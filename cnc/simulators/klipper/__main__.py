"""Serve the Klipper simulator at a pseudo-terminal, until it is interrupted."""

from __future__ import annotations

import argparse
import os
import sys

from cnc.boards.klipper.firmware import FIRMWARES
from cnc.machine.load import load_machine
from cnc.simulators.klipper.ends import add_ends
from cnc.simulators.klipper.klipper_simulator import KlipperSimulator
from cnc.simulators.klipper.ports import PtyServer, simulator_for, with_pins


def main(arguments: list[str] | None = None) -> int:
    """Serve the simulator, and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m cnc.simulators.klipper", description=__doc__)
    parser.add_argument("--mcu", choices=FIRMWARES, help="the microcontroller to simulate")
    parser.add_argument(
        "--machine", help="the machine file whose microcontroller and switches are simulated"
    )
    chosen = parser.parse_args(arguments)
    if not hasattr(os, "openpty"):
        parser.error("this system has no pseudo-terminals")
    if chosen.mcu is not None:
        simulator = KlipperSimulator(FIRMWARES[chosen.mcu])
    else:
        machine = with_pins(load_machine(chosen.machine))
        simulator = simulator_for(machine)
        add_ends(simulator, machine)
    with PtyServer(simulator) as server:
        return server.serve(f"a simulated {simulator.firmware.mcu} at {server.name}")


if __name__ == "__main__":
    sys.exit(main())
