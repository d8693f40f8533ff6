"""The public functions, the progress display, and the compilation on the first run."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import cnc
from cnc.api import Callbacks, Control, Outputs, check, load_machine, parse, plan, run
from cnc.boards.loopback import Loopback
from cnc.cli import progress
from cnc.model.blocks import ArcFeed, Dwell, End, Polyline
from cnc.model.diagnostics import EXIT_BOARD, Diagnostic, GcodeError, MachineFileError, UsageError
from cnc.planner.plan import PlanChunk
from tests.support.paths import ROOT
from tests.support.session.runs import check_with
from tests.support.waiting import HANG

TEXT = "G21 G90 G94\nG1 X10 F600\nG4 P0.5\nG2 X20 Y0 I5 J0\nG4 P0.25\nM2\n"


@pytest.fixture
def program(tmp_path) -> Path:
    file = tmp_path / "p.nc"
    file.write_text(TEXT)
    return file


def test_parse_yields_blocks_as_they_are_read(program):
    assert [type(block) for block in parse(program)] == [Polyline, Dwell, ArcFeed, Dwell, End]
    program.write_text(TEXT.replace("I5", "I6"))
    with pytest.raises(GcodeError):
        list(parse(program))


def test_the_plan_ends_at_the_duration_of_the_report(program):
    items = list(plan(program))
    chunks = [item for item in items if isinstance(item, PlanChunk)]
    report = check(program)
    assert report.duration_s == pytest.approx(chunks[-1].t0 + chunks[-1].duration + 0.25)
    assert sum(isinstance(item, Dwell) for item in items) == 2
    assert report.path_length_mm == pytest.approx(10 + 5 * 3.141592653589793)


def test_a_machine_can_be_given_in_three_ways(program):
    machine = load_machine("paper-nurbs")
    named, given, filed = (
        check(program, each)
        for each in ("paper-nurbs", machine, ROOT / "config" / "paper-nurbs.toml")
    )
    assert named.duration_s == given.duration_s == filed.duration_s
    with pytest.raises(MachineFileError):
        check(program, "no such machine")


def test_run_accepts_a_board_object(program):
    board = Loopback(3)
    report = run(program, board=board)
    assert report.ok
    assert report.board == "Loopback"
    assert board.position_steps.tolist() == [4000, 0, 0]
    assert report.steps == dict(zip("xyz", board.steps.tolist(), strict=True))
    assert board.state == "idle"  # it is its owner's to close


def test_faults_are_in_the_report(program):
    board = Loopback(3, fail_after=5)
    report = run(program, board=board)
    assert report.exit_code == EXIT_BOARD
    assert (
        report.end_position
        == {"x": board.position_steps[0] / 200, "y": 0.0, "z": 0.0}
        != {"x": 20.0, "y": 0.0, "z": 0.0}
    )
    assert report.faults[0].diagnostic.line == 2
    assert report.faults[0].diagnostic.file == str(program)
    program.write_text("G1 X1\n")
    assert [fault.diagnostic.code for fault in check(program).faults] == ["feed-missing"]
    assert [fault.diagnostic.code for fault in check(program.with_name("no")).faults] == [
        "no-such-file"
    ]


def test_usage_errors_are_raised(program):
    with pytest.raises(UsageError, match="output-format"):
        check_with(program, outputs=Outputs(trace="t.txt"))
    with pytest.raises(UsageError, match="unknown-board"):
        run(program, board="nowhere")


def test_a_program_too_long_to_keep_is_read_again(program, monkeypatch):
    kept = check_with(program, interpolator="sampled")
    monkeypatch.setattr("cnc.session.check_pass.KEPT_NUMBERS", 0)
    monkeypatch.setattr("cnc.session.program_reader.COPIED_BYTES", 0)
    again = check_with(program, interpolator="sampled")
    for report in (kept, again):
        assert report.ok
    assert again.duration_s == kept.duration_s
    assert again.steps == kept.steps
    assert again.largest == kept.largest
    assert again.program == str(program)


def test_progress_is_reported_in_both_passes(program, monkeypatch):
    monkeypatch.setattr("cnc.gcode.core.program.REPORT_INTERVAL", 1)
    seen = []
    run(program, callbacks=Callbacks(on_progress=lambda *what: seen.append(what)))
    stages = [stage for stage, _, _ in seen]
    assert stages == sorted(stages)
    assert ("checking", 6, None) in seen
    assert seen[-1][0] == "running"
    assert seen[-1][2] == 6


@pytest.mark.parametrize("stage", ["checking", "running"])
def test_a_stop_ends_both_passes(program, monkeypatch, stage):
    monkeypatch.setattr("cnc.gcode.core.program.REPORT_INTERVAL", 1)

    def stopping():
        control = Control()
        return {
            "control": control,
            "callbacks": Callbacks(
                on_progress=lambda now, *_: control.stop() if now == stage else None
            ),
        }

    report = check(program, **stopping())
    assert report.stopped_at_line == 0
    board = Loopback(3)
    report = run(program, board=board, **stopping())
    assert report.stopped_at_line == 0
    assert board.rows == 0


def test_the_bar_appears_only_after_a_delay(capsys, monkeypatch):
    bar = progress._ProgressBar()
    bar.update("checking", 10, None)
    bar.close()
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(progress._ProgressBar, "DELAY", 0.0)
    monkeypatch.setenv("FORCE_COLOR", "1")
    bar = progress._ProgressBar()
    bar.update("checking", 10, None)
    bar.update("running", 20, 40)
    bar.close()
    assert re.search("[12]0 lines", capsys.readouterr().err)


def test_warnings_are_shown_unless_quiet(capsys):
    warning = Diagnostic("odd-word", "odd", "p.nc", 3, severity="warning")
    with progress.ProgressDisplay(Control(), quiet=False) as shown:
        on_warning = shown.callbacks().on_warning
        assert on_warning is not None
        on_warning(warning)
    assert capsys.readouterr().err == "warning: p.nc:3: odd-word: odd\n"
    with progress.ProgressDisplay(Control(), quiet=True) as shown:
        assert shown.callbacks().on_warning is None


def test_compiling_is_announced_unless_quiet(capsys):
    with progress.ProgressDisplay(Control(), quiet=False) as shown:
        shown.callbacks().on_compiling()
    assert (
        capsys.readouterr().err
        == "compiling the kernels that this program needs; this happens once\n"
    )
    with progress.ProgressDisplay(Control(), quiet=True) as shown:
        assert shown.callbacks().on_compiling is None


class Silent(Loopback):
    """A board whose probe makes no contact."""

    def execute(self, block, time_ns):
        expected = super().execute(block, time_ns)
        return expected and (0.0, *expected[1:])


def test_an_answer_of_the_board_is_used_in_the_run_pass(program):
    program.write_text("G21 G90\nG38.3 Z-5 F600\no1 if [#5070 EQ 0]\nG0 X7\no1 endif\nG0 Z0\nM2\n")
    for board, steps in ((Loopback(3), 0), (Silent(3), 7)):
        report = run(program, board=board)
        assert report.ok
        assert board.position_steps[0] == steps * load_machine(None).axes["x"].steps_per_mm


def test_the_package_exports_the_public_names_on_first_use():
    code = (
        "import sys, cnc; assert not {'numpy', 'numba', 'pydantic'} & set(sys.modules);"
        "from cnc import *; import cnc.api;"
        "assert all(getattr(cnc, name) is getattr(cnc.api, name) for name in cnc.__all__)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=HANG)
    with pytest.raises(AttributeError, match="no attribute 'chek'"):
        cnc.chek  # noqa: B018


CYCLE = "%\nO1\nG21 G90 G94 G54\nG0 X10. Y0. Z5.\nG99 G81 Y20. R2. Z-3. F100.\nX30.\nG80\nM30\n%\n"


def test_a_program_is_converted_from_its_text():
    converted = cnc.convert_program(cnc.from_text(CYCLE), "grbl", dialect="fanuc")
    assert (converted.source, converted.target) == ("fanuc", "grbl")
    assert b"G81" not in converted.text
    assert converted.distance <= 1e-3
    ends = [
        block.points[-1].tolist()
        for block in parse(cnc.from_text(converted.text.decode()), dialect="grbl")
        if isinstance(block, Polyline)
    ]
    assert [30.0, 20.0, 2.0] in ends


def test_what_a_control_does_not_have_is_an_error_of_its_line():
    with pytest.raises(GcodeError, match="convert-cannot") as refused:
        cnc.convert_program(cnc.from_text("G21 G90\nG38.2 Z-5 F100\nM2\n"), "fanuc")
    assert refused.value.diagnostic.line == 2
