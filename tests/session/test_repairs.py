"""Repairs of findings: their form, their proof, and ``cncrun check --fix``."""

from __future__ import annotations

import json
import random
import re
from collections.abc import Callable
from itertools import cycle, product
from pathlib import Path

import pytest

from cnc import parse
from cnc.cli import exit_code
from cnc.machine.load import load_machine
from cnc.model.diagnostics import CncError, Fix
from cnc.session import repairs
from cnc.session.options import RunOptions
from cnc.session.repairs import Repaired, read, repaired
from tests.session.test_rewriting import moves
from tests.support.corpus import EXPECTED, STYLES
from tests.support.soak import share

MACHINE = load_machine(None)
REPAIRS = [
    # code, dialect, program, repaired; safe
    ("decimal-point-missing", "fanuc", "O1\nG0 X10 Y0 Z-.5\nX3 R2\nG4 P500\nM30",
     "O1\nG0 X10. Y0 Z-.5\nX3. R2.\nG4 P500\nM30", True),
    ("comment-mended", "auto", "G21 (a (b) c)\nG0 X1.\nM2", "G21 (a [b] c)\nG0 X1.\nM2", True),
    ("comment-mended", "auto", "G21 (open (x\nG0 X1.\nM2", "G21 (open [x)\nG0 X1.\nM2", True),
    ("comment-mended", "auto", "G0 X1. // note\nM2", "G0 X1. ;/ note\nM2", True),
    ("motion-assumed", "auto", "G21 G90\nX1. Y2.\nM2", "G21 G90\nG0 X1. Y2.\nM2", True),
    ("word-without-effect", "linuxcnc", "G0 X1 F500\nM2", "G0 X1\nM2", True),
    ("word-without-effect", "linuxcnc", "F500 G0 X1\nM2", "G0 X1\nM2", True),
    ("comment-nested", "linuxcnc", "G0 X1 (a (b) c)\nM2", "G0 X1 (a [b] c)\nM2", False),
    ("comment-not-closed", "linuxcnc", "G0 X1 (a\nM2", "G0 X1 (a)\nM2", False),
    ("comment-mark", "linuxcnc", "# Laser\nM2", "; Laser\nM2", False),
    ("number-exponent", "linuxcnc", "G0 X-8.75e-05\nM2", "G0 X-0.0000875\nM2", False),
    ("program-end-missing", "linuxcnc", "G0 X1\n\n", "G0 X1\nM30\n\n", False),
    ("program-end-missing", "linuxcnc", "%\nG0 X1", "%\nG0 X1\n%", False),
    ("letter-missing", "fanuc", "01234 (PART)\nM30", "O1234 (PART)\nM30", False),
    ("line-checksum", "linuxcnc", "N1 G0 X1*45\nM2", "N1 G0 X1\nM2", False),
    ("modal-conflict", "linuxcnc", "G90 G21 G90\nM2", "G90 G21 \nM2", False),
    ("equals-place", "linuxcnc", "#1=[2=3]\nM2", "#1=[2EQ3]\nM2", False),
    ("operator-unknown", "linuxcnc", "#1=[2 < 3]\nM2", "#1=[2 LT 3]\nM2", False),
    ("character-unknown", "linuxcnc", "G0 X\N{MINUS SIGN}1\nM2", "G0 X-1\nM2", False),
    ("character-unknown", "linuxcnc", "G0\N{NO-BREAK SPACE}X1\nM2", "G0 X1\nM2", False),
    ("character-unknown", "linuxcnc", "G0\N{ZERO WIDTH SPACE} X1\nM2", "G0 X1\nM2", False),
    ("character-unknown", "linuxcnc", "G0 X1,5\nM2", "G0 X1.5\nM2", False),
]  # fmt: skip
LEFT = [
    # A second repair is as likely, or the blocks would be others.
    ("linuxcnc", "#1=[2 <= 3]\nM2"),
    ("linuxcnc", "#1=[2 << 3]\nM2"),
    ("fanuc", "O1\nG91 G28 Z0. G90\nM30"),
    ("fanuc", "O1\nG0 X1. X2.\nM30"),
    ("linuxcnc", "G0 X1) Y2\nM2"),
]


def repair(text: str, dialect: str, *, unsafe: bool) -> Repaired:
    options = RunOptions(dialect=dialect)  # type: ignore[arg-type]
    return repaired("a.nc", text.encode(), MACHINE, options, unsafe=unsafe)


