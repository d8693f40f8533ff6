"""A check with a baseline: changes, new findings, and the exit code by new findings alone."""

import json
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cnc import cli
from cnc.checks.baseline import Baseline
from cnc.machine.load import load_machine
from cnc.model.diagnostics import Diagnostic, GcodeError, UsageError
from cnc.report.findings import github, junit, sarif
from cnc.report.result import Report

MACHINE = load_machine("default")
HEAD = "G21 G90 G94 G61\n"


def limit(line: int, message: str = "X would reach 500 mm") -> Diagnostic:
    return Diagnostic("soft-limit", message, "p.nc", line)


def hint(line: int, code: str = "spindle-off", message: str = "off") -> Diagnostic:
    return Diagnostic(code, message, "p.nc", line, severity="warning")


def report(*findings: Diagnostic, name: str = "p.nc", **figures) -> Report:
    faults = [GcodeError(each) for each in findings if each.severity == "error"]
    return Report(
        name,
        MACHINE,
        faults=faults,
        warnings=[each for each in findings if each.severity != "error"],
        **figures,
    )


@pytest.fixture
def compare(tmp_path):
    """Return a function: the changes between two reports."""

    def look(then: Report | list[Report], now: Report):
        file = tmp_path / "old.json"
        file.write_text(
            json.dumps(
                [each.as_json() for each in then] if isinstance(then, list) else then.as_json()
            )
        )
        now.changes = Baseline(str(file)).changes(now)
        return now.changes

    return look


@pytest.mark.parametrize(
    ("then", "now", "new", "gone"),
    [
        ([], [], [], []),
        ([limit(3)], [limit(3)], [], []),
        ([limit(3)], [limit(7)], [], []),  # lines were put in before
        ([limit(3)], [limit(3, "X would reach 600 mm")], [], []),  # the same line, mended in part
        ([limit(3)], [limit(7, "X would reach 600 mm")], [7], [3]),
        ([limit(3)], [limit(3), limit(7)], [7], []),
        ([limit(3)], [limit(2), limit(3)], [2], []),
        ([limit(3), limit(4)], [limit(9)], [], [4]),
        ([hint(3)], [limit(3)], [3], [3]),
        ([hint(3, "move-below-step", "5 moves")], [hint(9, "move-below-step", "7 moves")], [], []),
        ([hint(3, "spindle-off", "5 moves")], [hint(9, "spindle-off", "7 moves")], [9], [3]),
    ],
)
def test_new_and_gone_findings(compare, then, now, new, gone):
    changes = compare(report(*then), report(*now))
    assert [each.line for each in changes.new] == new
    assert [each.line for each in changes.gone] == gone


FINDINGS = st.lists(
    st.builds(
        Diagnostic,
        st.sampled_from(["soft-limit", "spindle-off", "move-below-step"]),
        st.sampled_from(["a", "b"]),
        st.sampled_from(["p.nc", "sub.nc"]),
        st.integers(1, 4),
        severity=st.sampled_from(["error", "warning"]),
    ),
    max_size=8,
)


@given(FINDINGS, FINDINGS)
def test_every_finding_is_matched_at_most_once(tmp_path_factory, then, now):
    file = tmp_path_factory.mktemp("old") / "old.json"
    file.write_text(json.dumps(report(*then).as_json()))
    this = report(*now)
    changes = Baseline(str(file)).changes(this)
    assert Counter(map(id, [*changes.new, *changes.kept])) == Counter(map(id, this.findings))
    assert len(changes.kept) + len(changes.gone) == len(then)
    key = lambda found: (found.code, found.message, found.file, found.line)  # noqa: E731
    missed = Counter(map(key, this.findings)) - Counter(map(key, then))
    assert len(changes.new) <= missed.total()
    # a finding more than before is new, however they are paired
    for code in {found.code for found in now}:
        more = sum(found.code == code for found in now) - sum(found.code == code for found in then)
        assert sum(found.code == code for found in changes.new) >= more
    same = Baseline(str(file)).changes(report(*then))
    assert (same.new, same.gone) == ([], [])


def test_changed_time_and_extent(compare):
    extent = {"x": (0.0, 10.0), "y": (0.0, 1.0)}
    then = report(duration_s=10.0, path_length_mm=100.0, bounding_box=extent)
    assert (
        compare(
            then, report(duration_s=10.0 + 1e-9, path_length_mm=100.0, bounding_box=dict(extent))
        ).lines()
        == []
    )
    changes = compare(
        then,
        report(
            duration_s=12.5, path_length_mm=100.0, bounding_box={"x": (-1.0, 10.0), "z": (0.0, 0.5)}
        ),
    )
    assert changes.lines() == [
        "time: 10.000 s -> 12.500 s (+25.0 %)",
        "X: 0 .. 10 -> -1 .. 10",
        "Y: 0 .. 1 -> none",
        "Z: none -> 0 .. 0.5",
    ]
    assert changes.as_model().model_dump(exclude_unset=True) == {
        "known": True,
        "new": [],
        "gone": [],
        "duration_s": [10.0, 12.5],
        "bounding_box": {
            "x": [[0.0, 10.0], [-1.0, 10.0]],
            "y": [[0.0, 1.0], None],
            "z": [None, [0.0, 0.5]],
        },
    }
    # a program that was rejected has no time to compare
    assert compare(then, report(limit(3))).lines() == [
        "new: error 3: soft-limit: X would reach 500 mm"
    ]


