"""Probing cycles: their heads, their calls, and their zero on a simulated workpiece."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from cnc.api import check, from_text
from cnc.gcode.core.tool_table import ToolTable
from cnc.machine.height_map import HeightMap, load_height_map, save_height_map
from cnc.machine.load import load_machine
from cnc.measure.procedures import GoTo, Touch
from cnc.model.diagnostics import BoardError, UsageError
from cnc.operate.height_mapping import Grid, PointsAgain
from cnc.operate.measuring import Moves
from cnc.operate.operator_session import OperatorSession
from cnc.operate.probing import cycles, mdi_line, shipped_cycles
from cnc.session.options import RunOptions
from cnc.simulators.grbl.workpiece import Box, HalfSpace, Hole, Workpiece

pytestmark = pytest.mark.usefixtures("quick_board")
PATIENCE = 120
CLOSE = 0.02
"""A step, and the rounding of a report, mm."""


def with_folder(machine, folder):
    program = machine.program.model_copy(update={"subroutines": (folder,)})
    return machine.model_copy(update={"program": program})


@pytest.fixture
def machine():
    """A mill that stands in the middle of its travel."""
    found = load_machine("grbl-uno")
    axes = {
        letter: axis.model_copy(update={"travel": (-60.0, 60.0)})
        for letter, axis in found.axes.items()
    }
    return found.model_copy(update={"axes": axes})


@pytest.fixture
def session(machine):
    with OperatorSession(machine, subroutines=[shipped_cycles()]) as found:
        found.connect("grbl-sim").result(PATIENCE)
        yield found


def run(session, name, **parameters):
    ended = session.probe(mdi_line(name, parameters, session.machine)).result(PATIENCE)
    assert (ended.outcome, [(each.code, each.message) for each in ended.findings]) == ("done", [])


def test_the_shipped_cycles_have_titles_and_parameters():
    found = {each.name: each for each in cycles(with_folder(load_machine(None), shipped_cycles()))}
    assert set(found) == {
        "probe_z", "probe_edge_x", "probe_edge_y", "probe_corner", "probe_hole", "tool_length",
        "probe_angle", "go_to", "trace_outline",
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


def on(session, *solids, radius=0.0):
    """Put a workpiece below the probe; the machine is at zero."""
    environment = session._worker.operated.board.simulator.core.environment
    environment.workpiece = Workpiece(solids, radius)


def test_go_to_lifts_first_and_sets_nothing(session):
    before = session.offsets
    run(session, "go_to", x=7.5, y=-4.0, height=3.0)
    assert session.state.machine == pytest.approx({"x": 7.5, "y": -4.0, "z": 3.0}, abs=CLOSE)
    assert session.offsets == before


def test_an_outline_ends_at_its_first_corner_with_the_spindle_off(session):
    session.mdi("M3 S500").result(PATIENCE)
    sides = {"x_low": -5.0, "x_high": 20.0, "y_low": 2.0, "y_high": 9.0}
    run(session, "trace_outline", **sides, height=4.0, feed=6000.0)
    state = session.state
    assert state.machine == pytest.approx({"x": -5.0, "y": 2.0, "z": 4.0}, abs=CLOSE)
    assert state.spindle == 0.0


def test_a_plate_sets_z(session):
    """The plate is 12 mm thick and its top is at machine Z -5, so Z zero is at -17."""
    on(session, Box((-5.0, 5.0), (-5.0, 5.0), -5.0), radius=1.5)
    run(session, "probe_z", thickness=12.0, distance=8.0, feed=1500.0)
    assert session.offsets["G54"]["z"] == pytest.approx(-17.0, abs=CLOSE)


@pytest.mark.parametrize(
    ("axis", "direction", "box", "edge"),
    [
        ("x", 1.0, Box((6.013, 40.0), (-9.0, 9.0), 4.0), 6.013),
        ("x", -1.0, Box((-40.0, -3.5), (-9.0, 9.0), 4.0), -3.5),
        ("y", 1.0, Box((-9.0, 9.0), (5.0, 40.0), 4.0), 5.0),
    ],
)
def test_an_edge_sets_its_axis(session, axis, direction, box, edge):
    """The centre of the probe is its radius before the edge at the contact."""
    on(session, box, radius=1.5)
    run(session, f"probe_edge_{axis}", direction=direction, distance=10.0, radius=1.5, feed=1500.0)
    assert session.offsets["G54"][axis] == pytest.approx(edge, abs=CLOSE)


@pytest.mark.parametrize(("towards_x", "towards_y"), [(-1, 1), (1, -1)])
def test_a_corner_sets_x_and_y(session, towards_x, towards_y):
    """The part lies behind the corner, as seen from the start."""
    corner = 4.02 * towards_x, 3.0 * towards_y
    spans = (
        sorted((at, at + 20.0 * way))
        for at, way in zip(corner, (towards_x, towards_y), strict=True)
    )
    on(session, Box(*map(tuple, spans), 1.0), radius=1.0)
    run(
        session, "probe_corner", x_direction=towards_x, y_direction=towards_y, distance=5.0,
        inset=4.0, radius=1.0, feed=1500.0,
    )  # fmt: skip
    zero = session.offsets["G54"]
    assert (zero["x"], zero["y"]) == pytest.approx(corner, abs=CLOSE)
    assert zero["z"] == 0.0


def test_a_hole_sets_its_centre(session):
    """The start is off the centre, and the radius of the pin has no effect."""
    on(session, Box((-40.0, 40.0), (-40.0, 40.0), 2.0, (Hole(1.25, -0.7, 5.0),)), radius=1.5)
    run(session, "probe_hole", distance=8.0, feed=1500.0)
    zero = session.offsets["G54"]
    assert (zero["x"], zero["y"]) == pytest.approx((1.25, -0.7), abs=CLOSE)
    assert session.state.machine["x"] == pytest.approx(1.25, abs=CLOSE)


def test_the_length_of_a_tool_is_written_into_the_tool_table(tmp_path, machine):
    """The setter is at work Z -15, and the contact at -7.75: the tool is 7.25 mm long."""
    table = tmp_path / "mill.tbl"
    table.write_text("T3 P3 Z1 D6 ;end mill\n")
    program = machine.program.model_copy(update={"tool_table": table})
    machine = machine.model_copy(update={"program": program})
    with OperatorSession(machine, subroutines=[shipped_cycles()]) as session:
        session.connect("grbl-sim").result(PATIENCE)
        on(session, Box((-5.0, 5.0), (-5.0, 5.0), -7.75))
        run(session, "tool_length", tool=3, height=-15.0, distance=10.0, feed=1500.0)
    found = ToolTable.load(table).tool(3)
    assert found.offset("Z") == pytest.approx(7.25, abs=CLOSE)


def test_a_grid_becomes_a_height_map(session, tmp_path):
    """The surface is a plane with two slopes; the work zero is off the machine's."""
    session.zero({"x": 1.0, "y": -2.0, "z": 5.0}).result(PATIENCE)
    normal = np.array([-0.02, 0.05, 1.0]) / math.hypot(0.02, 0.05, 1.0)
    level = normal @ (-1.0, 2.0, -5.0)
    on(session, HalfSpace(tuple(normal.tolist()), float(level)))
    grid = Grid(x=(1.0, 7.0), y=(-2.0, 2.0), step=3.0, clear=1.0, depth=1.0, feed=1500.0)
    found = session.probe_grid(grid).result(PATIENCE)
    assert (found.x, found.y) == ((0.0, 3.0, 6.0), (0.0, 2.0, 4.0))
    x, y = np.meshgrid(np.array(found.x) + 1.0, np.array(found.y) - 2.0)
    assert np.array(found.heights) == pytest.approx(0.02 * x - 0.05 * y, abs=CLOSE)
    assert (found.system, found.work_zero["z"]) == ("G54", pytest.approx(-5.0, abs=CLOSE))
    save_height_map(found, tmp_path / "map.json")
    assert load_height_map(tmp_path / "map.json") == found