@pytest.mark.parametrize(("code", "dialect", "text", "wanted", "safe"), REPAIRS)
def test_a_finding_is_repaired(
    code: str, dialect: str, text: str, wanted: str, *, safe: bool
) -> None:
    kept = repair(text, dialect, unsafe=False)
    assert kept.new.decode() == (wanted if safe else text)
    result = repair(text, dialect, unsafe=True)
    assert result.new.decode() == wanted
    assert {applied.finding.code for applied in result.applied} == {code}
    assert repair(wanted, dialect, unsafe=True).applied == []


@pytest.mark.parametrize(("dialect", "text"), LEFT)
def test_a_finding_without_one_right_repair_is_left(dialect: str, text: str) -> None:
    assert repair(text, dialect, unsafe=True).new.decode() == text


def test_two_errors_of_a_line_are_repaired_in_turn() -> None:
    result = repair("G0 X\u22121 Y\u22122 (open\nM2", "linuxcnc", unsafe=True)
    assert result.new.decode() == "G0 X-1 Y-2 (open)\nM2"


def test_errors_are_repaired_in_the_order_of_execution() -> None:
    """The subprogram is executed before the line of the main program behind its call."""
    text = "O1\nM98 P2\nG0 X\u22121.\nM30\nO2\nG0 Y\u22122.\nM99\n"
    result = repair(text, "fanuc", unsafe=True)
    assert result.new.decode() == text.replace("\u2212", "-")


def test_line_ends_byte_order_mark_and_bytes_that_are_not_utf8_stay() -> None:
    text = b"\xef\xbb\xbfG21 (a (b))\r\n(Stra\xdfe (x)\r\nG0 X1.\r\nM2\r\n"
    result = repaired("a.nc", text, MACHINE, RunOptions(), unsafe=False)
    wanted = b"\xef\xbb\xbfG21 (a [b])\r\n(Stra\xdfe [x)\r\nG0 X1.\r\nM2\r\n"
    assert result.new == wanted


def test_a_safe_repair_whose_blocks_differ_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """The second of two repairs would move elsewhere; the first one is made."""
    read_as_it_is = repairs.read

    def with_a_wrong_fix(*args: object) -> repairs.Reading:
        reading = read_as_it_is(*args)  # type: ignore[arg-type]
        wrong = Fix.replace("move elsewhere", 5, 1, "9", safe=True)
        findings = [
            repairs.replace(finding, fix=wrong) if finding.code == "motion-assumed" else finding
            for finding in reading.findings
        ]
        return reading._replace(findings=findings)

    monkeypatch.setattr(repairs, "read", with_a_wrong_fix)
    result = repair("G21 (a (b))\nX1. Y2.\nM2", "auto", unsafe=False)
    assert result.new.decode() == "G21 (a [b])\nX1. Y2.\nM2"


BREAKS: dict[str, tuple[Callable[[str], str], str]] = {
    "open comment": (lambda line: re.sub(r"\)$", "", line), r"^[^()]*\([^()]*\)$"),
    "nested comment": (lambda line: line.replace("(", "(a (b) "), r"\([^()]*\)"),
    "whole numbers": (lambda line: re.sub(r"([XYZ]-?[0-9]+)\.0*(?![0-9])", r"\1", line), "[XYZ]"),
    "minus sign": (lambda line: line.replace("-", "\u2212", 1), r"^[^(;]*[XYZ]-[0-9.]+"),
    "feed at the end": (lambda line: f"F321 {line}", "M0?2$|M30$"),
}


def _options(dialect: str) -> RunOptions:
    return RunOptions(dialect=dialect, unknown_codes="warn", tool_lengths="zero")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("style", "kind"),
    share(list(product(sorted(STYLES), BREAKS)), list(zip(sorted(STYLES)[::2], cycle(BREAKS)))),
)
def test_a_repaired_program_of_the_corpus_is_without_the_finding(style: str, kind: str) -> None:
    """Each line that can be broken is broken with chance one half."""
    change, pattern = BREAKS[kind]
    for seed in range(share(6, 1)):
        rng = random.Random(f"{style} {kind} {seed}")
        lines = STYLES[style](random.Random(f"{style} {seed}")).split("\n")
        broken = [
            change(line) if re.search(pattern, line) and rng.random() < 0.5 else line
            for line in lines
        ]
        dialect = EXPECTED[style] if seed % 2 else "auto"
        options = _options(dialect)
        text = "\n".join(broken).encode()
        before = read("a.nc", text, MACHINE, options)
        for unsafe in (False, True):
            result = repaired("a.nc", text, MACHINE, options, unsafe=unsafe)
            after = read("a.nc", result.new, MACHINE, options)
            assert [f for f in after.findings if f.fix and (unsafe or f.fix.safe)] == []
            made = {(item.finding.code, item.finding.line) for item in result.applied}
            assert not made & {(finding.code, finding.line) for finding in after.findings}
            again = repaired("a.nc", result.new, MACHINE, options, unsafe=unsafe)
            assert again.applied == []
            if all(item.finding.fix and item.finding.fix.safe for item in result.applied):
                assert after.blocks == before.blocks
                assert after.end == before.end


