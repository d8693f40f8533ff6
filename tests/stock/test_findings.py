"""Rapid moves into the stock are reported, except where a feed move has removed material."""

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cnc import cli
from cnc.api import check, load_machine
from cnc.machine.load import with_stock
from cnc.machine.models import Machine, Stock
from cnc.model.diagnostics import MachineFileError, UsageError
from tests.support.soak import share

STOCK = "x10:60, Y10:50,Z-20:0"
MACHINE = with_stock(load_machine("default"), STOCK)
HEAD = "G21 G90 G94 G17\nG0 Z5\nF600\n"
"""The default machine starts at 0, 0, 0, beside the stock."""


@pytest.fixture
def entered(tmp_path):
    """Return a function: lines of a program body, from 1, that have a finding."""

    def look(body: str) -> list[int]:
        file = tmp_path / "p.nc"
        file.write_text(HEAD + body + "\nM2\n")
        report = check(file, MACHINE)
        assert report.ok
        return [each.line - 3 for each in report.warnings if each.code == "rapid-into-stock"]

    return look


@pytest.mark.parametrize(
    ("body", "lines"),
    [
        ("G0 X30 Y30\nG0 Z-1", [2]),
        ("G0 X30 Y30\nG0 Z0.5\nG1 Z-1", []),
        ("G0 X30 Y30\nG0 Z0", []),  # on it
        ("G0 X5 Y30\nG0 Z-15", []),  # beside it
        ("G0 X10 Y10\nG0 Z-15", [2]),  # along its edge: every tool has a radius
        ("G0 X5 Y30 Z-25\nG0 X70\nG0 Z5", [2]),  # the shank goes through it
        ("G0 X5 Y30\nG0 Z-15\nG0 X30", [3]),  # from the side
        ("G0 X5 Y30 Z-15\nG0 X70", [2]),  # through it
        ("G0 X30 Y30\nG0 Z-5\nG0 Z5", [2]),  # the way out is not reported
        ("G0 X30 Y30\nG1 Z-5\nG0 Z5\nG0 Z-5", []),  # again where it was
        ("G0 X30 Y30\nG1 Z-5\nG0 Z5\nG0 Z-5.5", [4]),  # and deeper
        ("G0 X30 Y30\nG1 Z-5\nG0 Z5\nG0 X31\nG0 Z-5", [5]),
        ("G0 X30 Y30\nG1 Z-5\nG1 X50\nG0 Z5\nG0 X40\nG0 Z-4\nG0 X45", []),  # in the slot
        ("G0 X30 Y30\nG1 Z-5\nG2 X50 I10\nG0 Z5\nG0 X40 Y40\nG0 Z-4", []),  # on the arc
        ("G0 X30 Y30\nG1 Z-5\nG2 X50 I10\nG0 Z5\nG0 X40 Y38\nG0 Z-4", [6]),
        ("G0 X30 Y30\nG83 Z-18 R2 Q3\nG80", []),  # rapid moves into the hole itself
        ("G0 X30 Y30\nG81 Z-18 R-1\nG80", [2]),  # R inside the stock
        ("G91 G0 X30 Y30\nG0 Z-6", [2]),
        ("G92 X30 Y30 Z-7\nG0 X30 Z-9", []),
        ("G10 L2 P1 X30 Y30 Z-7\nG0 X0 Y0\nG0 Z0.5", [3]),  # machine coordinates, after the offsets
        ("G0 X30 Y30\nG0 Z-1 (cnc: ignore rapid-into-stock)", []),
        ("G0 X30 Y30\nG64 P0.05\nG1 Z-5\nG1 X50\nG0 Z5\nG0 X40\nG0 Z-4", []),
    ],
)
def test_lines_of_rapid_moves_into_the_stock(entered, body, lines):
    assert entered(body) == lines


def test_the_message_has_position_and_depth(tmp_path):
    file = tmp_path / "p.nc"
    file.write_text(HEAD + "G0 X30 Y30\nG0 Z-3.5\nG0 Z5\nM2\n")
    (finding,) = [each for each in check(file, MACHINE).warnings if each.code == "rapid-into-stock"]
    assert (finding.line, finding.severity, finding.text) == (5, "warning", "G0 Z-3.5")
    assert "at X29.95 Y29.95" in finding.message  # the centre of a cell
    assert "3.5 mm deep" in finding.message


