"""Checks, repairs, pictures and cuts of jobs, in processes that never delay the machine."""

from __future__ import annotations

import base64
import hashlib
import json
import os
import tempfile
import threading
import zlib
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from contextlib import chdir
from dataclasses import asdict, dataclass, replace
from multiprocessing import get_context, parent_process
from pathlib import Path
from typing import Any

import numpy as np

from cnc.editor.analysis import Settings, analysed
from cnc.editor.document import Document
from cnc.gcode.reader.parameters import write_parameters
from cnc.machine.load import with_stock
from cnc.machine.models import Machine
from cnc.model import parameter_numbers as numbers
from cnc.model.blocks import AXIS_LETTERS
from cnc.model.diagnostics import CncError, Diagnostic, UsageError
from cnc.model.operator_control import Control
from cnc.operate.events import Finding
from cnc.report.models import finding_of
from cnc.server.library import Library, Version, version_of
from cnc.server.project import settings_of
from cnc.session.context import Callbacks
from cnc.session.options import Outputs, RunOptions
from cnc.session.program_reader import start_position
from cnc.session.repairs import Place, repaired_at
from cnc.session.session import Session
from cnc.stock.simulation import Material
from cnc.stock.stl import reduced
from cnc.view.sketch import Sketch

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
    """Do nothing: a process that is given this has imported what a check needs."""


def check_job(order: CheckOrder) -> dict[str, Any] | None:
    """Check a job; write its summary and its toolpath into the library; return the summary.

    None, and nothing written, if the text was changed meanwhile: the result is that of another
    program.
    """
    library = Library(order.library)
    file = library.path(order.name)
    text = version_of(file)
    # Findings name the job, not the folder of this computer.
    with chdir(library.folder), tempfile.TemporaryDirectory(prefix="cnc-check-") as folder:
        machine, drawn = order.machine_in(Path(folder)), Path(folder) / "path.json"
        warp = None if order.height_map is None else str(library.height_map_file(order.height_map))
        options = RunOptions(outputs=Outputs(picture=str(drawn)), height_map=warp)
        job = settings_of(file, machine, options)
        report = Session(Path(order.name), machine, job.options).run()
        summary = report.as_json()
        summary["errors"] += [
            finding_of(finding).model_dump(exclude_unset=True) for finding in job.findings
        ]
        if not _is(file, text):
            return None
        library.forget_check(order.name)
        if drawn.exists():
            put(drawn.read_bytes(), library.own(order.name, "path.json"))
        put(json.dumps(summary).encode(), library.own(order.name, "check.json"))
    if not _is(file, text):
        # It was changed while this was written.
        library.forget_check(order.name)
        return None
    return summary


def _is(file: Path, text: Version) -> bool:
    return file.is_file() and version_of(file) == text


def sketch_job(order: CheckOrder) -> bool:
    """Write a coarse picture of a job into the library; return whether its program can be read."""
    library = Library(order.library)
    with chdir(library.folder), tempfile.TemporaryDirectory(prefix="cnc-sketch-") as folder:
        machine, file = order.machine_in(Path(folder)), library.path(order.name)
        options = replace(settings_of(file, machine).options, tool_lengths="zero")
        session = Session(file, machine, options)
        sketch = Sketch(machine, order.name, start_position(machine))
        try:
            for block in session.blocks():
                sketch.add(block)
        except CncError:
            # The check reports the fault.
            return False
    put(sketch.data().encode(), library.own(order.name, "sketch.json"))
    return True


def parameters_of(
    offsets: Mapping[str, Mapping[str, float]], rotations: Mapping[str, float]
) -> dict[int, float]:
    """Return the parameters of offsets by name and axis, mm, and of rotations, degrees."""
    values: dict[int, float] = {}
    for name, place in offsets.items():
        first = numbers.SHIFT if name == "G92" else numbers.origin(numbers.SYSTEMS.index(name))
        for letter, value in place.items():
            values[first + AXIS_LETTERS.index(letter)] = value
    if any(offsets.get("G92", {}).values()):
        values[numbers.SHIFT_IN_EFFECT] = 1.0
    for name, angle in rotations.items():
        values[numbers.origin(numbers.SYSTEMS.index(name)) + numbers.ROTATION] = angle
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


# Repairs of findings, in the process of the checks.

MOST_CHANGED = 200
"""Changed lines of a repair that a page shows."""


@dataclass(frozen=True, slots=True)
class RepairOrder:
    """A repair to show, or to write.

    Attributes:
        check: The job and the machine.
        place: Code, line and column of the finding.
        version: The text that was shown; None to show the repair only.
        unsafe: Whether it may change what the program does.
        draft: File that takes the repaired text; None to show the repair only.
    """

    check: CheckOrder
    place: Place
    version: str | None = None
    unsafe: bool = False
    draft: Path | None = None