def test_the_first_contact_of_a_grid_can_set_z(session):
    on(session, Box((-5.0, 40.0), (-5.0, 40.0), -1.5))
    grid = Grid(x=(0.0, 2.0), y=(0.0, 2.0), step=2.0, clear=1.0, depth=2.0, feed=1500.0, zero=True)
    found = session.probe_grid(grid).result(PATIENCE)
    assert np.abs(found.heights).max() <= CLOSE
    assert session.offsets["G54"]["z"] == pytest.approx(-1.5, abs=CLOSE)


def test_points_of_a_map_are_probed_again(session):
    """A chip of 0.4 mm lay at a corner; the map is right after the two points are probed again."""
    on(session, Box((-5.0, 40.0), (-5.0, 40.0), -0.5), Box((5.0, 9.0), (-5.0, 1.0), -0.1))
    grid = Grid(x=(0.0, 6.0), y=(0.0, 6.0), step=3.0, clear=1.0, depth=2.0, feed=1500.0)
    first = session.probe_grid(grid).result(PATIENCE)
    assert first.heights[0][2] == pytest.approx(-0.1, abs=CLOSE)
    on(session, Box((-5.0, 40.0), (-5.0, 40.0), -0.5))
    values = {"clear": 1.0, "depth": 2.0, "feed": 1500.0}
    again = PointsAgain(surface=first, points=((2, 0), (1, 2)), **values)
    second = session.probe_points(again).result(PATIENCE)
    assert np.array(second.heights) == pytest.approx(np.full((3, 3), -0.5), abs=CLOSE)
    assert second.model_copy(update={"heights": first.heights}) == first
    # A contact that does not come leaves the map, as does another zero.
    on(session, Box((50.0, 55.0), (50.0, 55.0), -0.5))
    with pytest.raises(BoardError, match="height-map-grid"):
        session.probe_points(again).result(PATIENCE)


