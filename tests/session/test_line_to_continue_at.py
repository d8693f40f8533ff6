"""The line to continue at after a stop: exact, and one at which the program can begin."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from cnc.api import Callbacks, Control
from cnc.report.result import Report
from cnc.session.run_pulses import Progress
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from tests.support.boards.simulator_bench import material_below
from tests.support.session.position_runs import FAST, ran
from tests.support.soak import share

pytestmark = pytest.mark.usefixtures("nothing_kept")
PROBING = ["G21 G90", "G0 X5", "G38.2 Z-9 F300", "G10 L20 P1 Z0", "G0 Z3", "G1 X15 F600", "G0 X0"]
PROBE_LINE, CUT_LINE = 3, 6


def stopped(
    tmp_path: Path, lines: list[str], simulator: GrblSimulator, when: Callable[[Progress], bool]
) -> Report:
    """Run a program, and stop at the first report for which ``when`` is true."""
    program, control = tmp_path / "p.nc", Control()
    program.write_text("\n".join([*lines, "M2", ""]))

    def on_sent(sent: Progress) -> None:
        if sent.position is not None and when(sent):
            control.stop()

    return ran(simulator, program, control=control, callbacks=Callbacks(on_sent=on_sent))


@pytest.mark.parametrize("percent", share(range(5, 80, 5), [20, 65]))
def test_it_is_the_line_of_the_resting_position(percent: int, tmp_path: Path) -> None:
    lines = ["G21 G90", "G1 X0.2 F3000", *(f"X{0.2 * k:.1f}" for k in range(2, 200))]
    simulator = GrblSimulator(settings=FAST)
    at = 40.0 * percent / 100.0
    report = stopped(tmp_path, lines, simulator, lambda sent: (sent.position or (0.0,))[0] > at)
    rest = simulator.position[0]
    assert report.resume_line == report.stopped_at_line
    assert report.resume_line is not None
    begin = 0.2 * (report.resume_line - 2)
    assert begin <= rest <= begin + 0.25


def test_after_a_probe_it_is_the_line_of_the_probe(tmp_path: Path) -> None:
    """The next run does not know where the probe has touched."""
    simulator = GrblSimulator(settings=FAST, environment=material_below(-4.0))
    report = stopped(tmp_path, PROBING, simulator, lambda sent: (sent.position or (0.0,))[0] > 6.0)
    assert report.stopped_at_line == CUT_LINE
    assert report.resume_line == PROBE_LINE
    again = ran(simulator, tmp_path / "p.nc", from_line=report.resume_line)
    assert again.ok
    assert simulator.position[0] == pytest.approx(0.0, abs=0.01)
