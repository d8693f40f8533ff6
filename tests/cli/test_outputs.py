"""The command line: outputs of one and of many programs."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.support.cli.messages import last_message
from tests.support.paths import ROOT
from tests.support.soak import share

GOOD = "G21 G90 G94\nG0 X5 Y5\nG1 X10 F600\nG2 X20 Y5 I5 J0\nM2\n"


def test_every_output(cncrun, program, tmp_path):
    names = {
        kind: str(tmp_path / name)
        for kind, name in [
            ("blocks", "b.jsonl"),
            ("trace", "t.npz"),
            ("pulses", "p.npz"),
            ("json", "s.json"),
        ]
    }
    options = [word for kind, name in names.items() for word in (f"--{kind}", name)]
    for command in ([], ["check"]):
        assert cncrun(*command, program(GOOD), "--quiet", *options) == (0, "", "")
        blocks = [json.loads(line) for line in Path(names["blocks"]).read_text().splitlines()]
        assert [(block["line"], block["kind"]) for block in blocks] == [
            (2, "traverse"),
            (3, "line"),
            (4, "arc"),
            (5, "end"),
        ]
        summary = json.loads(Path(names["json"]).read_text())
        with np.load(names["trace"]) as trace, np.load(names["pulses"]) as pulses:
            assert trace["position"][-1] == pytest.approx([20, 5, 0], abs=1e-9)
            assert trace["t"][-2] <= summary["duration_s"] <= trace["t"][-1]
            assert trace["s"][-1] == pytest.approx(summary["path_length_mm"], abs=1e-9)
            made = np.abs(pulses["step"].astype(int)).sum(axis=0)
            assert (
                dict(zip(pulses["axes"].tolist(), made.tolist(), strict=True)) == summary["steps"]
            )
            end = pulses["origin_steps"] + pulses["step"].sum(axis=0)
            assert (end / pulses["steps_per_mm"]).tolist() == [20.0, 5.0, 0.0]
        assert (summary["lines"], summary["blocks"], summary["errors"]) == (5, 4, [])
        assert summary["end_position"] == {"x": 20.0, "y": 5.0, "z": 0.0}
        assert summary["bounding_box"]["y"] == pytest.approx([0.0, 10.0])
        for name in names.values():
            os.unlink(name)


def test_the_other_formats(cncrun, program, tmp_path):
    csv, vcd = tmp_path / "t.csv", tmp_path / "p.vcd"
    assert cncrun(program(GOOD), "--quiet", "--trace", str(csv), "--pulses", str(vcd))[0] == 0
    assert csv.read_text().startswith("t,x,y,z,s,feed,accel,jerk,line\n0.0,")
    assert vcd.read_text().startswith("$timescale 1 ns $end\n")


def test_a_hyphen_is_standard_output_and_the_summary_uses_standard_error(cncrun, program):
    code, out, err = cncrun("check", program(GOOD), "--json", "-")
    assert code == 0
    assert json.loads(out)["program"].endswith("p.nc")
    assert "path length" in err
    _, out, _ = cncrun(program(GOOD), "--blocks", "-")
    assert [json.loads(line)["kind"] for line in out.splitlines()] == [
        "traverse",
        "line",
        "arc",
        "end",
    ]


@pytest.mark.parametrize("command", share([("-",), ("check", "-")], [("check", "-")]))
def test_a_hyphen_is_standard_input(command):
    line = [sys.executable, "-m", "cnc.cli", *command, "--quiet", "--blocks", "-"]
    done = subprocess.run(line, cwd=ROOT, input=GOOD, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert len(done.stdout.splitlines()) == 4


def test_a_faulty_program_writes_only_its_errors(cncrun, program, tmp_path):
    file = program("G21 G90\nG1 X10 F600\nG2 X20 Y5 I5 J9\nM2\n")
    target = tmp_path / "out"
    target.mkdir()
    names = {"blocks": "b.jsonl", "trace": "t.npz", "pulses": "p.vcd", "json": "s.json"}
    code, _, _ = cncrun(
        file, *[word for kind, name in names.items() for word in (f"--{kind}", str(target / name))]
    )
    assert code == 1
    assert os.listdir(target) == ["s.json"]
    (error,) = json.loads((target / "s.json").read_text())["errors"]
    assert (error["code"], error["line"], error["severity"]) == ("arc-radius-mismatch", 3, "error")
    assert error["column"] > 0


def test_the_file_board_writes_pulses(cncrun, program, tmp_path):
    target = tmp_path / "board.npz"
    assert cncrun(program(GOOD), "--quiet", "--board", "file", "--port", str(target)) == (0, "", "")
    with np.load(target) as found:
        assert found["step"].sum(axis=0).tolist() == [4000, 1000, 0]


@pytest.mark.usefixtures("one_process")
def test_many_programs_one_broken(cncrun, program, tmp_path):
    program(GOOD, "shop/b.nc")
    program("G1 X1 F\n", "shop/a.nc")
    program(GOOD, "shop/deep/c.NGC")
    program("no program", "shop/readme.txt")
    last = program(GOOD, "z.nc")
    code, out, err = cncrun("check", "--jobs", "1", str(tmp_path / "shop"), last, last)
    assert code == 1
    assert [line.split(": ")[0] for line in out.splitlines()] == [
        *(str(tmp_path / "shop" / name) for name in ("a.nc", "b.nc", "deep/c.NGC")),
        last,
    ]
    assert last_message(err, "number-missing").startswith(str(tmp_path / "shop/a.nc") + ":1:")
    code, out, _ = cncrun(
        "check", "--jobs", "1", str(tmp_path / "**" / "*.nc"), "--format", "json", "--quiet"
    )
    assert [Path(each["program"]).name for each in json.loads(out)] == ["a.nc", "b.nc", "z.nc"]
    assert code == 1


def test_one_program_as_json(cncrun, program):
    _, out, _ = cncrun("check", program(GOOD), "--format", "json", "--quiet")
    assert json.loads(out)["ok"]
