"""Checks of many programs in parallel: findings, order, faults of workers."""

import io
import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from cnc.api import Control, RunOptions, check, check_many
from cnc.batch import pool
from cnc.cli import progress
from cnc.model.diagnostics import GcodeError, MachineFileError, UsageError
from tests.support.paths import ROOT
from tests.support.soak import share
from tests.support.waiting import HANG, cpu_seconds, wait_until

GOOD = b"G21 G90 G94\nG0 X5 Y5\nG1 X10 F600\nG2 X20 Y5 I5 J0\nM2\n"

BROKEN = [
    ("arc-center-missing", "G2 X5"), ("arc-center-missing", "G17 G2 Z5 F100"),
    ("arc-radius-and-center", "G2 X5 R9 I3"), ("arc-radius-mismatch", "G2 X20 Y5 I5 J9"),
    ("arc-radius-no-chord", "G2 R5"), ("arc-radius-too-small", "G2 X20 R1"),
    ("arctangent-second", "G1 X[ATAN[1]]"), ("argument-out-of-range", "G1 X[SQRT[-1]]"),
    ("argument-out-of-range", "G1 X[LN[0]]"), ("assignment-missing", "#1 5"),
    ("axis-missing", "G1 A5 F5"), ("axis-words-missing", "G92"), ("block-delete-place", "/ / G0"),
    ("block-not-closed", "o1 if [1]"), ("bracket-not-closed", "G1 X[1"), ("channel-missing", "M64"),
    ("character-unknown", "G1 X5 !"), ("code-unknown", "G999"), ("code-unknown", "G28.5"),
    ("code-unknown", "M999"),
    ("cycle-retract-below-bottom", "G81 X5 Z-1 F5 R-5"), ("cycle-word-missing", "G81 X5 Z-1"),
    ("cycle-word-missing", "G83 X1 Z-5 R1 F100"), ("division-by-zero", "G1 X[1/0]"),
    ("dwell-time-missing", "G4"), ("expression-without-brackets", "G1 X0/0 F5"),
    ("feed-missing", "G1 X5"), ("feed-missing", "G93\nG1 X5"), ("feed-missing", "G6.2"),
    ("feed-not-positive", "F-5"), ("function-unknown", "G1 X[SINE[5]]"),
    ("label-missing", "O call"), ("letter-missing", "5 5"), ("line-number-bad", "N-5 G0"),
    ("loop-endless", "o1 while [1]\no1 endwhile"), ("machine-coordinates-motion", "G53 G2 X1 I5"),
    ("modal-conflict", "G0 G1 X5"), ("modal-conflict", "M70 M73"), ("motion-missing", "G80 X5"),
    ("number-malformed", "G1 X5.5.5"), ("number-malformed", "G1 X--5"), ("number-missing", "G1 X"),
    ("number-missing", "G1 X]"), ("number-too-large", "G1 X99999999999999999"),
    ("nurbs-left-early", "G5.2 X1 Y1 L3"), ("operator-unknown", "G1 X[1 PLUS 2]"),
    ("parameter-number-missing", "G1 X#"), ("parameter-read-only", "#5400 = 3"),
    ("parameter-undefined", "G1 X#<nothing>"), ("pitch-missing", "G33 Z5"),
    ("probe-length", "G38.2 X0 Y0 F5"), ("program-number-missing", "M98"),
    ("program-unknown", "M98 P1\nM2\nO2\nM99"), ("soft-limit", "G0 X5000"),
    ("spindle-stopped", "G33.1 Z5 K1"), ("spindle-stopped", "G95\nG1 X5 F1"),
    ("spline-tangent-missing", "G5 X1 Y1"), ("state-not-saved", "M72"),
    ("sub-nested", "o1 sub\no1 sub"), ("sub-not-open", "o1 endsub"),
    ("sub-unknown", "o<nowhere> call"),
    ("thread-plane", "G76"), ("tool-not-chosen", "M61"),
    ("value-out-of-range", "S-5"),
    ("value-out-of-range", "G10 L2 P99 X5"), ("value-out-of-range", "G4 P-1"),
    ("value-out-of-range", "G64 P-1"), ("wait-time-missing", "M66 P1 L3"),
    ("word-repeated", "G1 X5 X6"), ("word-unused", "G21 L5"),
]  # fmt: skip
"""The expected finding, and the faulty line."""


