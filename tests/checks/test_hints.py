"""Warnings and notes: their lines, their number, and the selection of findings."""

import json

import pytest

from cnc import cli
from cnc.api import Report, RunOptions, Selection, check, load_machine, run
from cnc.checks import selection
from cnc.checks.hints import step_rate
from cnc.checks.selection import ignored_in, unknown_codes
from cnc.model.diagnostics import Diagnostic, UsageError
from cnc.report.result import Extremes
from tests.support.paths import ROOT
from tests.support.soak import share

HINTS = {
    "spindle-off",
    "feed-unreachable",
    "move-below-step",
    "step-rate",
    "arc-not-closed",
    "arc-radius-drift",
    "word-shadowed",
    "word-without-effect",
}
HEAD = "G21 G90 G94 G61\n"


@pytest.fixture
def found(tmp_path):
    """Return a function: code, line and severity of each finding in a program."""

    def look(text: str, machine=None, **options) -> list[tuple[str, int, str]]:
        file = tmp_path / "p.nc"
        file.write_text(HEAD + text)
        report = check(file, machine, RunOptions(**options))
        assert report.ok
        return [(each.code, each.line, each.severity) for each in report.warnings]

    return look


SPINDLE = ("spindle-off", 2, "warning")
FEED = ("feed-unreachable", 2, "note")
SHORT = ("move-below-step", 2, "note")


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        # a program that never uses the spindle
        ("G1 X5 F600\nG2 X9 I2\nM2", []),
        ("S900 M3\nG1 X5 F600\nM5\nG0 X0\nM2", []),
        ("G1 X5 F600\nG1 X6\nS900 M3\nG1 X9\nM5\nM2", [SPINDLE]),
        ("G2 X9 I4.5 F600\nS900 M4\nG1 X5\nM5\nM2", [SPINDLE]),
        ("G5.2 X1 Y1 L3 F600\nX2 Y2\nX3 Y0\nG5.3\nM3 S9\nM2", [SPINDLE]),
        (
            "S900 M3\nM5\nG0 X3\nG1 X5 F600\nM3\nM5\nG1 X6\nG1 X7\nM2",
            [("spindle-off", 5, "warning"), ("spindle-off", 8, "warning")],
        ),
        # highest speed of the default machine: 6000 mm/min, of its Z axis 3000
        ("G1 X50 F6000\nG1 Z-5 F3000\nG0 X0\nM2", []),
        ("G1 X50 F6001\nG1 X0\nM2", [FEED]),
        ("G1 Z-5 F3001\nM2", [FEED]),
        ("G1 X30 Z-40 F3749\nM2", []),
        ("G1 X30 Z-40 F3751\nM2", [FEED]),
        ("G2 X20 I10 F6001\nM2", [FEED]),
        ("G93 G1 X50 F200\nM2", [FEED, ("block-time", 2, "note")]),
        ("G20 G1 X1 F240\nM2", [FEED]),
        ("G1 X5 F600 (cnc: ignore spindle-off)\nS900 M3\nM2", []),
        ("G1 X5 F9000 ; CNC: ignore spindle-off, feed-unreachable\nS900 M3\nM2", []),
        ("G1 X5 F9000 (cnc: ignore spindle-off)\nS900 M3\nM2", [FEED]),
        ("(cnc: ignore feed-unreachable)\nG1 X5 F9000\nM2", [("feed-unreachable", 3, "note")]),
        # 200 steps a mm
        ("G1 X0.0049 F600\nG1 X5\nG1 X5.0051\nG1 X5.0101\nG0 X5.0102\nM2", [SHORT]),
        ("G1 X0.005 F600\nG1 X0.005\nM2", []),
        ("G1 X0.003 Y0.005 F600\nM2", []),
    ],
)
def test_lines_of_findings(found, text, wanted):
    machine = load_machine("default")
    assert [axis.max_velocity for axis in machine.axes.values()] == [100, 100, 50]
    assert found(text) == wanted


def test_a_finding_of_many_moves_is_reported_once(tmp_path):
    file = tmp_path / "p.nc"
    file.write_text(HEAD + "F12000\n" + "G1 X50\nG1 X0\n" * 30 + "M2\n")
    (finding,) = check(file).warnings
    assert finding.message == (
        "a feed of 12000 mm/min is 2 times the highest speed of the machine; "
        "60 moves are slower than programmed"
    )
    assert (finding.line, finding.text) == (3, "G1 X50")
    file.write_text(HEAD + "G1 X5 F8000 Z0\nM2\n")
    (finding,) = check(file).warnings
    assert finding.message.endswith("; 1 move is slower than programmed")
    assert (finding.column, finding.length) == (7, 5)


