"""One program under several dialects: refused lines, and lines that are read differently."""

import json

import pytest

from cnc import cli
from cnc.api import RunOptions, check, check_many
from cnc.model.diagnostics import UsageError

HEAD = "G21 G90 G94\nG0 X5 Y5\n"


@pytest.fixture
def found(tmp_path):
    """Return a function: code, line and message of each fault in a program."""

    def look(text: str, *others: str, dialect: str = "auto") -> list[tuple[str, int, str]]:
        file = tmp_path / "p.nc"
        file.write_text(HEAD + text)
        faults = [
            fault.diagnostic
            for fault in check(file, None, RunOptions(dialect=dialect, portable=others)).faults
        ]
        assert {fault.severity for fault in faults} <= {"error"}
        return [(fault.code, fault.line, fault.message) for fault in faults]

    return look


@pytest.mark.parametrize(
    ("text", "others", "wanted"),
    [
        ("G1 X10 F600\nG2 X20 I5\nM3 S900\nM30", ("grbl", "linuxcnc", "fanuc", "paper"), []),
        ("G1 X10 F600\nM30", (), []),
        # refused: every line, with the dialect's name
        ("G64 P0.01\nG1 X10 F600\nG81 Z-1 R1\nG80\nM30", ("linuxcnc",), []),
        (
            "G64 P0.01\nG1 X10 F600\nG81 Z-1 R1\nM6 T1\nM30",
            ("grbl",),
            [("not-portable", 3, "G64"), ("not-portable", 5, "G81"), ("not-portable", 6, "M6")],
        ),
        (
            "#<a> = 5\nG1 X#<a> F600\nM30",
            ("linuxcnc", "grbl"),
            [("not-portable", 3, "grbl"), ("not-portable", 4, "grbl")],
        ),
        ("G1 X10 F600", ("linuxcnc",), [("not-portable", 3, "linuxcnc")]),  # no end of the program
        # read differently
        (
            "G4 P1500\nM30",
            ("fanuc",),
            [("reads-differently", 3, "dwell, seconds 1.5 in fanuc, 1500 in auto")],
        ),
        (
            "G20 F10\nG1 X1\nM30",
            ("linuxcnc",),
            [("reads-differently", 4, "a feed of 10 mm/min in linuxcnc, 254 mm/min in auto")],
        ),
        (
            "G61\nG1 X10 F600\nM30",
            ("fanuc",),
            [
                (
                    "reads-differently",
                    3,
                    "path mode, control exact-stop in fanuc, exact-path in auto",
                )
            ],
        ),
    ],
)
def test_findings_under_other_dialects(found, text, others, wanted):
    reported = found(text, *others)
    assert [(code, line) for code, line, _ in reported] == [
        (code, line) for code, line, _ in wanted
    ]
    for (_, _, message), (_, _, part) in zip(reported, wanted, strict=True):
        assert part in message


def test_nothing_is_compared_behind_a_different_position(found):
    (only,) = found("G0 Z9\nG81 Z-1 R1 F100\nG0 X9\nG0 X10\nM30", "linuxcnc")
    assert only[:2] == ("reads-differently", 4)
    there, here = (f"a rapid move to (5, 5, {z}) in line 4" for z in (1, 9))
    assert f"{there} in linuxcnc, {here} in auto" in only[2]


def test_a_fault_under_all_dialects_is_reported_once(found):
    reported = found("G1 X10\nG64 P1\nM30", "grbl", "linuxcnc")
    assert [(code, line) for code, line, _ in reported] == [
        ("feed-missing", 3),
        ("not-portable", 4),
    ]
    assert (
        reported[1][2] == "grbl refuses this: G64 is not in the grbl dialect (code-not-in-dialect)"
    )


def test_limit_faults_are_reported_too(found):
    assert [(code, line) for code, line, _ in found("G0 X5000\nG4 P1500\nM30", "fanuc")] == [
        ("soft-limit", 3),
        ("reads-differently", 4),
    ]


@pytest.mark.usefixtures("one_process")
def test_an_unknown_dialect_is_refused(tmp_path):
    with pytest.raises(UsageError, match="unknown-dialect"):
        check(tmp_path / "p.nc", None, RunOptions(portable=("fanuk",)))
    with pytest.raises(UsageError, match="unknown-dialect"):
        list(check_many([tmp_path / "p.nc"], None, RunOptions(portable=("fanuk",)), jobs=1))


@pytest.mark.usefixtures("one_process")
def test_portability_on_the_command_line(tmp_path, capfd):
    for name in "ab":
        (tmp_path / f"{name}.nc").write_text(HEAD + "G64\nG4 P1500\nM30\n")
    for named, options in (
        (str(tmp_path / "a.nc"), ["--portable", "grbl", "--portable", "fanuc"]),
        (str(tmp_path), ["--portable", "grbl,fanuc"]),
    ):
        assert (
            cli.exit_code(["check", named, *options, "--jobs", "1", "--format", "json", "--quiet"])
            == 1
        )
        out = json.loads(capfd.readouterr().out)
        for report in out if isinstance(out, list) else [out]:
            found = [(each["code"], each["line"]) for each in report["errors"]]
            assert found == [("not-portable", 3), ("reads-differently", 4), ("dwell-long", 4)]
            assert report["duration_s"] > 1500
    assert cli.exit_code(["check", str(tmp_path / "a.nc"), "--quiet"]) == 0
    assert cli.exit_code(["check", str(tmp_path / "a.nc"), "--portable", "fanuk"]) == 2