def test_programs_are_matched_by_their_paths(compare, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    then = [report(limit(3), name="./a/p.nc"), report(name=str(tmp_path / "q.nc"))]
    assert compare(then, report(limit(3), name="a/p.nc")).new == []
    assert compare(then, report(limit(3), name="q.nc")).known
    other = compare(then, report(limit(3), name="b/p.nc"))
    assert (other.known, len(other.new), other.lines()) == (False, 1, ["not in the baseline"])
    assert Baseline(str(tmp_path / "old.json")).missing([report(name="a/p.nc")]) == [
        str(tmp_path / "q.nc")
    ]


def test_only_new_faults_count(compare):
    now = report(limit(3), hint(4))
    assert now.exit_code == 1
    compare(report(limit(9)), now)
    assert (now.exit_code, [each.line for each in now.counting]) == (0, [4])
    compare(report(), now)
    assert now.exit_code == 1


def test_formats_mark_new_findings(compare):
    now = report(limit(3), limit(4, "Y would reach 1 mm"), hint(5))
    compare(report(limit(3), hint(8, "dwell-long")), now)
    results = json.loads(sarif([now]))["runs"][0]["results"]
    states = {
        (each["ruleId"], each["locations"][0]["physicalLocation"]["region"]["startLine"]): each[
            "baselineState"
        ]
        for each in results
    }
    assert states == {
        ("soft-limit", 3): "unchanged",
        ("soft-limit", 4): "new",
        ("spindle-off", 5): "new",
        ("dwell-long", 8): "absent",
    }
    assert [line.partition(" ")[0] for line in github([now]).splitlines()] == [
        "::error",
        "::warning",
    ]
    text = junit([now])
    assert "Y would reach" in text
    assert "X would reach" not in text
    compare(report(limit(3), limit(4, "Y would reach 1 mm"), hint(5)), now)
    assert (github([now]), "failure" in junit([now]).replace("failures", "")) == ("", False)


@pytest.mark.parametrize(
    "text", ["", "{", "3", "[3]", "{}", '{"program": "p.nc"}', "[" * 100_000, "\x00", "null"]
)
def test_an_unreadable_baseline_is_refused(tmp_path, text, capfd):
    file = tmp_path / "old.json"
    file.write_text(text)
    with pytest.raises(UsageError, match="baseline-unreadable"):
        Baseline(str(file))
    (tmp_path / "p.nc").write_text(HEAD + "M2\n")
    assert cli.exit_code(["check", str(tmp_path / "p.nc"), "--baseline", str(file)]) == 2
    assert "Traceback" not in capfd.readouterr().err


@pytest.mark.usefixtures("one_process")
def test_baseline_on_the_command_line(tmp_path, capfd, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def write(name: str, text: str) -> None:
        (tmp_path / name).write_text(HEAD + text + "M2\n")

    def carry_out(*arguments: str) -> tuple[int, str, str]:
        code = cli.exit_code(["check", "--jobs", "1", *arguments])
        return code, *capfd.readouterr()

    write("a.nc", "G1 X10 F600\n")
    write("b.nc", "G0 X9999\n")
    assert carry_out(".", "--json", "old.js", "--quiet")[0] == 1
    code, out, err = carry_out(".", "--baseline", "old.js")
    assert (code, out.splitlines()[-1], err) == (0, "2 programs unchanged since the baseline", "")
    assert carry_out("b.nc", "--baseline", "old.js")[0] == 0
    write("a.nc", "G1 X10 F600\nG1 X11\nG1 X9999\n")
    code, out, err = carry_out(".", "--baseline", "old.js", "--json", "new.js")
    assert code == 1
    assert "a.nc, since the baseline:\n  new: error 4: soft-limit: X would reach 9999 mm" in out
    assert err.startswith("a.nc:4:4: soft-limit")
    assert "b.nc:" not in err
    assert [each["changes"]["known"] for each in json.loads((tmp_path / "new.js").read_text())] == [
        True,
        True,
    ]
    write("a.nc", "S9 M3\nM5\nG1 X20 F600\n")
    assert carry_out("a.nc", "--baseline", "old.js", "--fail-on", "warning")[0] == 1
    code, out, err = carry_out("a.nc", "--baseline", "old.js")
    assert (
        code,
        "X: 0 .. 10 -> 0 .. 20" in out,
        "b.nc: in the baseline, but not checked now" in out,
    ) == (0, True, True)
    assert carry_out("a.nc", "--baseline", "nowhere.js")[0] == 2
    assert carry_out("a.nc", "--baseline", "old.js", "--json", "old.js")[0] == 2
    # without a baseline there are no changes to report
    carry_out("a.nc", "--json", "new.js")
    assert "changes" not in json.loads((tmp_path / "new.js").read_text())
