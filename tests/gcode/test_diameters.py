"""X as a diameter on lathes: SINUMERIK's DIAMON, DIAMOF and DIAM90, Mach3, and the machine file.

Expected radii follow from Siemens, "SINUMERIK 840D sl/828D Programming Manual, Fundamentals",
"Channel-specific diameter/radius programming": DIAMON takes diameters under G90 and G91, DIAM90
under G90 and AC, and radii under G91 and IC. Centres are radii, and diameters with AC.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import cnc
from cnc.gcode import dialects
from cnc.gcode.core.modal_groups import ReadingPolicy
from cnc.gcode.core.program import ProgramOptions
from cnc.gcode.reader.source_text import Text
from cnc.model.blocks import ArcFeed
from tests.gcode.test_lathe import PROGRAMS, START
from tests.support.gcode.gcode_cases import block_summaries, error_of, points, run

TURNING = "G18 G90 G95\nT1 D1\nS600 M3\n"
LATHE: dict[str, Any] = {
    "axes": ("x", "z"), "lathe": True, "policy": ReadingPolicy(tool_lengths="zero")
}  # fmt: skip


def radii(source: str, dialect: str = "siemens", **options: Any) -> list[float]:
    """Return X of the ends of the moves, mm."""
    return [x for x, _ in points(source, dialect, **(LATHE | options))]


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("G0 X50 Z2", [25]),
        ("G0 X50\nX=IC(4)\nX=IC(-4)", [25, 27, 25]),
        ("G0 X50\nG91 X4\nX=IC(4)\nX=AC(40)", [25, 27, 29, 20]),
        ("G0 X50\nG91 X4\nG90 X=IC(4)\nG91 X=AC(40)", [25, 27, 29, 20]),
        ("DIAMOF\nG0 X50\nX=IC(4)\nG91 X4\nX=AC(40)", [50, 54, 58, 40]),
        ("DIAM90\nG0 X50\nX=IC(4)\nG91 X4\nX=IC(4)\nX=AC(40)", [25, 29, 33, 37, 20]),
        ("DIAM90\nG0 X50\nG91 X4\nG90 X=IC(4)\nX40\nG91 X=AC(50)", [25, 29, 33, 20, 25]),
        ("DIAMOF\nG0 X50\nDIAMON X50\nDIAM90\nX50\nG91 X2", [50, 25, 25, 27]),
        ("G70\nG0 X2\nX=IC(2)\nG91 X2", [25.4, 50.8, 76.2]),
    ],
)
def test_positions_of_siemens(source: str, expected: list[float]) -> None:
    assert radii(f"{TURNING}{source}\nM30") == pytest.approx(expected, abs=1e-12)


def test_centres_of_siemens_are_radii_and_diameters_with_ac() -> None:
    source = f"{TURNING}G0 X50 Z0\nG1 F0.2\nG2 X60 Z-5 I5 K0\nG3 X50 Z0 I=AC(60) K=AC(0)\nM30"
    arcs = [
        block for block in run(source, dialect="siemens", **LATHE) if isinstance(block, ArcFeed)
    ]
    assert [arc.center for arc in arcs] == [pytest.approx((0.0, 30.0))] * 2
    assert [arc.radius for arc in arcs] == [5.0, 5.0]


@pytest.mark.parametrize("diameters", [True, False, None])
@pytest.mark.parametrize("dialect", ["siemens", "mach3", "linuxcnc", "fanuc", "haas"])
def test_the_machine_file_says_whether_x_is_a_diameter(
    dialect: str, diameters: bool | None
) -> None:
    """Without the key X is a diameter, except in LinuxCNC's language, which begins with G8."""
    rules = dialects.load(dialect, lathe="A")
    expected = 25.0 if (dialect != "linuxcnc" if diameters is None else diameters) else 50.0
    found = block_summaries("G18\nG0 X50. Z2.\nM30", dialect=rules, diameters=diameters, **LATHE)
    assert found[0] == f"rapid {expected:g} 2"


