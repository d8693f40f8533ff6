"""Simulated cuts of jobs, in the process of the checks."""

from __future__ import annotations

import base64
import json
import tempfile
import zlib
from collections.abc import Mapping
from contextlib import chdir
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cnc.machine.stock import with_stock
from cnc.server.checking import CheckOrder, put
from cnc.server.library import Library
from cnc.stock.material import Material

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
    from cnc.session.observer import Callbacks
    from cnc.session.options import Outputs, RunOptions
    from cnc.session.session import Session

    library, name = Library(order.check.library), order.check.name
    library.path(name)
    materials: list[Material] = []
    with chdir(library.folder), tempfile.TemporaryDirectory(prefix="cnc-cut-") as folder:
        machine = order.check.machine_in(Path(folder))
        if order.stock:
            machine = with_stock(machine, order.stock, order.zero)
        stl = Path(folder) / "part.stl"
        report = Session(
            Path(name),
            machine,
            RunOptions(outputs=Outputs(stl=str(stl)), stock_resolution=order.resolution),
            callbacks=Callbacks(on_cut=materials.append),
        ).run()
        summary = report.as_json()
        found = [each for each in summary["errors"] if each["code"] in CODES]
        part: dict[str, Any] = {"ok": report.ok, "findings": found or summary["errors"]}
        if report.ok and materials:
            part = {"ok": True, "findings": found} | part_of(materials[0]) | summary["stock"]
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
    from cnc.stock.stl import reduced

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