@pytest.mark.parametrize(
    ("changes", "system", "zero", "reason"),
    [
        ({"points": ()}, "G54", {}, "no point"),
        ({"points": ((3, 0),)}, "G54", {}, "outside of the 2 x 2"),
        ({"points": ((0, -1),)}, "G54", {}, "outside of the 2 x 2"),
        ({"clear": 0.5}, "G54", {}, "above the surface"),
        ({"feed": math.nan}, "G54", {}, "not a number"),
        ({}, "G55", {}, "the map is of G54"),
        ({}, "G54", {"z": 0.01}, "not the one of the map"),
        ({}, "G54", {"x": 0.01}, "not the one of the map"),
    ],
)
def test_points_of_another_surface_are_refused(changes, system, zero, reason):
    surface = HeightMap(
        x=(0.0, 9.0), y=(0.0, 9.0), heights=((0.0, 0.8), (0.0, 0.8)), system="G54",
        work_zero={"x": 1.0, "y": 2.0, "z": 3.0},
    )  # fmt: skip
    again = PointsAgain(**({"surface": surface, "points": ((0, 0),)} | changes))
    here = {axis: surface.work_zero[axis] + zero.get(axis, 0.0) for axis in "xyz"}
    with pytest.raises(UsageError, match="height-map-grid") as refused:
        again.check(system, here)
    assert reason in refused.value.diagnostic.message


def test_a_grid_with_a_missing_contact_is_a_map_with_a_gap(session, tmp_path):
    """All other points are kept; a program waits until the gap has a height."""
    on(session, Box((-5.0, 40.0), (-5.0, 2.0), -0.5), Box((-5.0, 1.0), (-5.0, 40.0), -0.5))
    grid = Grid(x=(0.0, 3.0), y=(0.0, 3.0), step=3.0, clear=1.0, depth=1.0, feed=1500.0)
    surface = session.probe_grid(grid).result(PATIENCE)
    half = pytest.approx(-0.5, abs=CLOSE)
    assert surface.heights == ((half, half), (half, None))
    assert surface.gaps == [(1, 1)]
    file = tmp_path / "map.json"
    save_height_map(surface, file)
    assert load_height_map(file) == surface
    engraving = from_text("G21 G90 G94\nG0 X0 Y0 Z1\nG1 Z0 F100\nG1 X1\nM2\n")
    options = RunOptions(height_map=str(file))
    with pytest.raises(UsageError, match="height-map-gap") as refused:
        check(engraving, session.machine, options)
    assert "X3 Y3" in refused.value.diagnostic.message
    on(session, Box((-5.0, 40.0), (-5.0, 40.0), -0.5))
    again = PointsAgain(surface=surface, points=((1, 1),), clear=1.0, depth=1.0, feed=1500.0)
    surface = session.probe_points(again).result(PATIENCE)
    assert surface.heights == ((half, half), (half, half))
    save_height_map(surface, file)
    assert check(engraving, session.machine, options).ok


def test_points_probed_again_may_stay_gaps(session):
    """Two points without a contact are gaps, and the points behind them are probed."""
    on(session, Box((-5.0, 1.0), (-5.0, 40.0), -0.5), Box((8.0, 40.0), (-5.0, 40.0), -0.2))
    surface = HeightMap(
        x=(0.0, 3.0, 6.0, 9.0), y=(0.0, 3.0), system="G54",
        heights=((0.0, None, 0.1, 0.0), (0.0, 0.0, 0.0, 0.0)),
        work_zero={"x": 0.0, "y": 0.0, "z": 0.0},
    )  # fmt: skip
    points = ((0, 0), (1, 0), (2, 0), (3, 0))
    again = PointsAgain(surface=surface, points=points, clear=1.0, depth=1.0, feed=1500.0)
    heights = session.probe_points(again).result(PATIENCE).heights
    assert heights[0] == (
        pytest.approx(-0.5, abs=CLOSE), None, None, pytest.approx(-0.2, abs=CLOSE),
    )  # fmt: skip
    assert heights[1] == surface.heights[1]