@pytest.mark.parametrize("name", ["G90", "G94", "G92 is a thread with the lead F", "G32"])
def test_fanuc_in_radii_makes_the_same_moves(name: str) -> None:
    """Coordinates of X are halved; tapers and leads are the same."""
    source = START + PROGRAMS[name][0]
    halved = "\n".join(
        " ".join(
            f"{word[0]}{float(word[1:]) / 2.0}" if word[0] in "XU" else word
            for word in line.split()
        )
        for line in source.split("\n")
    )
    rules = dialects.load("fanuc", lathe="A")
    made = [
        block_summaries(f"{each}\nM30", dialect=rules, diameters=diameters, **LATHE)
        for each, diameters in ((source, None), (halved, False))
    ]
    assert made[0] == made[1]


@pytest.mark.parametrize("source", ["G19\nCYCLE81(20,10,2,5)", "HOLES1(10,0,0,0,5,3)"])
def test_cycles_that_move_x_are_refused_under_diameters(source: str) -> None:
    program = f"G0 X40 Z0\nF100\nMCALL CYCLE82(20,10,2,5)\n{source}\nM30"
    assert error_of(program, dialect="siemens", axes=("x", "y", "z"), lathe=True).code == (
        "code-not-supported"
    )


def test_diameters_are_refused_on_a_mill() -> None:
    assert error_of("G17\nDIAMON\nG0 X5\nM30", dialect="siemens").code == "code-not-supported"
    assert points("DIAMOF\nG0 X5\nM30", "siemens") == [(5.0, 0.0, 0.0)]


def checked(tmp_path: Path, source: str, machine: str) -> Any:
    """Return the report of a check; the machine has the axes X and Z."""
    program, file = tmp_path / "part.mpf", tmp_path / "machine.toml"
    program.write_text(source)
    axis = "steps_per_mm = 100\nmax_velocity = 50\nmax_acceleration = 500\nmax_jerk = 5000\n"
    file.write_text(f"[machine]\n{machine}\n[axes.x]\n{axis}[axes.z]\n{axis}")
    return cnc.check(program, file)


SIEMENS = f"; $PATH=/_N_MPF_DIR\nDEF REAL _A\n{TURNING}G0 X50 Z2\nG1 Z-5 F0.2\nM30\n"


@pytest.mark.parametrize(
    ("key", "words"),
    [("", "X in diameters and G18"), ("diameters = false", "X in radii and G18")],
)
def test_the_summary_says_how_x_is_read(tmp_path: Path, key: str, words: str) -> None:
    report = checked(tmp_path, SIEMENS, f'kind = "lathe"\n{key}')
    assert report.ok, report.faults
    assert words in report.assumed


def test_a_turning_program_of_siemens_is_refused_on_a_mill(tmp_path: Path) -> None:
    (found,) = checked(tmp_path, SIEMENS, 'kind = "mill"').faults
    assert (found.diagnostic.code, found.diagnostic.line) == ("program-for-lathe", 3)
    mill = SIEMENS.replace("G18", "G17").replace("X50 Z2", "X50 Y2 Z2")
    assert "program-for-lathe" not in [
        fault.diagnostic.code for fault in checked(tmp_path, mill, 'kind = "mill"').faults
    ]


def test_the_key_is_for_lathes_only(tmp_path: Path) -> None:
    with pytest.raises(cnc.model.diagnostics.MachineFileError, match="the machine is a mill"):
        checked(tmp_path, SIEMENS, "diameters = true")


def test_both_readers_agree_in_diameters() -> None:
    """The compiled reader halves X as the interpreter does."""
    source = "\n".join(f"G1 X{n * 1.7} Z{n} F100" for n in range(200))
    options = ProgramOptions(lathe=True)
    blocks = cnc.gcode.core.program.interpret(
        Text.of_lines(["G18", *source.split("\n")], "t"), axes=("x", "z"), dialect="mach3",
        options=options,
    )  # fmt: skip
    found = [row[0] for block in blocks if hasattr(block, "points") for row in block.points]
    assert found == [n * 1.7 * 0.5 for n in range(200)]
