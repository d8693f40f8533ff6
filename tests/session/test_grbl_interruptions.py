"""The line to continue at after an interrupted run on a GRBL board is never ahead of the motion."""

from __future__ import annotations

import random
from bisect import bisect_left
from pathlib import Path

import pytest

from cnc.api import Callbacks, Control
from cnc.session.checkpoint import Checkpoint
from cnc.session.run_pulses import Progress
from cnc.simulators.grbl.grbl_simulator import Alarm, Error, GrblSimulator, Unplug
from tests.support.session.position_runs import FAST, ran
from tests.support.soak import share

pytestmark = pytest.mark.usefixtures("nothing_kept")
KINDS = ("stop", "unplug", "error", "alarm", "power")
FIRST = 5
"""Line of the first move along X."""


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(share(40, 2)))
def test_no_material_is_skipped(kind: str, seed: int, tmp_path: Path) -> None:
    rng = random.Random(f"{kind} {seed}")
    ends = [0.0]
    for _ in range(rng.randint(10, 120)):
        ends.append(round(ends[-1] + rng.choice([0.05, 0.3, 1.0, 3.0]) * rng.uniform(0.5, 1.5), 3))
    moves = [
        f"G1 X{x:.3f} Y{rng.uniform(0.0, 1.0):.2f} F{rng.choice([300, 1200, 3000])}"
        for x in ends[1:]
    ]
    program = tmp_path / "p.nc"
    head = ["G21 G90", "M3 S500", "G0 Z3", "G1 Z-1 F600"]
    program.write_text("\n".join([*head, *moves, "G0 Z5", "M2", ""]))
    simulator, control = GrblSimulator(settings=FAST), Control()
    if kind == "error":
        simulator.inject(Error(20), line=rng.randint(12, len(moves) + FIRST))
    moment, stood = rng.uniform(0.05, 0.7) * ends[-1], list[float]()

    def on_sent(sent: Progress) -> None:
        if stood or sent.position is None or sent.position[0] < moment or sent.position[2] > 0.0:
            return
        stood.append(simulator.position[0])
        if kind == "stop":
            control.stop()
        elif kind == "unplug":
            simulator.inject(Unplug())
        elif kind == "alarm":
            simulator.inject(Alarm(1))
        elif kind == "power":
            simulator.power_up()

    report = ran(simulator, program, control=control, callbacks=Callbacks(on_sent=on_sent))
    kept, _ = Checkpoint.read(str(program))
    if kept is None:
        assert report.resume_line is None, "no line has been reached: the program begins anew"
        return
    assert kept.line == report.resume_line
    # The board carries out what it has, and counts from zero after a restart.
    simulator.advance(simulator.now + 30.0)
    place = stood[0] if kind == "power" else simulator.position[0]
    reached = bisect_left(ends, place - 0.006) + FIRST - 1
    assert kept.line <= reached
    assert kind == "unplug" or reached - kept.line < 8
