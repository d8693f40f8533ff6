"""Probing cycles: their heads, their calls, and their zero on a simulated workpiece."""

from __future__ import annotations

import math

import pytest

from cnc.machine.load import load_machine
from cnc.model.diagnostics import UsageError
from cnc.operate.operator_session import OperatorSession
from cnc.operate.probing import cycles, mdi_line, shipped_cycles

PATIENCE = 120
CLOSE = 0.02
"""A step, and the rounding of a report, mm."""


def with_folder(machine, folder):
    program = machine.program.model_copy(update={"subroutines": (folder,)})
    return machine.model_copy(update={"program": program})


@pytest.fixture
def session():
    with OperatorSession(load_machine("grbl-uno"), subroutines=[shipped_cycles()]) as found:
        found.connect("grbl-sim").result(PATIENCE)
        yield found


def run(session, name, **parameters):
    ended = session.probe(mdi_line(name, parameters, session.machine)).result(PATIENCE)
    assert (ended.outcome, ended.findings) == ("done", ())


def test_the_shipped_cycles_have_titles_and_parameters():
    found = {each.name: each for each in cycles(with_folder(load_machine(None), shipped_cycles()))}
    assert set(found) == {
        "probe_z", "probe_edge_x", "probe_edge_y", "probe_corner", "probe_hole", "tool_length",
    }  # fmt: skip
    assert all(each.title and each.parameters for each in found.values())
    assert [each.name for each in found["probe_z"].parameters] == ["thickness", "distance", "feed"]


def test_files_without_a_head_are_no_cycles(tmp_path):
    (tmp_path / "plain.ngc").write_text("o<plain> sub\nG0 X1\no<plain> endsub\n")
    (tmp_path / "bytes.ngc").write_bytes(b"\xff\xfe")
    assert cycles(with_folder(load_machine(None), tmp_path)) == []


def test_a_call_has_the_parameters_in_order(tmp_path):
    (tmp_path / "mine.ngc").write_text(
        "( Mine )\n( #2 second = 2 : b )\n( #1 first = -1.5 : a )\no<mine> sub\no<mine> endsub\n"
    )
    machine = with_folder(load_machine(None), tmp_path)
    assert mdi_line("mine", {"second": 7.0}, machine) == "o<mine> call [-1.500000] [7.000000]"
    for values in ({"third": 1.0}, {"first": math.nan}):
        with pytest.raises(UsageError, match="cycle-parameter"):
            mdi_line("mine", values, machine)
    with pytest.raises(UsageError, match="no-such-cycle"):
        mdi_line("other", {}, machine)


def test_a_plate_sets_z(session):
    """The plate is 12 mm thick and its top is at machine Z -5, so Z zero is at -17."""
    environment = session._operated.board.simulator.core.environment
    environment.surface = ((0.0, 0.0, 1.0), -5.0)
    run(session, "probe_z", thickness=12.0, distance=8.0, feed=900.0)
    assert session.offsets["G54"]["z"] == pytest.approx(-17.0, abs=CLOSE)


@pytest.mark.parametrize(
    ("axis", "direction", "normal", "edge"),
    [("x", 1.0, (-1.0, 0.0, 0.0), 6.0), ("y", 1.0, (0.0, -1.0, 0.0), 5.0)],
)
def test_an_edge_sets_its_axis(session, axis, direction, normal, edge):
    """The centre of the probe is its radius before the edge at the contact."""
    environment = session._operated.board.simulator.core.environment
    environment.surface = (normal, -(edge - 1.5))
    run(session, f"probe_edge_{axis}", direction=direction, distance=10.0, radius=1.5, feed=900.0)
    assert session.offsets["G54"][axis] == pytest.approx(edge, abs=CLOSE)


def test_a_contact_that_does_not_come_is_an_error(session):
    ended = session.probe(
        mdi_line("probe_z", {"distance": 3.0, "feed": 900.0}, session.machine)
    ).result(PATIENCE)
    assert ended.outcome == "failed"
    assert session.offsets["G54"]["z"] == 0.0