@settings(max_examples=share(200, 8))
@given(
    st.lists(
        st.tuples(st.floats(0, 70), st.floats(0, 60), st.floats(-19, 5), st.booleans()),
        min_size=1,
        max_size=12,
    ),
)
def test_a_rapid_move_along_earlier_feed_moves_is_free(tmp_path_factory, moves):
    """Rapid moves before the feed moves are reported if one of their points is well inside."""
    points = [(round(x, 2), round(y, 2), round(z, 2)) for x, y, z, _ in moves]
    body = "G0 X0 Y0\n"
    feeds = "".join(f"G1 X{x} Y{y} Z{z}\n" for x, y, z in points)
    again = "".join(f"G0 X{x} Y{y} Z{z}\n" for x, y, z in reversed(points))
    file = tmp_path_factory.mktemp("stock") / "p.nc"
    file.write_text(HEAD + body + feeds + again + "M2\n")
    assert [
        each.line for each in check(file, MACHINE).warnings if each.code == "rapid-into-stock"
    ] == []
    file.write_text(HEAD + body + feeds.replace("G1", "G0") + "M2\n")
    inside = any(10.5 < x < 59.5 and 10.5 < y < 49.5 and z < -0.5 for x, y, z in points)
    assert (
        any(each.code == "rapid-into-stock" for each in check(file, MACHINE).warnings) or not inside
    )


def test_the_stock_option():
    assert MACHINE.stock == Stock(x=(10, 60), y=(10, 50), z=(-20, 0))
    for text in (
        "",
        "X0:1",
        "X0:1,Y0:1",
        "X0:1,Y0:1,Z1:0",
        "X0:1,Y0:1,Z0:1,X0:1",
        "X0:1,Y0:1,A0:1",
        "X0:1;Y0:1,Z0:1",
        "X0:1,Y0:1,Znan:1",
    ):
        with pytest.raises(UsageError, match="stock-malformed"):
            with_stock(load_machine("default"), text)


AXIS = "steps_per_mm = 100\nmax_velocity = 50\nmax_acceleration = 500\nmax_jerk = 9000\n"


def test_the_stock_of_a_machine_file(tmp_path):
    file = tmp_path / "m.toml"
    axes = "".join(f"[axes.{letter}]\n{AXIS}" for letter in "xyz")
    file.write_text(axes + "[stock]\nx = [0, 1]\ny = [0, 2]\nz = [-3, 0]\n")
    assert load_machine(file).stock == Stock(x=(0, 1), y=(0, 2), z=(-3, 0))
    for text, message in [
        (axes + "[stock]\nx = [0, 1]\ny = [0, 2]\n", "stock.z: is missing"),
        (
            axes + "[stock]\nx = [0, 1]\ny = [0, 2]\nz = [0, -3]\n",
            "stock.z: must be [lowest, highest]",
        ),
        (
            axes + "[stock]\nx = [0, 1]\ny = [0, 2]\nz = [0, 3]\na = [0, 1]\n",
            "stock.a: there is no such key",
        ),
        (
            axes[: axes.index("[axes.z]")] + "[stock]\nx = [0, 1]\ny = [0, 2]\nz = [-3, 0]\n",
            "stock: the machine does not have the axes",
        ),
    ]:
        file.write_text(text)
        with pytest.raises(MachineFileError) as raised:
            load_machine(file)
        assert raised.value.diagnostic.message.startswith(message)


@pytest.mark.usefixtures("one_process")
def test_the_stock_on_the_command_line(tmp_path, capfd):
    for name in "ab":
        (tmp_path / f"{name}.nc").write_text(HEAD + "G0 X30 Y30\nG0 Z-1\nM2\n")
    one, both = str(tmp_path / "a.nc"), str(tmp_path)
    for named in one, both:
        assert (
            cli.exit_code(["check", named, "--jobs", "1", "--stock", STOCK, "--fail-on", "warning"])
            == 1
        )
        assert (
            "rapid-into-stock: a rapid move enters the stock at X29.95 Y29.95 and goes 1 mm deep"
            in capfd.readouterr().err
        )
        assert cli.exit_code(["check", named, "--jobs", "1", "--fail-on", "warning"]) == 0
    assert cli.exit_code(["check", one, "--stock", "a lot"]) == 2


TOOLS = (
    "T1 D6 Z40 ;flat end mill\nT2 D6 Z55 ;ball end mill FL=3\n"
    "T3 D6 ;flat holder 30x10\nT9 D8 ;90 deg V-bit\n"
)