def test_check_fix_writes_the_program_and_shows_each_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "a.nc"
    file.write_text("G21 (a (b))\nX1. Y2.\nM2\n")
    file.chmod(0o640)
    before = moves(list(parse(str(file))))
    assert exit_code(["check", str(file), "--diff"]) == 1
    shown = capsys.readouterr().out
    assert file.read_text() == "G21 (a (b))\nX1. Y2.\nM2\n"
    assert f"{file}:2:1: motion-assumed: write G0\n  - X1. Y2.\n  + G0 X1. Y2.\n" in shown
    assert exit_code(["check", str(file), "--fix"]) == 0
    assert shown.replace("to make", "made") in capsys.readouterr().out
    assert file.read_text() == "G21 (a [b])\nG0 X1. Y2.\nM2\n"
    assert file.stat().st_mode & 0o777 == 0o640
    assert moves(list(parse(str(file)))) == before
    assert exit_code(["check", str(file), "--diff"]) == 0
    assert "repair" not in capsys.readouterr().out


def test_the_exit_code_says_what_remains(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "a.nc"
    file.write_text("G0 X1 (open\nM2\n")
    given = ["check", str(file), "--dialect", "linuxcnc"]
    assert exit_code(given) == 1
    assert "1 finding can be repaired with --fix --unsafe-fixes" in capsys.readouterr().out
    assert exit_code([*given, "--fix"]) == 1
    assert exit_code([*given, "--fix", "--unsafe-fixes"]) == 0
    assert file.read_text() == "G0 X1 (open)\nM2\n"
    assert exit_code(["check", str(file), "--unsafe-fixes"]) == 2
    assert exit_code(["check", "-", "--fix"]) == 2


def test_ignored_findings_are_not_repaired(tmp_path: Path) -> None:
    file = tmp_path / "a.nc"
    text = "G21 (a (b))\nX1. Y2.\nM2\n"
    file.write_text(text)
    codes = "motion-assumed,comment-mended"
    assert exit_code(["check", str(file), "--fix", "--ignore", codes]) == 0
    assert file.read_text() == text


def test_sarif_and_json_have_the_repairs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "a.nc"
    file.write_text("G21\nX1. Y2.\nM2\n")
    assert exit_code(["check", str(file), "--format", "sarif"]) == 0
    (run,) = json.loads(capsys.readouterr().out)["runs"]
    (fix,) = next(r for r in run["results"] if r["ruleId"] == "motion-assumed")["fixes"]
    (change,) = fix["artifactChanges"]
    assert change["replacements"] == [
        {
            "deletedRegion": {"startLine": 2, "startColumn": 1, "endColumn": 1},
            "insertedContent": {"text": "G0 "},
        }
    ]
    assert exit_code(["check", str(file), "--format", "json"]) == 0
    listed = json.loads(capsys.readouterr().out)["errors"]
    (found,) = [entry["fix"] for entry in listed if entry["code"] == "motion-assumed"]
    edits = [{"line": 2, "column": 1, "length": 0, "text": "G0 "}]
    assert found == {"title": "write G0", "safe": True, "edits": edits}


def test_repairs_do_not_stand_among_the_findings_for_other_tools(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.nc").write_text("G21\nX1. Y2.\nM2\n")
    (tmp_path / "b.nc").write_text("G21 (a (b))\nG0 X1.\nM2\n")
    assert exit_code(["check", str(tmp_path), "--fix", "--format", "json"]) == 0
    out, err = capsys.readouterr()
    assert [entry["ok"] for entry in json.loads(out)] == [True, True]
    assert "+ G0 X1. Y2." in err
    assert (tmp_path / "b.nc").read_text() == "G21 (a [b])\nG0 X1.\nM2\n"


def test_an_error_of_another_file_is_not_repaired(tmp_path: Path) -> None:
    (tmp_path / "sub.ngc").write_text("o<sub> sub\nG0 X1 (open\no<sub> endsub\nM2\n")
    text = b"o<sub> call\nM2\n"
    options = RunOptions(dialect="linuxcnc")
    result = repaired(str(tmp_path / "a.ngc"), text, MACHINE, options, unsafe=True)
    assert result.new == text
    with pytest.raises(CncError, match="comment-not-closed"):
        list(parse(_file(tmp_path, text), dialect="linuxcnc"))


def _file(folder: Path, text: bytes) -> str:
    file = folder / "a.ngc"
    file.write_bytes(text)
    return str(file)
