"""The log: silent by default, stages with -v, and each line of the link with --log."""

from __future__ import annotations

import logging
import re
import subprocess
import sys
from pathlib import Path

import pytest

from cnc import api, cli
from cnc.api import Callbacks, Control, load_machine
from cnc.boards.grbl.driver import GrblBoard
from cnc.boards.port import LoggedPort
from cnc.boards.stepper.driver import Stepper
from cnc.session.run_pulses import Progress
from cnc.simulators.grbl.grbl_simulator import Alarm, GrblSimulator
from cnc.simulators.grbl.ports import GrblSimulatorPort
from tests.support.boards.stepper_rig import machine as stepper_machine
from tests.support.boards.stepper_simulator import Simulator, SimulatorPort
from tests.support.session.runs import run_with
from tests.support.soak import share

GRBL = load_machine("grbl-uno")
PROGRAM = "G21 G90\nG1 X5 F600\nG1 X0 Y3\nM2\n"


@pytest.fixture
def program(tmp_path: Path) -> Path:
    file = tmp_path / "p.nc"
    file.write_text(PROGRAM)
    return file


def run_on_simulator(simulator: GrblSimulator, program: Path, **more: object) -> api.Report:
    port = GrblSimulatorPort(simulator)
    board = GrblBoard(port, GRBL, port.clock, "port A")
    board.connect()
    try:
        return run_with(program, GRBL, board=board, **more)  # type: ignore[arg-type]
    finally:
        board.close()


def in_order(text: str, *patterns: str) -> bool:
    """Whether each pattern is found after the one before."""
    begin = 0
    for pattern in patterns:
        found = re.compile(pattern).search(text, begin)
        if found is None:
            return False
        begin = found.end()
    return True


def test_the_library_and_the_command_are_silent_by_default(program: Path) -> None:
    bad = program.with_name("bad.nc")
    bad.write_text("G1 X99999\n")
    code = f"from cnc import check; check({str(program)!r}); check({str(bad)!r})"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (shown.stdout, shown.stderr) == ("", "")