def test_many_findings_of_one_code_hide_no_other_code(found):
    reported = found("".join(f"F{100 + k}\n" for k in range(150)) + "G1 X5\nS9 M3\nM2")
    assert [code for code, _, _ in reported] == ["word-shadowed"] * 100 + ["spindle-off"]


def test_findings_in_a_subroutine_have_its_lines(found):
    text = "o1 sub\nG1 X5 F9000\nG1 X0\no1 endsub\no1 call\no1 call\nS9 M3\nM2"
    assert found(text) == [("spindle-off", 3, "warning"), ("feed-unreachable", 3, "note")]


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("", ["program-empty"]),
        ("\0\0\0", ["program-empty"]),
        ("(part)\n", ["program-empty"]),
        ("%\n%\n", ["program-empty"]),
        ("o1 sub\nG0 X1\no1 endsub\n", ["program-empty"]),
        ("G0 X1\n", []),
        ("M8\n", []),
    ],
)
def test_a_program_without_a_block_is_a_finding(tmp_path, text, wanted):
    file = tmp_path / "p.nc"
    file.write_text(text)
    codes = [each.code for each in check(file).warnings]
    assert [code for code in codes if code == "program-empty"] == wanted


def test_step_rate_above_the_limit_of_the_board():
    machine = load_machine("default")
    slow = machine.model_copy(
        update={"board": machine.board.model_copy(update={"max_step_rate": 10_000.0})}
    )
    for velocity, wanted in (50.0, []), (50.001, ["step-rate"]):
        report = Report(
            "p.nc",
            slow,
            largest=Extremes(axes={"x": {"velocity": velocity}, "y": {"velocity": None}}),
        )
        assert [each.code for each in step_rate(report)] == wanted


def test_step_rate_is_a_finding_of_a_check(found):
    machine = load_machine("default")
    slow = machine.model_copy(
        update={"board": machine.board.model_copy(update={"max_step_rate": 10_000.0})}
    )
    assert found("G1 X50 F6000\nM2", slow) == [("step-rate", 0, "warning")]


def test_a_run_has_no_hints(tmp_path):
    file = tmp_path / "p.nc"
    file.write_text(HEAD + "G1 X5 F9000\nM3 S9\nM2\n")
    assert run(file).warnings == []


@pytest.mark.parametrize(
    "name", sorted(path.name for path in (ROOT / "programs").glob("*.nc"))[:: share(1, 3)]
)
def test_shipped_programs_have_no_such_findings(name):
    text = (ROOT / "programs" / name).read_text()
    if len(text) < 100_000:
        machine = "paper-nurbs" if name.startswith("trident") else None
        assert [
            each.code
            for each in check(ROOT / "programs" / name, machine).warnings
            if each.code in HINTS
        ] == []


def test_codes_are_selected_and_ignored(found):
    text = "G1 X5 F9000\nS900 M3\nM2"
    assert found(text) == [SPINDLE, FEED]
    assert found(text, selection=Selection(select=frozenset({"feed-unreachable"}))) == [FEED]
    assert found(text, selection=Selection(ignore=frozenset({"feed-unreachable"}))) == [SPINDLE]
    assert (
        found(text, selection=Selection(frozenset({"spindle-off"}), frozenset({"spindle-off"})))
        == []
    )
    error = Diagnostic("soft-limit", "out", text="G0 X999 (cnc: ignore soft-limit)")
    assert Selection(frozenset({"spindle-off"})).wants(error)


@pytest.mark.parametrize(
    ("code", "hint"),
    [
        ("spindel-off", "did you mean spindle-off?"),
        ("FEED-UNREACHABLE", "did you mean feed-unreachable?"),
        ("soft-limit", "the codes are abort-possible"),
    ],
)
def test_an_unknown_code_is_a_fault(capfd, code, hint):
    for named in {"select": frozenset({code})}, {"ignore": frozenset({"spindle-off", code})}:
        with pytest.raises(UsageError, match="unknown-finding") as raised:
            Selection(**named)
        assert raised.value.diagnostic.hint.startswith(hint)
    for option in "--select", "--ignore":
        assert cli.exit_code(["check", "p.nc", option, f"spindle-off,{code}"]) == 2
    assert f"unknown-finding: no warning or note has the code '{code}'" in capfd.readouterr().err


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_an_unknown_code_in_a_comment_is_a_finding(tmp_path, end):
    file = tmp_path / "p.nc"
    lines = [
        "G21 G90 (\xfc)",
        "G0 X1",
        "G0 X5 (cnc: ignore spindle-off, spindel-off)",
        "; cnc: ignore Dwell-Long what",
        "G0 X0",
        "M2",
    ]
    file.write_bytes(end.join(lines).encode("latin-1"))
    found = check(file).warnings
    assert [(each.code, each.line, each.column, each.length) for each in found] == [
        ("ignored-code-unknown", 3, 33, 11),
        ("ignored-code-unknown", 4, 26, 4),
    ]
    assert (found[0].text, found[0].hint) == (lines[2], "did you mean spindle-off?")