@pytest.fixture
def found(tmp_path):
    """Return a function: (code, line from 1) of the findings of a program body about the stock."""
    (tmp_path / "t.tbl").write_text(TOOLS)
    tools = MACHINE.program.model_copy(update={"tool_table": tmp_path / "t.tbl"})
    machine = MACHINE.model_copy(update={"program": tools})
    codes = {
        "rapid-into-stock",
        "shank-into-stock",
        "holder-into-stock",
        "cut-below-stock",
        "stock-turned",
        "tool-shape-assumed",
    }

    def look(body: str, machine: Machine = machine) -> list[tuple[str, int]]:
        file = tmp_path / "p.nc"
        file.write_text(HEAD + body + "\nM2\n")
        report = check(file, machine)
        assert report.ok, report.faults
        return [(each.code, each.line - 3) for each in report.warnings if each.code in codes]

    return look


SLOT = "G0 Z60\nT1 M6 G43 H1\nG0 X30 Y30 Z5\nG1 Z-2\nG1 X50\nG0 Z20"


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        # The radius of the tool counts: beside the stock, and beside a slot.
        ("T1 M6\nG0 X8 Y30\nG0 Z-5", [("rapid-into-stock", 3)]),
        ("T1 M6\nG0 X6.9 Y30\nG0 Z-5", []),
        ("T1 M6\nG0 X30 Y30\nG1 Z-5\nG1 X50\nG0 Z5\nG0 X40 Y31\nG0 Z-4", [("rapid-into-stock", 7)]),
        ("T1 M6\nG0 X30 Y30\nG1 Z-5\nG1 X50\nG0 Z5\nG0 X40\nG0 Z-4", []),
        # Without G43 the offset of the table does not count; with it the tip is meant.
        ("G0 Z60\nT1 M6 G43 H1\nG0 X30 Y30 Z5\nG1 Z-5\nG1 X50\nG0 Z2", []),
        ("G0 Z60\nT1 M6 G43 H1\nG0 X30 Y30 Z-5", [("rapid-into-stock", 3)]),
        # A second tool of another length in the slot of the first.
        (
            f"{SLOT}\nT2 M6 G43 H2\nG0 X40\nG0 Z-1.9",
            [],
        ),
        (
            f"{SLOT}\nT2 M6 G43 H2\nG0 X40\nG0 Z-2.1",
            [("rapid-into-stock", 9)],
        ),
        # Flutes of 3 mm, and a holder of 30 mm at 10 mm from the tip.
        ("T2 M6\nG0 X30 Y30\nG1 Z-2.9", []),
        ("T2 M6\nG0 X30 Y30\nG1 Z-3.5", [("shank-into-stock", 3)]),
        ("T3 M6\nG0 X30 Y30\nG1 Z-9.9", []),
        ("T3 M6\nG0 X30 Y30\nG1 Z-10.5", [("holder-into-stock", 3)]),
        # Through the stock: at the first place.
        ("T1 M6\nG0 X30 Y30\nG1 Z-20\nG1 Z-20.5 X31\nG1 X32", [("cut-below-stock", 4)]),
        ("T1 M6\nG0 X0 Y0\nG1 Z-20.5\nG0 Z5", []),
    ],
)
def test_parts_of_a_tool_in_the_stock(found, body, expected):
    assert found(body) == expected


def raster(z):
    """Return lines that clear X18 to X52 and Y11 to Y49 with the tool of 6 mm."""
    rows = [f"G1 X{21 + 28 * (k % 2)}\nG1 Y{14 + 4 * k}\nG1 X{49 - 28 * (k % 2)}" for k in range(9)]
    return "\n".join(["G0 X21 Y14", f"G1 Z{z}", *rows, "G0 Z5"])