def repair_job(order: RepairOrder) -> dict[str, Any]:
    """Prove the repair of a finding; return it, and write the new text into the draft.

    Returns:
        ``title``, ``safe``, ``lines`` (``line``, ``old``, ``new``; the first of ``count``), and
        ``version``: the text that was read.

    Raises:
        UsageError: ``no-such-job``, ``job-changed``, ``no-repair``, ``repair-unsafe``.
    """
    name, (code, line, _) = order.check.name, order.place
    file = Library(order.check.library).path(name)
    text = file.read_bytes()
    version = hashlib.sha256(text).hexdigest()
    if order.version not in (None, version):
        raise job_changed(name)
    with chdir(file.parent), tempfile.TemporaryDirectory(prefix="cnc-repair-") as folder:
        machine = order.check.machine_in(Path(folder))
        result = repaired_at(name, text, machine, settings_of(file, machine).options, order.place)
    if not result.applied:
        message = f"line {line} of {name} has no repair of {code} that can be proved"
        raise UsageError(Diagnostic("no-repair", message, hint="check it again, or change it"))
    finding, lines = result.applied[0]
    assert finding.fix is not None
    if order.draft is not None:
        if not (finding.fix.safe or order.unsafe):
            message = f"the repair of line {line} may change what {name} does: {finding.fix.title}"
            hint = 'read the changed lines, then send "unsafe": true'
            raise UsageError(Diagnostic("repair-unsafe", message, hint=hint))
        order.draft.write_bytes(result.new)
        order.draft.chmod(file.stat().st_mode)
    return {
        "title": finding.fix.title,
        "safe": finding.fix.safe,
        "lines": [changed._asdict() for changed in lines[:MOST_CHANGED]],
        "count": len(lines),
        "version": version,
    }


def job_changed(name: str) -> UsageError:
    """Return the refusal of a change of a text that is no longer the one that was shown."""
    message = f"{name} has changed since it was shown"
    return UsageError(Diagnostic("job-changed", message, hint="look at the new text first"))


# Findings of a text as it is typed, in the process of the coarse pictures.

LONGEST_READING = 10.0
"""Time after which the reading of a text that is typed ends, s."""


def typed_findings(order: CheckOrder, text: str) -> list[dict[str, Any]]:
    """Return the findings of a text that stands in no file yet, as those of a check."""
    with chdir(order.library), tempfile.TemporaryDirectory(prefix="cnc-typed-") as folder:
        machine, control = order.machine_in(Path(folder)), Control()
        timer = threading.Timer(LONGEST_READING, control.stop)
        timer.start()
        try:
            job = settings_of(order.library / order.name, machine)
            settings = Settings(machine, job.options)
            typed = analysed(Document.of(order.name, text), settings, control).findings
            findings = [*typed, *job.findings]
        except CncError as error:
            findings = [error.diagnostic]
        finally:
            timer.cancel()
    return [asdict(Finding.of(finding)) for finding in findings]


# Simulated cuts of jobs, in the process of the checks.

MOST_CORNERS = 160_000
"""Corners of the surface that a page draws."""
LEVELS = 65535
"""Number of steps of the heights between the lowest and the highest place of the stock."""
CODES = frozenset(
    {
        "rapid-into-stock",
        "shank-into-stock",
        "holder-into-stock",
        "cut-below-stock",
        "stock-turned",
        "tool-shape-assumed",
    }
)
"""Findings of the simulation."""


@dataclass(frozen=True, slots=True)
class CutOrder:
    """A cut to simulate.

    Attributes:
        check: The job and the machine.
        stock: The raw part, such as ``X0:100,Y0:60,Z-12:0``; empty for that of the machine file.
        resolution: Width of a cell, mm; None for the default.
        zero: Machine position of the zero of the raw part's coordinates by axis, mm.
    """

    check: CheckOrder
    stock: str
    resolution: float | None
    zero: Mapping[str, float]


def cut_job(order: CutOrder) -> dict[str, Any]:
    """Simulate the cut of a job; write the part and its STL file into the library.

    Returns:
        The part, see :func:`part_of`; ``ok`` is false if the program is refused.
    """
    library, name = Library(order.check.library), order.check.name
    library.path(name)
    materials: list[Material] = []
    with chdir(library.folder), tempfile.TemporaryDirectory(prefix="cnc-cut-") as folder:
        machine = order.check.machine_in(Path(folder))
        job = settings_of(library.folder / name, machine)
        if order.stock:
            machine = with_stock(machine, order.stock, order.zero)
        stl = Path(folder) / "part.stl"
        report = Session(
            Path(name),
            machine,
            replace(job.options, outputs=Outputs(stl=str(stl)), stock_resolution=order.resolution),
            callbacks=Callbacks(on_cut=materials.append),
        ).run()
        summary = report.as_json()
        findings = [error for error in summary["errors"] if error["code"] in CODES]
        part: dict[str, Any] = {"ok": report.ok, "findings": findings or summary["errors"]}
        if report.ok and materials:
            part = {"ok": True, "findings": findings} | part_of(materials[0]) | summary["stock"]
            put(stl.read_bytes(), library.own(name, "stl"))
            put(json.dumps(part).encode(), library.own(name, "part.json"))
    return part


def part_of(material: Material) -> dict[str, Any]:
    """Return the surface of the part for a page.

    Returns:
        ``box`` ([low, high] of x, y, z in mm), ``x`` and ``y`` ([first, last] corner in mm),
        ``nx``, ``ny``, and ``heights``: (nx, ny) 16-bit numbers from the lowest (0) to the highest
        place, deflated and in base 64.
    """
    x, y, z = reduced(material, MOST_CORNERS)
    low, high = float(material.low[2]), float(material.high[2])
    scaled = np.round((z - low) / (high - low) * LEVELS).astype("<u2")
    return {
        "box": np.stack((material.low, material.high), axis=1).tolist(),
        "x": [float(x[0]), float(x[-1])],
        "y": [float(y[0]), float(y[-1])],
        "nx": len(x),
        "ny": len(y),
        "heights": base64.b64encode(zlib.compress(scaled.tobytes(), 6)).decode(),
    }