def write_folder(folder: Path, count: int, longest: int, every: int = 1) -> dict[str, str]:
    """Write ``count`` programs, one of ``longest`` lines; return the expected finding of each.

    Args:
        folder: The folder.
        count: The number of programs.
        longest: The number of lines of the longest.
        every: Of the broken lines one in so many is used.
    """
    kinds: list[tuple[str, bytes]] = [
        (code, f"G21 G90 G94\n{line}\nM2\n".encode()) for code, line in BROKEN[::every]
    ]
    long = b"".join(b"G1 X%d.%03d Y%d\n" % (n % 300, n % 1000, n % 200) for n in range(longest))
    kinds += [
        ("", GOOD),
        ("", GOOD.replace(b"\n", b"\r\n")),
        ("", b"\xef\xbb\xbf" + GOOD),
        ("", "(für Müller)\n".encode("latin-1") + GOOD),
        ("", b"%\n" + GOOD + b"%\n"),
        ("", b""),
        ("", b"G21 G90 G64 P0.05 F6000\n" + long),
        ("control-character", bytes(range(256)) * 40),
        ("no-such-file", b""),
    ]
    folder.mkdir()
    wanted = {}
    for number in range(count):
        code, text = kinds[number % len(kinds)]
        if number >= len(kinds) and len(text) > 100_000:
            text = GOOD
        name = folder / f"{number:03d}-{code or 'good'}.nc"
        if code != "no-such-file":
            name.write_bytes(text)
        wanted[str(name)] = code
    return wanted


def lasting(reports: str) -> list[dict]:
    """Return the reports without computing times."""
    return [
        {
            key: value
            for key, value in each.items()
            if key not in ("timing", "lines_per_s", "steps_per_s")
        }
        for each in json.loads(reports)
    ]


def test_two_processes_give_the_findings_of_this_one(cncrun, tmp_path, request):
    wanted = write_folder(
        tmp_path / "shop", share(200, 18), share(3_000_000, 2000), every=share(1, 9)
    )
    found = [cncrun("check", *wanted, "--jobs", "2", "--format", "json")]
    request.getfixturevalue("one_process")
    found.append(cncrun("check", *wanted, "--jobs", "1", "--format", "json"))
    two, here = (lasting(out) for _, out, _ in found)
    assert here == two
    codes = {
        each["program"]: (
            [error["code"] for error in each["errors"] if error["severity"] == "error"] or [""]
        )[0]
        for each in here
    }
    assert {name: code for name, code in codes.items() if code != wanted[name]} == {}
    assert list(codes) == list(wanted)
    assert [code for code, _, _ in found] == [2, 2]  # a file that is not there
    assert found[0][2] == found[1][2]
    assert lasting(json.dumps([check(next(iter(wanted))).as_json()])) == here[:1]


def test_exit_codes_of_many_programs(cncrun, tmp_path):
    """0 for a good program, 1 for a faulty one, 2 for a missing one, with a message at the end."""
    every = share(1, 6)
    wanted = write_folder(tmp_path / "shop", len(BROKEN[::every]) + 9, 1000, every)
    for name, code in wanted.items():
        ended, out, err = cncrun("check", name, "--quiet")
        assert (ended, out) == (2 if code == "no-such-file" else int(bool(code)), ""), name
        faults = [
            line
            for line in err.splitlines()
            if re.match(r"\S.*?: (warning|note): ", line) is None and not line.startswith(" ")
        ]
        assert (f" {code}: " in f" {faults[-1]}") if code else not err, (name, err)
        assert "Traceback" not in err


def test_a_process_that_dies_is_reported_and_no_program_is_lost(tmp_path, monkeypatch):
    """``deadly`` kills its process every time, ``flaky`` the first time only."""
    spoilt = f"""
import os, cnc.batch.task as task
perform = task.Task.perform
def spoilt(self):
    if "deadly" in self.program: os.kill(os.getpid(), 9)
    mark = {str(tmp_path / "mark")!r}
    if "flaky" in self.program and not os.path.exists(mark):
        open(mark, "w").close()
        os._exit(7)
    return perform(self)
task.Task.perform = spoilt
"""
    monkeypatch.setattr(
        pool,
        "START",
        pool.START.replace("from cnc.batch.task", f"exec({spoilt!r}); from cnc.batch.task"),
    )
    names = [
        tmp_path / f"{number}-{kind}.nc"
        for number, kind in enumerate(["good", "deadly", "good", "flaky", "good"])
    ]
    for name in names:
        name.write_bytes(GOOD)
    reports = list(check_many(names, jobs=2))
    assert [report.program for report in reports] == [str(name) for name in names]
    assert [report.ok for report in reports] == [True, False, True, True, True]
    (fault,) = reports[1].faults
    assert fault.diagnostic.code == "worker-died"
    assert fault.diagnostic.message.startswith(
        "the process that checked it was ended by signal 9 ("
    )
    assert reports[1].exit_code == 1


