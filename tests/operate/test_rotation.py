"""A turned workpiece: its angle is probed, and zero, readout and programs follow it."""

from __future__ import annotations

import math

import pytest

from cnc.machine.load import load_machine
from cnc.model.diagnostics import UsageError
from cnc.operate.events import OffsetsChanged, as_object
from cnc.operate.height_mapping import Grid
from cnc.operate.operator_session import OperatorSession
from cnc.operate.probing import mdi_line, shipped_cycles
from cnc.server.checking import parameters_of
from cnc.simulators.grbl.workpiece import HalfSpace, Workpiece
from tests.support.soak import share

pytestmark = pytest.mark.usefixtures("quick_board")
PATIENCE = 120
CLOSE = 0.02
"""A step, and the rounding of a report, mm."""


def machine_of(kept):
    """A mill in the middle of its travel; ``kept`` is its parameter file, or None."""
    machine = load_machine("grbl-uno")
    axes = {
        letter: axis.model_copy(update={"travel": (-60.0, 60.0)})
        for letter, axis in machine.axes.items()
    }
    program = machine.program.model_copy(update={"parameters": kept})
    return machine.model_copy(update={"axes": axes, "program": program})


@pytest.fixture(params=["grbl-sim", "loopback"])
def session(request, tmp_path):
    with OperatorSession(machine_of(tmp_path / "a.var"), subroutines=[shipped_cycles()]) as made:
        made.connect(request.param).result(PATIENCE)
        yield made


@pytest.fixture
def mill(tmp_path):
    with OperatorSession(machine_of(tmp_path / "a.var"), subroutines=[shipped_cycles()]) as made:
        made.connect("grbl-sim").result(PATIENCE)
        yield made


def on(session, *solids):
    environment = session._worker.operated.board.simulator.core.environment
    environment.workpiece = Workpiece(solids, 1.0)


def probed(session, **parameters):
    return session.probe(mdi_line("probe_angle", parameters, session.machine)).result(PATIENCE)


EDGES = [(1, 1, 30.0), (1, -1, -20.0), (2, 1, 25.0), (2, -1, -30.0)]


@pytest.mark.parametrize(
    ("along", "direction", "length", "degrees"),
    share(
        [(*edge, degrees) for edge in EDGES for degrees in (-7.3, 0.0, 4.0)],
        [(*edge, degrees) for edge, degrees in zip(EDGES, (-7.3, 4.0, 4.0, -7.3), strict=True)],
    ),
)
def test_the_angle_of_an_edge_turns_the_system(mill, along, direction, length, degrees):
    """The normal of the face is turned by the angle; the part fills the side that is probed."""
    angle = math.radians(degrees + (0.0 if along == 2 else 90.0))
    towards = (direction * math.cos(angle), direction * math.sin(angle), 0.0)
    # A half-space is below its plane: its normal points to the probe, 8 mm away.
    on(mill, HalfSpace(tuple(-each for each in towards), -8.0))
    ended = probed(
        mill, along=along, direction=direction, length=length, distance=18.0, feed=1500.0
    )
    assert (ended.outcome, [each.code for each in ended.findings]) == ("done", [])
    error = math.degrees(math.atan(2 * CLOSE / abs(length)))
    assert mill.rotations.get("G54", 0.0) == pytest.approx(degrees, abs=error)
    assert mill.offsets["G54"]["x"] == mill.offsets["G54"]["y"] == 0.0
    # A second measurement adds what is left: nothing.
    mill.mdi("G53 G0 X0 Y0").result(PATIENCE)
    first = mill.rotations.get("G54", 0.0)
    assert (
        probed(
            mill, along=along, direction=direction, length=length, distance=18.0, feed=1500.0
        ).outcome
        == "done"
    )
    assert mill.rotations.get("G54", 0.0) == pytest.approx(first, abs=2 * error)


def test_contacts_that_differ_are_refused_after_three_tries(mill):
    """A spread that no contact keeps: the cycle says so, and turns nothing."""
    on(mill, HalfSpace((0.0, -1.0, 0.0), -8.0))
    ended = probed(mill, spread=-0.001, feed=1500.0)
    assert ended.outcome == "failed"
    assert "differ by more than the spread" in ended.findings[0].message
    assert mill.rotations == {}


def test_a_part_in_the_way_along_the_edge_ends_the_cycle(mill):
    on(mill, HalfSpace((0.0, -1.0, 0.0), -8.0), HalfSpace((-1.0, 0.0, 0.0), -12.0))
    ended = probed(mill, feed=1500.0)
    assert ended.outcome == "failed"
    assert "met the part on its way" in ended.findings[0].message
    assert mill.rotations == {}


def test_readout_and_zero_follow_the_rotation(session):
    """Machine = origin + R (work): R turns by 30 degrees here."""
    events = []
    session.listen(events.append)
    session.mdi("G10 L2 P1 X1 Y2 R30").result(PATIENCE)
    assert session.rotations == {"G54": 30.0}
    last = [each for each in events if isinstance(each, OffsetsChanged)][-1]
    assert as_object(last)["rotations"] == {"G54": 30.0}
    session.mdi("G0 X10 Y4").result(PATIENCE)
    turn = complex(math.cos(math.pi / 6), 0.5)
    place = complex(1, 2) + turn * complex(10, 4)
    state = session.state
    assert state.machine["x"] == pytest.approx(place.real, abs=CLOSE)
    assert state.machine["y"] == pytest.approx(place.imag, abs=CLOSE)
    assert (state.work["x"], state.work["y"]) == pytest.approx((10.0, 4.0), abs=CLOSE)
    assert (state.zero["x"], state.zero["y"], state.rotation) == pytest.approx(
        (1, 2, 30), abs=CLOSE
    )
    # Zero of X alone: Y of the work position stays, so both axes of the origin move.
    session.zero({"x": 0.0}).result(PATIENCE)
    assert (session.state.work["x"], session.state.work["y"]) == pytest.approx((0, 4), abs=CLOSE)
    session.zero({"y": 2.0}, half=False).result(PATIENCE)
    assert (session.state.work["x"], session.state.work["y"]) == pytest.approx((0, 2), abs=CLOSE)
    session.mdi("G0 X0 Y0").result(PATIENCE)
    origin = place - turn * complex(0, 2)
    state = session.state
    assert state.machine["x"] == pytest.approx(origin.real, abs=2 * CLOSE)
    assert state.machine["y"] == pytest.approx(origin.imag, abs=2 * CLOSE)
    # A check of the console reads the program with the same rotation.
    assert parameters_of(session.offsets, session.rotations)[5230] == 30.0
    for refused in (
        lambda: session.zero({"x": 0.0}, "G92").result(PATIENCE),
        lambda: session.probe_grid(Grid(x=(0.0, 9.0), y=(0.0, 9.0))).result(PATIENCE),
    ):
        with pytest.raises(UsageError, match="system-rotated"):
            refused()
    session.select_system("G55")
    assert session.state.rotation == 0.0
    assert session.state.work == pytest.approx(session.state.machine, abs=CLOSE)


def test_a_rotation_without_a_parameter_file_is_told_to_be_lost():
    with OperatorSession(machine_of(None)) as session:
        events = []
        session.listen(events.append)
        session.connect("grbl-sim").result(PATIENCE)
        session.mdi("G10 L2 P1 R5").result(PATIENCE)
        codes = [as_object(each).get("finding", {}).get("code") for each in events]
        assert "rotation-not-kept" in codes
        assert session.rotations == {}
