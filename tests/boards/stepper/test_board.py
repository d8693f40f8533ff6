"""The stepper board in the simulator: conformance of a pulse board, and runs of programs to the
pins.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from cnc.api import Callbacks, Control, Outputs, Report, run
from cnc.api import check as plan_only
from cnc.boards.stepper.driver import Stepper
from cnc.machine.load import load_machine
from cnc.machine.models import Machine
from cnc.model.choices import Algorithm
from cnc.pulses.reference_pulse import ALGORITHMS
from tests.support.boards.board_conformance import AXES, PulseBoardConformance
from tests.support.boards.stepper_rig import CLOSE_US, machine, off_plan_us
from tests.support.boards.stepper_simulator import FREQUENCY, Simulator, SimulatorPort
from tests.support.paths import PROGRAMS
from tests.support.programs.tool_parts import file_of, in_parts
from tests.support.session.runs import run_with
from tests.support.soak import share

REAL_PORT = os.environ.get("CNC_STEPPER_PORT", "")


class TestStepper(PulseBoardConformance):
    least = 18_000
    plays_at_once = False

    def make(self, folder: Path) -> Stepper:
        port = SimulatorPort(Simulator())
        known = machine()
        assert len(known.axes) == AXES
        return Stepper(port, known, "the simulator", clock=port)


if REAL_PORT:

    class TestStepperOnAPort(PulseBoardConformance):
        """The suite on a real board, by hand (docs/how-to/stepper-board.md): a few steps."""

        least = 18_000
        plays_at_once = False

        def make(self, folder: Path) -> Stepper:
            return Stepper.from_machine(machine(), Path(REAL_PORT))


def played(
    program: Path, folder: Path, known: Machine, algorithm: Algorithm | None = None
) -> tuple[Report, Simulator]:
    """Run a program on a simulated board, and write its pulses to ``pulses.npz``."""
    simulator = Simulator()
    port = SimulatorPort(simulator)
    board = Stepper(port, known, "the simulator", clock=port)
    report = run_with(
        program,
        known,
        board=board,
        outputs=Outputs(pulses=str(folder / "pulses.npz")),
        algorithm=algorithm,
    )
    board.close()
    return report, simulator


SMALL = """G21 G90 G64 P0.01
M3 S500
G1 X6 Y4 Z-1 F2400
G3 X2 Y8 R5
G4 P0.1
G0 Z2
G1 X0 Y0.3 F1200
M2
"""


@pytest.fixture
def small(tmp_path: Path) -> Path:
    (tmp_path / "small.ngc").write_text(SMALL)
    return tmp_path / "small.ngc"


def check(simulator: Simulator, folder: Path) -> None:
    with np.load(folder / "pulses.npz") as pulses:
        cycles, made = simulator.moves()
        np.testing.assert_array_equal(made, pulses["step"])
        assert off_plan_us(cycles, pulses["time_ns"]) <= CLOSE_US


def test_pins_make_the_planned_moves(small: Path, tmp_path: Path) -> None:
    report, simulator = played(small, tmp_path, machine())
    assert report.ok
    check(simulator, tmp_path)
    simulator.close()


@pytest.mark.soak
@pytest.mark.parametrize("program", share([None, PROGRAMS / "trident.nc"], [None]))
def test_pins_take_the_estimated_time(program: Path | None, small: Path, tmp_path: Path) -> None:
    """Both axes end on the grid, so the last edge is the end of the motion."""
    known = machine()
    report, simulator = played(program or small, tmp_path, known)
    cycles, _ = simulator.moves()
    simulator.close()
    with np.load(tmp_path / "pulses.npz") as pulses:
        first = float(pulses["time_ns"][0]) * 1e-9
    took = first + float(cycles[-1] - cycles[0]) / FREQUENCY
    assert took == pytest.approx(report.duration_s, abs=known.path.period)
    assert report.duration_s == pytest.approx(
        plan_only(program or small, known).duration_s, abs=known.path.period
    )


SHIPPED = sorted(path.name for path in PROGRAMS.glob("*.nc"))
SENSING = ("turned-thread.nc",)
"""Programs that need a spindle sensor, which this board lacks."""
DENSE = ("crossings", "point-by-point")
"""Algorithms with rows for each axis. The connection may not carry them: an error before motion."""
PROBING = ("probing.nc",)
"""Programs that need a probe contact."""


@pytest.mark.soak
@pytest.mark.parametrize("algorithm", share(ALGORITHMS, ("crossings",)))
@pytest.mark.parametrize(
    "name",
    share(in_parts([name for name in SHIPPED if name not in SENSING + PROBING]), ["trident.nc"]),
)
def test_shipped_programs(name: str, algorithm: Algorithm, tmp_path: Path) -> None:
    program = file_of(name, tmp_path)
    report, simulator = played(program, tmp_path, load_machine("default"), algorithm)
    if algorithm in DENSE and not report.ok:
        assert [fault.diagnostic.code for fault in report.faults] == ["board-too-dense"]
        assert not len(simulator.moves()[0])
    else:
        assert report.ok
        check(simulator, tmp_path)
    simulator.close()


@pytest.mark.parametrize("name", SENSING)
def test_programs_that_need_sensors_are_refused(name: str, tmp_path: Path) -> None:
    report, simulator = played(PROGRAMS / name, tmp_path, load_machine("default"))
    assert [fault.diagnostic.code for fault in report.faults] == ["board-senseless"]
    assert not len(simulator.moves()[0])
    simulator.close()


FULL, ACCELERATION, JERK, RADIUS = 40.0, 400.0, 15000.0, 5.0
"""mm and s: what X and Y of the machine can, and the arcs below."""
HORIZON = 0.15
"""s: no more than this is committed when a hold comes, and no less than 0.1."""


def stopping(acceleration: float, jerk: float) -> float:
    """Return the seconds from full speed to rest along an S: v / a + a / j (Biagiotti, Melchiorri
    2008, 3.4).
    """
    return FULL / acceleration + acceleration / jerk


ON_A_LINE = stopping(ACCELERATION, JERK)
SPEEDING_UP = ON_A_LINE + ACCELERATION / JERK
"""Speeding up, the acceleration has to end first."""
_ROUND = FULL**2 / RADIUS
_LEFT = (ACCELERATION**2 - _ROUND**2) ** 0.5
ON_THE_ARC = stopping(
    _LEFT, (JERK**2 - (3 * FULL * _LEFT / RADIUS) ** 2) ** 0.5 - FULL**3 / RADIUS**2
)
"""Going round takes v^2/r across the path, and of the jerk 3 v a / r across and v^3 / r^2 along it:
braking has the rest, at worst.
"""


@pytest.mark.soak
@pytest.mark.parametrize(
    ("text", "moment", "braking"),
    [
        *share([("G1 X30 F2400", 0.01, SPEEDING_UP)], []),
        *share(
            [
                ("G1 X30 F2400", 0.3, ON_A_LINE),
                ("G2 X0 Y0 I5 J0 F2400", 0.01, ON_THE_ARC + ACCELERATION / JERK),
            ],
            [],
        ),
        *(
            ("G2 X0 Y0 I5 J0 F2400", moment, ON_THE_ARC)
            for moment in share(np.linspace(0.2, 0.6, 20).tolist(), [0.49])
        ),
    ],
)
def test_hold_takes_horizon_and_braking_time(
    tmp_path: Path, text: str, moment: float, braking: float
) -> None:
    (tmp_path / "p.ngc").write_text(f"G21 G90 G17\n{text}\nM2\n")
    plain, reference = played(tmp_path / "p.ngc", tmp_path, machine())
    assert plain.ok
    control, simulator, asked, rest = Control(), Simulator(), [], []
    port = SimulatorPort(simulator)
    board = Stepper(port, machine(), "the simulator", clock=port)

    def on_sent(sent: object) -> None:
        if not asked and board._sender.running and board._sender.played_ns * 1e-9 > moment:
            asked.append(simulator.cycle)
            control.hold()
        if getattr(sent, "held", False):
            rest.append(int(simulator.moves()[0][-1]))
            control.resume()

    assert run(
        tmp_path / "p.ngc",
        machine(),
        board=board,
        control=control,
        callbacks=Callbacks(on_sent=on_sent),
    ).ok
    board.close()
    assert (rest[0] - asked[0]) / FREQUENCY <= HORIZON + braking
    cycles, expected = simulator.moves()[0], reference.moves()[0]
    committed = np.searchsorted(cycles, asked[0] + 0.1 * FREQUENCY)
    assert off_plan_us(cycles[:committed], expected[:committed] * 1e9 / FREQUENCY) <= CLOSE_US, (
        "a hold changes nothing that is committed"
    )
    simulator.close()
    reference.close()


@pytest.mark.parametrize("moment", np.linspace(0.1, 0.45, share(50, 1)).tolist())
def test_hold_and_resume_change_no_step(small: Path, tmp_path: Path, moment: float) -> None:
    """The edges and their order equal those of a run without a hold.

    The board rests soon after the request.
    """
    with_hold, without = tmp_path / "a", tmp_path / "b"
    with_hold.mkdir()
    without.mkdir()
    control = Control()
    simulator = Simulator()
    port = SimulatorPort(simulator)
    board = Stepper(port, machine(), "the simulator", clock=port)
    held_at: list[int] = []
    rests: list[int] = []

    def on_sent(sent: object) -> None:
        if not held_at and board._sender.running and board._sender.played_ns * 1e-9 > moment:
            held_at.append(simulator.cycle)
            control.hold()
        if getattr(sent, "held", False):
            rests.append(int(simulator.moves()[0][-1]))
            control.resume()

    report = run(
        small, machine(), board=board, control=control, callbacks=Callbacks(on_sent=on_sent)
    )
    board.close()
    assert report.ok
    plain, reference = played(small, without, machine())
    assert plain.ok
    np.testing.assert_array_equal(simulator.moves()[1], reference.moves()[1])
    assert rests
    assert (rests[0] - held_at[0]) / FREQUENCY <= HORIZON + ON_THE_ARC
    simulator.close()
    reference.close()


def test_next_program_begins_at_the_current_position(small: Path, tmp_path: Path) -> None:
    simulator = Simulator()
    port = SimulatorPort(simulator)
    (tmp_path / "next.ngc").write_text("G21 G90\nG0 X0 Y0 Z0\nM2\n")
    for program in (small, tmp_path / "next.ngc"):
        board = Stepper(port, machine(), "the simulator", clock=port)
        assert run(program, machine(), board=board).ok
        board.close()
    assert simulator.moves()[1].sum(axis=0, dtype=np.int64).tolist() == [0, 0, 0]
    simulator.close()


CHANGE = "G21 G90\nG1 X1 F600\nT2 M6\nG1 X2\nM2\n"


def test_tool_change_waits_for_the_operator(tmp_path: Path) -> None:
    """The machine rests until a resume.

    Without an operator the program continues, as on the GRBL simulator.
    """
    (tmp_path / "change.ngc").write_text(CHANGE)
    control, rests = Control(), []
    simulator = Simulator()
    port = SimulatorPort(simulator)
    board = Stepper(port, machine(), "the simulator", clock=port)

    def on_sent(sent: object) -> None:
        if getattr(sent, "held", False):
            rests.append(len(simulator.moves()[0]))
            control.resume()

    assert run(
        tmp_path / "change.ngc",
        machine(),
        board=board,
        control=control,
        callbacks=Callbacks(on_sent=on_sent),
    ).ok
    board.close()
    assert rests == [400]
    assert len(simulator.moves()[0]) == 800
    simulator.close()
    report, simulator = played(tmp_path / "change.ngc", tmp_path, machine())
    assert report.ok
    assert run(tmp_path / "change.ngc", machine(), board="loopback").ok
    simulator.close()