def test_an_internal_error_is_reported_and_the_rest_is_checked(tmp_path, monkeypatch):
    broken = (
        "import cnc.session.program_reader as reader\n"
        "def interpret(text, **_): raise RuntimeError('oh')\n"
        "reader.interpret = interpret"
    )
    monkeypatch.setattr(
        pool,
        "START",
        pool.START.replace("from cnc.batch.task", f"exec({broken!r}); from cnc.batch.task"),
    )
    for name in "ab":
        (tmp_path / f"{name}.nc").write_bytes(GOOD)
    reports = list(check_many([tmp_path / "a.nc", tmp_path / "b.nc"], jobs=1))
    assert [report.faults[0].diagnostic.message for report in reports] == [
        "cncrun failed: RuntimeError: oh"
    ] * 2
    assert [report.exit_code for report in reports] == [1, 1]


def test_usage_errors_are_raised_once(tmp_path, cncrun):
    for name in "ab":
        (tmp_path / f"{name}.nc").write_bytes(GOOD)
    (tmp_path / "tools.tbl").write_text("no tools here\n")
    (tmp_path / "m.toml").write_text(
        "[axes.x]\nsteps_per_mm = 1\nmax_velocity = 5\nmax_acceleration = 1\nmax_jerk = 1\n"
        '[program]\ntool_table = "tools.tbl"\n'
    )
    with pytest.raises(MachineFileError):
        list(check_many([tmp_path / "a.nc", tmp_path / "b.nc"], tmp_path / "m.toml"))
    with pytest.raises(UsageError, match="job-count"):
        list(check_many([tmp_path / "a.nc"], jobs=0))
    assert cncrun("check", str(tmp_path), "--jobs", "0")[0] == 2
    assert cncrun("check", str(tmp_path), "--feed-override", "0")[0] == 2


def test_options_reach_the_workers(tmp_path):
    (tmp_path / "a.nc").write_bytes(b"G21 G90\nG1 X50 F600\nM2\n")
    (found,) = check_many(
        [tmp_path / "a.nc"],
        "paper-nurbs",
        RunOptions(dialect="grbl", feed_override=50, interpolator="sampled"),
        jobs=1,
    )
    alone = check(
        tmp_path / "a.nc",
        "paper-nurbs",
        RunOptions(dialect="grbl", interpolator="sampled"),
        control=Control(50),
    )
    assert lasting(json.dumps([found.as_json()])) == lasting(json.dumps([alone.as_json()]))
    assert found.duration_s == pytest.approx(10.0, rel=0.05)


@pytest.mark.parametrize("form", ["sarif", "junit", "github"])
def test_a_format_uses_standard_output_and_the_rest_standard_error(cncrun, tmp_path, form):
    bad, good = str(tmp_path / "a.nc"), str(tmp_path / "b.nc")
    Path(bad).write_bytes(b"G2 X20 Y5 I5 J9\n")
    Path(good).write_bytes(GOOD)
    code, out, err = cncrun("check", bad, "--format", form)
    assert code == 1
    assert out.startswith({"sarif": "{", "junit": "<?xml", "github": "::error file="}[form])
    assert "arc-radius-mismatch" in out
    assert "arc-radius-mismatch" in err
    code, out, err = cncrun("check", good, "--format", form, "--json", str(tmp_path / "s.json"))
    assert code == 0
    assert "path length" in err
    assert "path length" not in out
    assert json.loads((tmp_path / "s.json").read_text())["ok"]
    assert cncrun("check", good, "--format", form, "--blocks", "-")[0] == 2


@pytest.mark.usefixtures("one_process")
def test_json_uses_standard_output_and_the_lines_standard_error(cncrun, tmp_path):
    write_folder(tmp_path / "shop", 3, 10)
    code, out, err = cncrun("check", "--jobs", "1", str(tmp_path / "shop"), "--format", "sarif")
    assert code == 1
    assert len(json.loads(out)["runs"][0]["results"]) == 3
    assert err.count("1 error\n") == 3


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "cnc.cli", "check", *arguments]