def test_the_log_file_has_stages_and_each_line_of_the_link(
    program: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "run.log"
    options = ["--machine", "grbl-uno", "--board", "grbl-sim", "--quiet", "--log", str(log)]
    assert cli.exit_code([str(program), *options]) == 0
    assert capfd.readouterr() == ("", "")
    text = log.read_text()
    assert in_order(
        text,
        r"INFO +cnc\.cli\.messages: cncrun \S+, Python 3",
        r"DEBUG +cnc\.boards\.grbl\.link: .* -> \$\$",
        r"DEBUG +cnc\.boards\.grbl\.link: .* <- \$110=\d",
        r"INFO +cnc\.session\.session: machine .*GRBL.*, board grbl-sim, dialect auto",
        r"INFO +cnc\.session\.session: check pass: 4 lines, .* reading \d\.\d{3} s",
        r"INFO +cnc\.session\.session: motion begins",
        r"-> G1 ?X5",
        r"<- ok",
        r"<- <(Run|Idle)\|MPos:",
        r"INFO +cnc\.session\.session: run pass: .* s; planning",
        r"INFO +cnc\.session\.session: end: 0 faults, 0 warnings",
    ), text
    assert all(
        re.match(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d{3} ", line)
        for line in text.split("\n")
        if line
    )
    assert not [each for each in logging.getLogger("cnc").handlers if each.level], "it is closed"


def test_a_fault_of_the_board_can_be_understood_from_the_log(
    program: Path, caplog: pytest.LogCaptureFixture
) -> None:
    simulator = GrblSimulator()
    caplog.set_level(logging.DEBUG, "cnc")

    simulator.inject(Alarm(1), time=simulator.now + 3.0)
    report = run_on_simulator(simulator, program)
    text = "\n".join(record.getMessage() for record in caplog.records)
    (fault,) = report.faults
    assert in_order(
        text,
        "port A -> G1 ?X5",
        "port A <- ALARM:1",
        "port A: alarm 1",
        f"{fault.diagnostic.code}: .*{re.escape(fault.diagnostic.message)}",
    ), text


def test_requests_of_the_operator_are_in_the_log(
    program: Path, caplog: pytest.LogCaptureFixture
) -> None:
    control, simulator = Control(), GrblSimulator()
    requests = iter([lambda: control.override(150.0), control.hold, control.resume, control.stop])
    caplog.set_level(logging.INFO, "cnc")

    def on_sent(sent: Progress) -> None:
        if sent.position is not None and sent.position[0] > 0.5:
            request = next(requests, None)
            if request is not None:
                request()

    run_on_simulator(simulator, program, control=control, callbacks=Callbacks(on_sent=on_sent))
    text = "\n".join(record.getMessage() for record in caplog.records)
    assert in_order(
        text,
        "motion begins",
        "operator: feed override 150 %",
        "operator: hold",
        "operator: resume",
        "operator: stop",
        r"stopped at line \d",
    ), text


def test_frames_and_status_of_a_stepper_board_are_in_the_log(
    program: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG, "cnc.boards.stepper")
    simulator = Simulator()
    port = SimulatorPort(simulator)
    board = Stepper(port, stepper_machine(), "port B", clock=port)
    try:
        assert run_with(program, stepper_machine(), board=board).ok
    finally:
        board.close()
        simulator.close()
    text = "\n".join(record.getMessage() for record in caplog.records)
    assert in_order(text, r"port B -> [0-9a-f]{2} ", r"port B: Welcome\(", r"port B: Status\("), (
        text
    )


def test_verbose_prints_the_stages_and_no_line_of_the_link(
    program: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    for flag in ("-v", "--verbose"):
        assert cli.exit_code([str(program), "--board", "grbl-sim", "--yes", flag]) == 0
        shown = capfd.readouterr()
        assert in_order(
            shown.err, "check pass: 4 lines", "motion begins", "run pass", "end: 0 faults"
        )
        assert "->" not in shown.err
    assert cli.exit_code([str(program)]) == 0
    assert "check pass" not in capfd.readouterr().err


def test_the_last_message_stays_the_last(
    program: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    program.write_text("G21 G90\nG1 X99999 F600\nM2\n")
    log = tmp_path / "run.log"
    assert cli.exit_code([str(program), "-v", "--log", str(log)]) == 1
    last = capfd.readouterr().err.rstrip("\n").split("\n")[-4:]
    assert any(": soft-limit: " in line for line in last)
    assert not any("INFO" in line or "ERROR" in line for line in last[1:])
    assert "soft-limit" in log.read_text()


def test_warnings_are_in_the_log(program: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "cnc.session")
    program.write_text("G21 G90 G94\nG1 X1 F99999\nM2\n")
    report = api.check(program)
    assert report.warnings
    for warning in report.warnings:
        assert f"{warning.severity}: {warning.render()}" in caplog.messages


def test_an_internal_error_has_its_traceback_in_the_log(
    program: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise RuntimeError("oh")

    monkeypatch.setattr(api, "check", broken)
    log = tmp_path / "run.log"
    assert cli.exit_code(["check", str(program), "--log", str(log)]) == 1
    assert "Traceback" not in capfd.readouterr().err
    assert in_order(log.read_text(), "CRITICAL", "Traceback", "RuntimeError: oh")


@pytest.mark.usefixtures("one_process")
def test_findings_of_many_programs_are_in_the_log(program: Path, tmp_path: Path) -> None:
    (tmp_path / "bad.nc").write_text("G1 X5\n")
    log = tmp_path / "run.log"
    assert cli.exit_code(["check", str(tmp_path), "--quiet", "--jobs", "1", "--log", str(log)]) == 1
    assert in_order(log.read_text(), r"bad\.nc", "error: .*bad.nc:1:.* feed-missing", r"p\.nc")


@pytest.mark.parametrize(
    "command",
    [
        ["check"],
        [],
        ["view", "-o", "{folder}/x.html"],
        ["diff", "{program}"],
        ["home", "--machine", "{program}"],
    ],
)
def test_the_log_does_not_overwrite_an_input(
    program: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], command: list[str]
) -> None:
    words = [word.format(folder=tmp_path, program=program) for word in command]
    arguments = [*words, *([] if "home" in words else [str(program)]), "--log", str(program)]
    assert cli.exit_code(arguments) == 2
    assert "output-over-input" in capfd.readouterr().err
    assert program.read_text() == PROGRAM


def test_a_log_that_cannot_be_written_is_wrong_usage(
    program: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert cli.exit_code([str(program), "--log", str(tmp_path / "no" / "run.log")]) == 2
    assert "can-not-write" in capfd.readouterr().err


class FakePort:
    """A port with given answers."""

    def __init__(self, *answers: bytes) -> None:
        self.answers, self.sent = list(answers), b""

    def read(self, timeout: float) -> bytes:
        return self.answers.pop(0) if self.answers else b""

    def write(self, data: bytes) -> None:
        self.sent += data

    def raise_lines(self) -> bool:
        return False

    def close(self) -> None:
        pass


def test_partial_lines_are_logged_whole(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.DEBUG, "cnc.test")
    port = FakePort(b"o", b"k\r\n<Id", b"le>\r\n", b"")
    logged = LoggedPort(port, "P", logging.getLogger("cnc.test"), text=True)
    logged.write(b"G1X1\nG1X2\n")
    logged.write(b"\x18")
    assert b"".join(logged.read(0.0) for _ in range(4)) == b"ok\r\n<Idle>\r\n"
    assert port.sent == b"G1X1\nG1X2\n\x18"
    logged.raise_lines()
    logged.close()
    assert caplog.messages == [
        "P -> G1X1",
        "P -> G1X2",
        r"P -> \x18",
        "P <- ok",
        "P <- <Idle>",
        "P: raise DTR and RTS",
        "P: close",
    ]


def test_binary_frames_are_logged_in_hexadecimal(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.DEBUG, "cnc.test")
    logged = LoggedPort(FakePort(b"\x00\xff"), "P", logging.getLogger("cnc.test"), text=False)
    logged.write(b"\x01\n\x02")
    logged.read(0.0)
    assert caplog.messages == ["P -> 01 0a 02", "P <- 00 ff"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no full disk")
@pytest.mark.parametrize(
    "redirected", [["check", "part.nc"], ["schema", "machine"]][:: share(1, 2)]
)
def test_standard_output_on_a_full_disk_is_an_error_of_usage(tmp_path, redirected):
    (tmp_path / "part.nc").write_text(PROGRAM, encoding="ascii")
    command = [sys.executable, "-m", "cnc.cli", *redirected]
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        done = subprocess.run(
            command, cwd=tmp_path, stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert done.returncode == 2
    assert "can-not-write: standard output cannot be written: No space left" in done.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no full disk")
def test_a_log_on_a_full_disk_ends_with_one_warning(tmp_path):
    (tmp_path / "part.nc").write_text(PROGRAM, encoding="ascii")
    command = [sys.executable, "-m", "cnc.cli", "check", "part.nc", "--log", "/dev/full"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert done.stderr.count("log-ends: /dev/full cannot be written: No space left") == 1
    assert "Traceback" not in done.stderr