@pytest.mark.parametrize(
    ("points", "stopped_at"),
    [
        (((1, 0), (0, 0)), 3.0),
        (((0, 0), (1, 0), (2, 0), (3, 0), (0, 1)), 9.0),
    ],
    ids=["first", "three in a row"],
)
def test_a_probe_that_meets_nothing_at_points_again_stops(session, points, stopped_at):
    on(session, Box((-5.0, 1.0), (-5.0, 40.0), -0.5))
    surface = HeightMap(
        x=(0.0, 3.0, 6.0, 9.0), y=(0.0, 3.0), system="G54", heights=((0.0,) * 4,) * 2,
        work_zero={"x": 0.0, "y": 0.0, "z": 0.0},
    )  # fmt: skip
    again = PointsAgain(surface=surface, points=points, clear=1.0, depth=1.0, feed=1500.0)
    with pytest.raises(BoardError, match="height-map-grid"):
        session.probe_points(again).result(PATIENCE)
    assert session.state.machine["x"] == pytest.approx(stopped_at, abs=CLOSE)


@pytest.mark.parametrize("part", [(1.0, 40.0), (-5.0, 1.0)], ids=["first", "three in a row"])
def test_a_probe_that_meets_nothing_again_and_again_stops(session, part):
    """Its cable may be off: it must not be pressed into the part at each point."""
    on(session, Box(part, (-5.0, 40.0), -0.5))
    grid = Grid(x=(0.0, 9.0), y=(0.0, 3.0), step=3.0, clear=1.0, depth=1.0, feed=1500.0)
    with pytest.raises(BoardError, match="height-map-grid"):
        session.probe_grid(grid).result(PATIENCE)
    reached = 0.0 if part[0] > 0.0 else 9.0
    assert session.state.machine["x"] == pytest.approx(reached, abs=CLOSE)


@pytest.mark.parametrize(
    "wrong",
    [
        {"x": (5.0, 5.0)}, {"y": (1.0, 0.0)}, {"step": 0.0}, {"clear": -1.0}, {"depth": 0.0},
        {"feed": math.nan}, {"step": 0.001}, {"tolerance": 0.0}, {"step": 0.1},
    ],
)  # fmt: skip
def test_impossible_grids_are_refused(wrong):
    with pytest.raises(UsageError, match="height-map-grid"):
        Grid(**{"x": (0.0, 10.0), "y": (0.0, 10.0), **wrong}).check()


def test_a_contact_that_does_not_come_is_an_error(session):
    ended = session.probe(
        mdi_line("probe_z", {"distance": 3.0, "feed": 900.0}, session.machine)
    ).result(PATIENCE)
    assert ended.outcome == "failed"
    assert session.offsets["G54"]["z"] == 0.0


def test_a_parameter_with_choices_has_their_meanings_and_takes_no_other_value():
    machine = with_folder(load_machine(None), shipped_cycles())
    edge = {cycle.name: cycle for cycle in cycles(machine)}["probe_edge_x"]
    side, distance, *_ = edge.parameters
    assert (side.title, side.choices) == (
        "side of the part", ((1.0, "towards plus X"), (-1.0, "towards minus X"))
    )  # fmt: skip
    assert distance.choices == ()
    assert mdi_line("probe_edge_x", {"direction": -1.0}, machine).startswith(
        "o<probe_edge_x> call [-1.000000] "
    )
    with pytest.raises(UsageError) as refused:
        mdi_line("probe_edge_x", {"direction": 2.0}, machine)
    finding = refused.value.diagnostic
    assert finding.code == "cycle-parameter"
    assert finding.hint == "give 1 (towards plus X) or -1 (towards minus X)"


@dataclass(frozen=True, kw_only=True)
class Steps:
    """An order of one step, whose answer is the result."""

    axis: str
    step: object
    probe = None
    needs_home = False

    @property
    def letters(self):
        return (self.axis,)

    def begin(self, scales):
        return (yield self.step)


def test_a_touch_gives_machine_places_and_goes_back(session):
    """The zero of the work lies elsewhere; a move that meets the part on its way is an error."""
    session.mdi("G10 L20 P1 X50 Y-3").result(PATIENCE)
    on(session, Box((6.013, 40.0), (-9.0, 9.0), 4.0), radius=1.5)

    def carried_out(step):
        order = Steps(axis="x", step=step)
        return session.measure(order, Moves(contact_feed=600.0)).result(PATIENCE)

    assert carried_out(Touch("x", 10.0, 3)) == pytest.approx([6.013 - 1.5] * 3, abs=CLOSE)
    assert session.state.machine["x"] == pytest.approx(0.0, abs=CLOSE)
    assert carried_out(GoTo("x", 3.0, guarded=True)) == ()
    assert session.state.machine["x"] == pytest.approx(3.0, abs=CLOSE)
    with pytest.raises(UsageError, match=r"met something at X4\.5.* on its way to 9\.000"):
        carried_out(GoTo("x", 9.0, guarded=True))