@pytest.mark.skipif(sys.platform != "linux", reason="needs names that are no text")
def test_a_file_name_that_is_not_text(tmp_path):
    for name in b"a.nc", b"caf\xe9.nc":
        (tmp_path / os.fsdecode(name)).write_bytes(GOOD)
    code = (
        "import sys; from cnc import cli\n"
        "for form, name in zip(('text', 'github'), sys.argv[1:]):\n"
        "    print(form, cli.exit_code(['check', name, '--jobs', '1', '--format', form]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path), os.fsencode(tmp_path) + b"/caf\xe9.nc"],
        cwd=ROOT,
        capture_output=True,
        check=False,
    )
    assert (done.returncode, b"Traceback" in done.stderr) == (0, False)
    assert (b"text 0\n" in done.stdout, done.stdout.endswith(b"github 0\n")) == (True, True)


def test_standard_input_is_one_of_many_and_modules_beside_are_not_imported(tmp_path):
    (tmp_path / "a.nc").write_bytes(GOOD)
    (tmp_path / "numpy.py").write_text("raise SystemExit('imported')\n")
    code = f"import sys; sys.path[0] = {str(ROOT)!r}; from cnc.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code, "check", "--jobs", "1", ".", "-"],
        cwd=tmp_path,
        input=GOOD,
        capture_output=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, b"")
    assert [line.split(b": ")[1][:2] for line in done.stdout.splitlines()] == [b"ok", b"ok"]


def children(process: int) -> list[int]:
    """Return the processes that any thread of a process started."""
    return [
        int(each)
        for listed in Path(f"/proc/{process}/task").glob("*/children")
        for each in listed.read_text().split()
    ]


def alive(process: int) -> bool:
    try:
        return "\nState:\tZ" not in Path(f"/proc/{process}/status").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return False


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_workers_end_with_their_parent(tmp_path, how):
    for number in range(50):  # a second each, or more
        (tmp_path / f"{number}.nc").write_bytes(
            b"#1 = 0\no1 while [#1 LT 1000000]\n#1 = [#1 + 1]\no1 endwhile\nM2\n"
        )
    with subprocess.Popen(
        command(str(tmp_path), "--jobs", "2"),
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        wait_until(lambda: len(children(process.pid)) == 2 or process.poll() is not None)
        assert process.poll() is None
        workers = children(process.pid)
        # They have started, and are at a program: a start takes about half of this.
        wait_until(lambda: min(map(cpu_seconds, workers)) > 1.0)
        process.send_signal(how)
        assert process.wait(HANG) == (130 if how != signal.SIGKILL else -9)
        if how != signal.SIGKILL:
            assert (
                process.stderr.read().decode().splitlines()[-1]
                == "stopped by the operator; nothing has moved"
            )
    wait_until(lambda: not any(alive(worker) for worker in workers))


def test_the_bar_counts_programs_on_a_terminal_only(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(progress._ProgressBar, "DELAY", 0.0)
    for quiet, stream in (False, Terminal()), (True, Terminal()), (False, io.StringIO()):
        monkeypatch.setattr(sys, "stderr", stream)
        with progress.ProgressDisplay(Control(), quiet=quiet) as shown:
            shown.count(3, 7)
        assert ("3 of 7 programs" in stream.getvalue()) == (stream.isatty() and not quiet)


def test_the_algorithm_reaches_every_program_and_faults_keep_their_type(tmp_path: Path) -> None:
    """A line of slope 1/2 has fewer rows by half steps than by comparing point by point."""
    (tmp_path / "a.nc").write_bytes(b"G2 X20 Y5 I5 J9\n")
    faulty = [str(tmp_path / "a.nc"), str(tmp_path / "b.nc")]
    programs = []
    for number in range(2):
        programs.append(str(tmp_path / f"{number}.nc"))
        Path(programs[-1]).write_text("G21 G90 G1 X1 Y0.5 F600\nM2\n")
    options = RunOptions(algorithm="half-step")
    *good, bad, missing = check_many([*programs, *faulty], None, options, jobs=1)
    assert [report.pulse_rows for report in good] == [200] * 2
    assert type(bad.faults[0]) is GcodeError
    assert type(missing.faults[0]) is UsageError
    assert (bad.exit_code, missing.exit_code) == (1, 2)
    assert bad.faults[0].diagnostic == check(faulty[0]).faults[0].diagnostic
    other = RunOptions(algorithm="point-by-point")
    assert check(programs[0], None, other).pulse_rows == 300