HELIX = "T1 M6\nG0 X32 Y30 Z0.5\nG1 Z0\nG3 X32 Y30 I-2 Z-2\nG0 Z5\nG0 X30"
GROOVE = "T9 M6\nG0 X20 Y30\nG1 Z-2\nG1 X50\nG0 Z5"


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        # The holder (30 mm, 10 mm above the tip) beside a slot of 6 mm that is 10.2 mm deep.
        (
            "T3 M6\nG0 X30 Y30\nG1 Z-5\nG1 X50\nG1 Z-9.9\nG1 X30\nG1 Z-10.2",
            [("holder-into-stock", 7)],
        ),
        # The same depth in a pocket that is wider than the holder, and less deep.
        (f"T1 M6\n{raster(-1)}\nT3 M6\nG0 X35 Y30\nG1 Z-10.2", []),
        (f"T1 M6\n{raster(-1)}\nT3 M6\nG0 X35 Y30\nG1 Z-11.2", [("holder-into-stock", 34)]),
        # A pocket narrower than the holder: its rim stands 16 mm away, then 14 mm.
        (f"T1 M6\n{raster(-1)}\nT3 M6\nG0 X36 Y30\nG1 Z-10.2", []),
        (f"T1 M6\n{raster(-1)}\nT3 M6\nG0 X38 Y30\nG1 Z-10.2", [("holder-into-stock", 34)]),
        # A slanting traverse clips the edge of the stock: it is at Z0 where the tool is at X10.
        ("T1 M6\nG0 X5 Y30\nG0 X15 Z-5", [("rapid-into-stock", 3)]),
        ("T1 M6\nG0 X0 Y30\nG0 X6.5 Z-1.5", []),
        # A helix of radius 2 leaves a ramp: below the tool at its centre, to 0.8 mm.
        (f"{HELIX}\nG0 Z-0.7", []),
        (f"{HELIX}\nG0 Z-1.5", [("rapid-into-stock", 7)]),
        # A cone of 45 degrees a side in its groove: 0.1 mm higher it has 0.1 mm to each side.
        (f"{GROOVE}\nG0 X30 Y30.05\nG0 Z-1.9", []),
        (f"{GROOVE}\nG0 X30 Y30.6\nG0 Z-1.9", [("rapid-into-stock", 7)]),
        # The wall between two pockets.
        (
            "T1 M6\nG0 X20 Y30\nG1 Z-3\nG1 X26\nG0 Z5\nG0 X50\nG1 Z-3\nG1 X44\nG0 X26",
            [("rapid-into-stock", 9)],
        ),
        # A ball of 6 mm with flutes of 3 mm in a slot of 6 mm: its shank touches nothing.
        ("T1 M6\nG0 X30 Y30\nG1 Z-8\nG1 X50\nG0 Z5\nT2 M6\nG0 X40\nG1 Z-7.9\nG1 X45", []),
    ],
)
def test_programs_whose_contacts_follow_from_geometry(found, body, expected):
    assert found(body) == expected


def test_a_tool_without_a_table_is_described_by_a_comment_or_assumed(found):
    body = "T7 M6\nG0 X30 Y30\nG1 Z-1"
    assert found(body, MACHINE) == [("tool-shape-assumed", -3)]
    assert found("(T7 D=6 flat end mill)\n" + body, MACHINE) == []
    assert found("T7 M6\nG0 X30 Y30\nG1 Z0", MACHINE) == []  # it does not cut


def test_a_rotary_axis_that_turns_the_stock_is_said(found):
    axes = {**MACHINE.axes, "a": MACHINE.axes["x"].model_copy(update={"travel": None})}
    machine = MACHINE.model_copy(update={"axes": axes})
    assert ("stock-turned", 2) in found("G0 X0\nG1 A90 F100\nG1 A0", machine)


def test_the_summary_tells_resolution_and_volume(tmp_path, capfd):
    file, json_file, stl = tmp_path / "p.nc", tmp_path / "s.json", tmp_path / "part.stl"
    file.write_text(HEAD + "(T1 D=4 flat)\nT1 M6\nG0 X5 Y30\nG1 Z-5\nG1 X65\nM2\n")
    given = ["check", str(file), "--stock", STOCK, "--stock-resolution", "0.25", "--json"]
    assert cli.exit_code([*given, str(json_file), "--stl", str(stl)]) == 0
    assert "simulated in cells of 0.25 mm" in capfd.readouterr().out
    stock = json.loads(json_file.read_text())["stock"]
    assert stock["resolution_mm"] == 0.25
    assert stock["removed_mm3"] == pytest.approx(50 * 4 * 5, rel=1e-9)  # 16 whole cells wide
    assert stl.stat().st_size > 84
    assert cli.exit_code(["check", str(file), "--stl", str(stl)]) == 2
    assert "stock-missing" in capfd.readouterr().err
    assert cli.exit_code(["check", str(file), "--stock", STOCK, "--stl", "part.obj"]) == 2
    assert "output-format" in capfd.readouterr().err
