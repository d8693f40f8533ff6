"""Checks of jobs in a process of its own, so that they never delay the machine."""

from __future__ import annotations

import json
import os
import tempfile
import threading
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from contextlib import chdir
from dataclasses import dataclass
from multiprocessing import get_context, parent_process
from pathlib import Path
from typing import Any

from cnc.gcode.syntax.parameter_file import write_parameters
from cnc.machine.models import Machine
from cnc.model import parameter_numbers as numbers
from cnc.model.blocks import AXIS_LETTERS
from cnc.model.diagnostics import CncError
from cnc.server.library import Library

NICENESS = 10
"""The priority of a check is lower than that of the machine by this."""


@dataclass(frozen=True, slots=True)
class CheckOrder:
    """A check to carry out.

    Attributes:
        name: Name of the job.
        library: Folder of the library.
        machine: The machine, with the travel of the board.
        parameters: Parameters by number, such as the offsets of the board.
        height_map: Name of the height map that warps the job; None for none.
    """

    name: str
    library: Path
    machine: Machine
    parameters: Mapping[int, float]
    height_map: str | None = None

    def machine_in(self, folder: Path) -> Machine:
        """Return the machine with the parameters, which are written into ``folder``."""
        if not self.parameters:
            return self.machine
        file = folder / "parameters.var"
        write_parameters(file, self.parameters)
        program = self.machine.program.model_copy(update={"parameters": file})
        return self.machine.model_copy(update={"program": program})


class Checker:
    """Carries out checks, one after the other, and beside them coarse pictures.

    Attributes:
        pool: The process of the checks.
        sketches: The process of the coarse pictures: none waits for the check of another job.
    """

    def __init__(self) -> None:
        self.pool, self.sketches = _process(), _process()

    def close(self) -> None:
        """End the processes, with what they carry out."""
        for pool in (self.pool, self.sketches):
            workers = list((pool._processes or {}).values())
            pool.shutdown(wait=False, cancel_futures=True)
            for worker in workers:
                worker.terminate()


def _process() -> ProcessPoolExecutor:
    """Return a pool of one process, which begins with its first task."""
    return ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=_begin_worker)


def prepare() -> None:
    """Import what a check needs, so that the first one begins at once."""
    import cnc.session.session
    import cnc.view.sketch  # noqa: F401


def check_job(order: CheckOrder) -> dict[str, Any]:
    """Check a job; write its summary and its toolpath into the library; return the summary."""
    from cnc.session.options import Outputs, RunOptions
    from cnc.session.session import Session

    library = Library(order.library)
    library.path(order.name)
    # Findings name the job, not the folder of this computer.
    with chdir(library.folder), tempfile.TemporaryDirectory(prefix="cnc-check-") as folder:
        machine, drawn = order.machine_in(Path(folder)), Path(folder) / "path.json"
        warp = None if order.height_map is None else str(library.height_map_file(order.height_map))
        options = RunOptions(outputs=Outputs(picture=str(drawn)), height_map=warp)
        report = Session(Path(order.name), machine, options).run()
        summary = report.as_json()
        library.forget_check(order.name)
        if drawn.exists():
            put(drawn.read_bytes(), library.own(order.name, "path.json"))
        put(json.dumps(summary).encode(), library.own(order.name, "check.json"))
    return summary


def sketch_job(order: CheckOrder) -> bool:
    """Write a coarse picture of a job into the library; return whether its program can be read."""
    from cnc.session.options import RunOptions
    from cnc.session.program_reader import start_position
    from cnc.session.session import Session
    from cnc.view.sketch import Sketch

    library = Library(order.library)
    with chdir(library.folder), tempfile.TemporaryDirectory(prefix="cnc-sketch-") as folder:
        machine = order.machine_in(Path(folder))
        session = Session(library.path(order.name), machine, RunOptions(tool_lengths="zero"))
        sketch = Sketch(machine, order.name, start_position(machine))
        try:
            for block in session.blocks():
                sketch.add(block)
        except CncError:
            # The check reports the fault.
            return False
    put(sketch.data().encode(), library.own(order.name, "sketch.json"))
    return True


def parameters_of(offsets: Mapping[str, Mapping[str, float]]) -> dict[int, float]:
    """Return the parameters of offsets by name and axis, mm."""
    values: dict[int, float] = {}
    for name, place in offsets.items():
        first = numbers.SHIFT if name == "G92" else numbers.origin(numbers.SYSTEMS.index(name))
        for letter, value in place.items():
            values[first + AXIS_LETTERS.index(letter)] = value
    if any(offsets.get("G92", {}).values()):
        values[numbers.SHIFT_IN_EFFECT] = 1.0
    return values


def put(data: bytes, target: Path) -> None:
    """Replace a file as a whole."""
    draft = target.with_name(f"{target.name}.part")
    draft.write_bytes(data)
    os.replace(draft, target)


def _begin_worker() -> None:
    """Lower the priority of the process, and let it end with the server."""
    if hasattr(os, "nice"):
        os.nice(NICENESS)
    threading.Thread(target=_end_with_server, daemon=True).start()


def _end_with_server() -> None:
    server = parent_process()
    if server is not None:
        server.join()
        os._exit(1)