def test_comments_far_into_a_long_program(tmp_path, monkeypatch):
    monkeypatch.setattr(selection, "READ_BYTES", 64)
    file = tmp_path / "p.nc"
    file.write_text(
        "G0 X1\n" * 100 + "(cnc: ignore a-b)\n" + "G0 X1\n" * 100 + "G0 X2 ; cnc: ignore c-d"
    )
    assert [(each.line, each.column) for each in unknown_codes(file, "p")] == [(101, 14), (202, 21)]


CIRCLE = ("arc-not-closed", 3, "warning")
DRIFTING = ("arc-radius-drift", 3, "note")


@pytest.mark.parametrize(
    ("arc", "wanted"),
    [
        ("G2 X10 Y0 I5", []),
        ("G2 I5", []),
        ("G3 X10 I5 Z1", []),
        ("G2 X10 Y0.001 I5", [CIRCLE]),  # nearly a full circle
        ("G3 X10 Y0.001 I5", [CIRCLE]),  # nearly nothing
        ("G3 X10 Y0.001 I5 Z-1", [CIRCLE]),
        ("G2 X10 Y0.02 I5", []),
        ("G2 X10.002 Y0.002 R0.01", []),  # a small fillet
        ("G2 X20.0024 Y0 I5", []),
        ("G2 X20.003 Y0 I5", [DRIFTING]),
        ("G18 G2 X20.003 Z0 I5", [DRIFTING]),
        ("G20 G3 X0.78752 Y0 I0.19685", [DRIFTING]),  # 20.003 mm, about 15
        ("G2 X20.003 Y0 I5 (cnc: ignore arc-radius-drift)", []),
    ],
)
def test_arcs_that_do_not_close(found, arc, wanted):
    assert [
        each for each in found(f"G0 X10\n{arc} F600\nM2") if each[0].startswith("arc-")
    ] == wanted


def test_arcs_with_changing_radius_are_reported_once(tmp_path):
    file = tmp_path / "p.nc"
    file.write_text(HEAD + "G2 X10.003 I5 F600\nG2 X20.01 I5\nG2 X20.01 I5\nM2\n")
    (finding,) = check(file).warnings
    assert finding.line == 2
    assert (
        finding.message
        == "the radius changes by up to 0.007 mm along the arc; 2 arcs are cut as a spiral"
    )


@pytest.mark.parametrize(
    ("line", "codes"),
    [
        ("G1 X5", set()),
        ("(cnc: ignore a-b)", {"a-b"}),
        ("G1 (CNC:ignore a-b , c-d e-f) X5", {"a-b", "c-d", "e-f"}),
        ("G1 ; cnc: ignore a-b", {"a-b"}),
        ("(cnc: ignore a) (cnc: ignore b)", {"a", "b"}),
        ("(cnc: ignore)", set()),
        ("(see cnc: ignore a-b)", set()),
        ("", set()),
    ],
)
def test_ignored_codes_of_a_comment(line, codes):
    assert ignored_in(line) == codes


@pytest.mark.usefixtures("one_process")
def test_the_command_line_selects_ignores_and_fails_on(tmp_path, capfd):
    file = tmp_path / "p.nc"
    file.write_text(HEAD + "G1 X5 F9000\nS900 M3\nM2\n")

    def codes(*options: str) -> tuple[int, list[str]]:
        code = cli.exit_code(["check", str(file), "--format", "json", "--quiet", *options])
        out, err = capfd.readouterr()
        assert bool(err) == bool(code)
        return code, [each["code"] for each in json.loads(out)["errors"]]

    assert codes() == (0, ["spindle-off", "feed-unreachable"])
    assert codes("--fail-on", "warning")[0] == codes("--fail-on", "note")[0] == 1
    assert codes("--ignore", "spindle-off", "--fail-on", "warning") == (0, ["feed-unreachable"])
    assert codes("--ignore", "spindle-off,feed-unreachable", "--fail-on", "note") == (0, [])
    assert codes("--select", "spindle-off", "--select", "dwell-long", "--fail-on", "note") == (
        1,
        ["spindle-off"],
    )
    assert cli.exit_code(["check", str(file), "--quiet", "--fail-on", "warning"]) == 1
    assert capfd.readouterr().err.startswith(
        f"{file}:2:1: spindle-off: a feed move with the spindle off\n  G1 X5 F9000\n  ^"
    )
    assert (
        cli.exit_code(
            [
                "check",
                str(file),
                str(file) + "x",
                "--jobs",
                "1",
                "--ignore",
                "spindle-off",
                "--fail-on",
                "note",
            ]
        )
        == 2
    )
    err = capfd.readouterr().err
    assert "note: " in err
    assert "spindle-off" not in err
