"""The command line: exit codes and last messages."""

import gc
import json
import os
import signal
import subprocess
import sys

import pytest

from cnc import api
from cnc.boards.loopback import Loopback
from cnc.cli.commands import TASKS, app
from cnc.cli.messages import EXIT_PIPE
from cnc.cli.work import NEW_OBJECTS, load_library
from cnc.machine.load import load_machine, shipped_machines
from tests.support.cli.messages import last_message
from tests.support.paths import ROOT
from tests.support.soak import share
from tests.support.waiting import HANG

GOOD = "G21 G90 G94\nG0 X5 Y5\nG1 X10 F600\nG2 X20 Y5 I5 J0\nM2\n"


def test_a_good_program_runs(cncrun, program):
    code, out, err = cncrun(program(GOOD))
    assert code == 0
    assert "run on the board 'loopback'" in out
    assert "25 .." not in err
    code, out, _ = cncrun("check", program(GOOD))
    assert code == 0
    assert "checked, nothing moved" in out
    code, out, _ = cncrun(program(GOOD), "--dry-run")
    assert "checked, nothing moved" in out


def test_quiet_prints_nothing(cncrun, program):
    assert cncrun(program(GOOD), "--quiet") == (0, "", "")


def test_a_program_error_is_1_with_place_caret_and_help(cncrun, program):
    file = program("G21 G90\nG1 X10 F600\nG2 X20 Y5 I5 J9\nM2\n")
    for command in ([], ["check"]):
        code, out, err = cncrun(*command, file)
        assert code == 1
        assert out == ""
        assert last_message(err, "arc-radius-mismatch").startswith(f"{file}:3:")
        assert "^" in err
        assert "  help: " in err


def test_outside_the_travel_is_1_before_anything_moves(cncrun, program, monkeypatch):
    monkeypatch.setattr(api, "open_board", lambda *_, **__: Loopback(3, fail_after=0))
    # Both end points are inside; the arc's bulge is not. A move that would fail the board comes
    # first.
    file = program("G21 G90\nG1 X10 Y300 F600\nG2 X60 Y300 (Y 325) I25 J0\nM2\n")
    code, _, err = cncrun(file)
    assert code == 1
    message = last_message(err, "soft-limit")
    assert message == f"{file}:3:8: soft-limit: Y would reach 325 mm; the travel is -10 to 310 mm"
    assert "  G2 X60 Y300 (Y 325) I25 J0\n         ^~~~\n" in err


def test_a_move_to_the_limit_is_accepted(cncrun, program):
    assert cncrun(program("G21 G90 G1 X410 Y310 F6000\nG1 X-10 Y-10\nM2\n"), "--quiet") == (
        0,
        "",
        "",
    )
    assert cncrun(program("G21 G90 G1 X410.001 F6000\nM2\n"), "--quiet")[0] == 1


def test_spindle_synchronised_motion_above_the_speed_limit_is_rejected(cncrun, program):
    """Z reaches 50 mm/s at 1 mm per revolution and 3000 rpm, and no more."""
    assert (
        cncrun("check", program("G21 S3000 M3\nG33 Z-5 K1\nG1 Z0 F60000\nM2\n"), "--quiet")[0] == 0
    )
    file = program("G21 S3000 M3\nG33 Z-5 K1.01\nM2\n")
    code, _, err = cncrun("check", file, "--quiet")
    assert code == 1
    message = last_message(err, "spindle-too-fast")
    assert message.startswith(f"{file}:2:")
    assert "50.5 mm/s, 1.01 times" in message


@pytest.mark.parametrize("kind", ["laser", "mill"])
def test_the_power_of_a_laser_may_stand_in_the_moves(cncrun, program, tmp_path, kind):
    machine = tmp_path / "machine.toml"
    axis = "steps_per_mm = 100\nmax_velocity = 50\nmax_acceleration = 500\nmax_jerk = 9000\n"
    axes = "".join(f"[axes.{letter}]\n{axis}" for letter in "xyz")
    machine.write_text(f'[machine]\nkind = "{kind}"\n{axes}')
    layer = "M4\nG0 X10\nG1 X20 S500 F1000\nG1 S0\nM5\n"
    file = program(f"G21 G90\n{layer}G0 X0\n{layer}M2\n")
    code, _, err = cncrun("check", file, "--machine", str(machine))
    assert code == 0
    assert ("spindle-speed-missing" in err) == (kind == "mill")


def test_many_warnings_are_counted_and_a_loop_gives_one(cncrun, program):
    loop = "#1 = 0\no1 while [#1 LT 9]\nM3\n#1 = [#1 + 1]\no1 endwhile\n"
    file = program(loop + "M3\n" * 102 + "M2\n")
    code, _, err = cncrun("check", file)
    assert code == 0
    assert err.count("spindle-speed-missing") == 100
    assert err.count(f"{file}:3:") == 1
    assert "3 more warnings are not shown" in err
    assert "warnings" not in cncrun("check", file, "--quiet")[2]


def test_many_places_outside_the_travel_are_counted(cncrun, program):
    file = program("G21 G90 F6000\n" + "G1 X500\nG1 X501\n" * 20 + "M2\n")
    code, _, err = cncrun("check", file, "--machine", "default")
    assert code == 1
    assert "20 more places outside the travel are not shown" in err
    assert err.count(": soft-limit: ") == 20


def test_a_fault_of_the_board_is_3(cncrun, program, monkeypatch):
    monkeypatch.setattr(api, "open_board", lambda *_, **__: Loopback(3, fail_after=700))
    code, _, err = cncrun(program("G21 G90\nG1 X2 F600\nG1 X10\nM2\n"))
    assert code == 3
    assert ":3:1: board-fault: " in last_message(err, "board-fault")
    assert "  G1 X10\n  ^~~~~~" in err


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["--nonsense"], "usage"),
        ([], "usage"),
        (["{p}", "second.nc"], "usage"),
        (["{p}", "--dialect", "klingon"], "usage"),
        (["{p}", "--json"], "usage"),
        (["check", "{p}", "--format", "xml"], "usage"),
        (["check"], "no-program"),
        (["check", "*.nothing"], "no-program"),
        (["nowhere.nc"], "no-such-file"),
        (["check", "nowhere.nc"], "no-such-file"),
        (["check", "nowhere.nc", "{p}"], "no-such-file"),
        (["{folder}"], "is-a-folder"),
        (["{p}", "--board", "loopbak"], "unknown-board"),
        (["{p}", "--board", "file"], "no-target"),
        (["{p}", "--machine", "nowhere.toml"], "no-such-file"),
        (["{p}", "--trace", "t.txt"], "output-format"),
        (["{p}", "--pulses", "t.csv"], "output-format"),
        (["{p}", "--trace", "nowhere/t.csv"], "can-not-write"),
        (["{p}", "--trace", "nowhere/t.npz"], "can-not-write"),
        (["{p}", "--json", "nowhere/t.json"], "can-not-write"),
        (["{p}", "--json", "-", "--blocks", "-"], "output-twice"),
        (["check", "{p}", "{p2}", "--blocks", "b.jsonl"], "one-program-only"),
    ],
)
@pytest.mark.usefixtures("one_process")
def test_wrong_usage_is_2(cncrun, program, tmp_path, monkeypatch, arguments, code):
    monkeypatch.chdir(tmp_path)
    known = {"p": program(GOOD), "p2": program(GOOD, "p2.nc"), "folder": str(tmp_path)}
    result, _, err = cncrun(*(each.format(**known) for each in arguments))
    assert result == 2
    last_message(err, code)
    assert sorted(os.listdir(tmp_path)) == ["p.nc", "p2.nc"]


def test_a_bad_machine_file_is_2(cncrun, program):
    machine = program("[axes.x]\nsteps_per_mm = -1\nmax_velocity = 5\n", "m.toml")
    code, _, err = cncrun(program(GOOD), "--machine", machine)
    assert code == 2
    assert (
        last_message(err, "machine-file")
        == f"{machine}:2:1: machine-file: axes.x.steps_per_mm: must be greater than 0, not -1"
    )


def test_an_internal_error_shows_a_traceback_only_with_verbose(cncrun, program, monkeypatch):
    def broken(*_, **__):
        raise RuntimeError("oh")

    monkeypatch.setattr(api, "check", broken)
    code, _, err = cncrun("check", program(GOOD))
    assert code == 1
    assert last_message(err, "internal-error") == "internal-error: cncrun failed: RuntimeError: oh"
    code, _, err = cncrun("check", program(GOOD), "--verbose")
    assert code == 1
    assert "Traceback" in err


def test_a_shipped_machine_by_name(cncrun, program):
    _, out, _ = cncrun(
        "check", program(GOOD), "--machine", "paper-nurbs", "--format", "json", "--quiet"
    )
    assert json.loads(out)["machine"] == "paper, NURBS"


def test_a_feed_override(cncrun, program):
    file = program("G21 G90\nG1 X50 F600\nM2\n")
    seconds = {}
    for command in (), ("check",):
        for percent in ("50", "100", "200"):
            code, out, _ = cncrun(
                *command, file, "--feed-override", percent, "--json", "-", "--quiet"
            )
            assert code == 0
            seconds[command, percent] = json.loads(out)["duration_s"]
        assert seconds[command, "50"] == pytest.approx(2 * seconds[command, "100"], rel=0.05)
        assert seconds[command, "100"] == pytest.approx(2 * seconds[command, "200"], rel=0.05)
    assert seconds[(), "50"] == pytest.approx(seconds[("check",), "50"], rel=1e-9)


@pytest.mark.parametrize("percent", ["0", "0.5", "201", "-10", "nan", "fast"])
def test_a_feed_override_out_of_range_is_wrong_usage(cncrun, program, percent):
    for command in (), ("check",):
        code, out, err = cncrun(*command, program(GOOD), f"--feed-override={percent}")
        assert (code, out) == (2, "")
        assert last_message(err, "usage" if percent == "fast" else "feed-override")


def test_the_operator_stops_a_run(cncrun, program, monkeypatch):
    class Interrupting(Loopback):
        told = False

        def send(self, chunk):
            super().send(chunk)
            if self.rows > 3000 and not self.told:
                self.told = True
                os.kill(os.getpid(), signal.SIGINT)

    board = Interrupting(3)
    monkeypatch.setattr(api, "open_board", lambda *_, **__: board)
    code, out, err = cncrun(program("G21 G90 F6000\n" + "G1 X100\nG1 X0\n" * 50 + "M2\n"))
    assert code == 130
    assert out == ""
    assert board.state == "stopped"
    assert board.rows < 500_000
    stopped = board.position_steps / 200
    place = f"X{stopped[0]:.4f}".rstrip("0").rstrip(".")
    assert err.splitlines()[-1].startswith("stopped by the operator at line ")
    assert err.splitlines()[-1].endswith(f"; the board has come to rest at {place} Y0 Z0")


def test_the_operator_stops_before_anything_moves(program):
    """The program comes from a pipe that never ends."""
    command = [sys.executable, "-m", "cnc.cli", "-"]
    with subprocess.Popen(
        command, cwd=ROOT, stdin=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdin
        assert process.stderr
        process.stdin.write(
            b"G21\n" * 100_000
        )  # more than a pipe holds: it is being read once this returns
        process.stdin.flush()
        process.send_signal(signal.SIGINT)
        try:
            process.wait(60)
        except subprocess.TimeoutExpired:
            # Python sees a signal that comes in the instant before a read blocks after that read:
            # press again, as anyone would.
            process.send_signal(signal.SIGINT)
        assert process.wait(HANG) == 130
        assert (
            process.stderr.read().decode().splitlines()[-1]
            == "stopped by the operator; nothing has moved"
        )


@pytest.mark.skipif(sys.platform == "win32", reason="needs a shell with pipes")
def test_a_closed_output_pipe_is_141(program):
    file = program("G21 G90 F6000\n" + "G1 X100\nG1 X0\n" * 5000 + "M2\n")
    command = [sys.executable, "-m", "cnc.cli", "check", file, "--blocks", "-"]
    with subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdout
        assert process.stderr
        process.stdout.readline()
        process.stdout.close()
        assert process.wait(HANG) == EXIT_PIPE
        assert b"Traceback" not in process.stderr.read()


@pytest.mark.parametrize(
    "arguments", [["--help"], ["check", "--help"], ["--version"]][:: share(1, 2)]
)
def test_help_imports_no_numerics(arguments):
    code = (
        "import sys; from cnc.cli import exit_code; code = exit_code(sys.argv[1:]);"
        "slow = {'numba', 'lark', 'numpy', 'pydantic', 'llvmlite', 'scipy'} & set(sys.modules);"
        "print(slow, file=sys.stderr); sys.exit(code or len(slow))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=HANG,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout


@pytest.mark.parametrize(
    ("arguments", "most"), [(["--help"], 30), (["check"], 250)], ids=["help", "refused program"]
)
def test_a_start_imports_few_modules(program, tmp_path, arguments, most):
    """Each module takes about a millisecond. The limits leave room for a few more."""
    refused = arguments == ["check"]
    code = (
        "import sys; from cnc.cli import exit_code; code = exit_code(sys.argv[1:]);"
        "own = [name for name in sys.modules if name.partition('.')[0] == 'cnc'];"
        "print(code, len(own), 'llvmlite' in sys.modules, file=sys.stderr)"
    )
    names = [program("G21 G90\nG1 X1O F600\nM2\n")] if refused else []
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments, *names],
        cwd=ROOT,
        env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "nothing")},
        capture_output=True,
        text=True,
        timeout=HANG,
        check=False,
    )
    exit_code, own, loads = done.stderr.splitlines()[-1].split()
    assert (exit_code, loads) == (str(int(refused)), "False"), done.stderr
    assert int(own) <= most


def test_a_program_imports_no_reader_of_another_language(program):
    code = (
        "import sys; from cnc.cli import exit_code; code = exit_code(sys.argv[1:]);"
        "sys.exit(code or 'cnc.gcode.sinumerik.statements' in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, "check", program("G21 G90 G1 X5 F600\nM2\n")],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=HANG,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def test_the_collector_looks_at_new_objects_less_often_than_by_default():
    before = gc.get_threshold()
    try:
        load_library()
        assert gc.get_threshold()[0] == NEW_OBJECTS > 700
    finally:
        gc.set_threshold(*before)


def test_the_collector_rests_during_imports_and_at_the_end(program):
    """Both would search all objects of the library: a quarter of the time of a small program."""
    code = """
import atexit, gc, sys
import cnc.cli, cnc.cli.commands
from cnc.cli.work import load_library

during_import = []
gc.callbacks.append(lambda *_: during_import.append(1))
load_library()
del gc.callbacks[:]
assert "cnc.api" in sys.modules
assert not during_import
assert len(gc.get_objects()) < 10_000
# The last steps of Python search what is not frozen.
atexit.register(lambda: print("left", len(gc.get_objects()), "all", gc.get_freeze_count()))
cnc.cli.main()
"""
    done = subprocess.run(
        [sys.executable, "-c", code, "check", program(GOOD)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=HANG,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    words = done.stdout.splitlines()[-1].split()
    assert words[::2] == ["left", "all"]
    assert int(words[1]) < 1_000
    assert int(words[3]) > 50_000


def test_help_fits_a_screen_and_has_one_line_for_each_command(cncrun):
    code, out, _ = cncrun("--help")
    assert code == 0
    assert len(out.splitlines()) <= 35
    assert max(map(len, out.splitlines())) <= 80
    rows = [line[9:].split() for line in out.splitlines()[6:] if line[9:10].islower()]
    shown = [row[0] for row in rows if row[0] in app]
    assert sorted(shown) == sorted(name for name in app if not name.startswith("-"))
    assert [line.split("  ")[0] for line in out.splitlines()[6:-3] if line[0] != " "] == [*TASKS]
    assert not {"--board", "--trace", "--dialect"} & set(out.replace(",", " ").split())
    assert "cncrun run --help" in out


@pytest.mark.parametrize("arguments", [(), ("run",)])
def test_run_may_be_left_out(cncrun, program, arguments):
    name = program("G21 G90 G1 X5 F600\nM2\n")
    assert cncrun(*arguments, name, "--quiet") == (0, "", "")
    assert cncrun(*arguments, "--quiet", "--dry-run", name) == (0, "", "")
    code, _, err = cncrun(*arguments, program("G21 G1 X5\nM2\n"), "--dry-run")
    assert code == 1
    assert last_message(err, "feed-missing")
    code, _, err = cncrun(*arguments, name, "second.nc")
    assert code == 2
    assert "cncrun runs one program" in err


def test_the_options_of_most_runs_stand_first(cncrun):
    _, out, _ = cncrun("run", "--help")
    daily, others = out.index("Daily options"), out.index("─ Options")
    for name in ("--machine", "--board", "--port", "--dry-run", "--from-line", "--yes"):
        assert daily < out.index(f"{name} ") < others
    assert out.index("--trace") > others


@pytest.mark.parametrize("arguments", [("run",), ("part.nc",), ("--yes",)])
def test_help_of_a_run_lists_the_options(cncrun, arguments):
    _, out, _ = cncrun(*arguments, "--help")
    for word in (
        "--machine",
        "--dialect",
        "--interpolator",
        "--algorithm",
        "--board",
        "--dry-run",
        "--blocks",
        "--trace",
        "--pulses",
        "--json",
    ):
        assert word in out


@pytest.mark.parametrize("name", sorted(shipped_machines()))
def test_every_shipped_machine_checks_a_small_program(cncrun, program, name):
    lathe = load_machine(name).kind == "lathe"
    text = "G21\nT0101\nG97 S500 M3\nG0 X10 Z2\nG1 Z-5 F0.1\nM30\n" if lathe else GOOD
    if name == "scara":
        # Folded arms do not reach their shoulder.
        text = f"G10 L2 P1 X150 Y100\n{text}"
    found = cncrun("check", program(text), "--machine", name, "--quiet", "--dialect", "auto")
    assert found == (0, "", "")


@pytest.mark.parametrize(
    ("option", "code"),
    [("--rapid-override", "rapid-override"), ("--spindle-override", "spindle-override")],
)
def test_overrides_of_grbl_are_refused_on_other_boards(cncrun, program, option, code):
    exit_code, _, err = cncrun(program("G0 X1\nM2\n"), option, "50")
    assert exit_code == 2
    assert code in err
    assert cncrun(program("G0 X1\nM2\n"), "--board", "grbl-sim", option, "50")[0] == 0


def test_a_board_that_plans_by_itself_does_not_use_the_modes_of_the_machine(
    cncrun, program, tmp_path
):
    file = tmp_path / "g.toml"
    text = shipped_machines()["grbl-uno"].read_text(encoding="utf-8")
    file.write_text(text + "\n[vibration]\nx = {frequency = 38}\n", encoding="utf-8")
    words = (program("G21 G90\nG1 X0.1 F600\nM2\n"), "--machine", str(file))
    code, _, err = cncrun(*words, "--board", "grbl-sim", "--yes")
    assert code == 0
    assert "vibration-on-board: the board plans its own motion" in err


@pytest.mark.parametrize("command", [("check",), ("--dry-run",), ()])
def test_the_travel_of_the_default_machine_is_named(cncrun, program, command):
    file = program("G21 G90\nG0 X1000\nM2\n")
    code, _, err = cncrun(*command, file)
    assert code == 1
    assert "soft-limit" in err
    assert "default machine; name yours: --machine FILE" in err
    assert "name yours" not in cncrun("check", file, "--machine", "klipper-uno")[2]


@pytest.mark.usefixtures("one_process")
def test_a_machine_without_travel_says_that_none_was_checked(cncrun, program, tmp_path):
    mill = tmp_path / "mill.toml"
    axis = "steps_per_mm = 100\nmax_velocity = 400\nmax_acceleration = 2400\nmax_jerk = 48000\n"
    mill.write_text("".join(f"[axes.{letter}]\n{axis}" for letter in "xyz"))
    file, summary = program("G21 G90\nG0 X500\nM2\n"), tmp_path / "summary.json"
    said = "not checked: the machine file gives none"
    for machine, checked in ((str(mill), False), ("klipper-uno", True)):
        options = ("--machine", machine, "--json", str(summary))
        out = cncrun("check", file, *options)[1]
        assert (said in out) is not checked
        assert json.loads(summary.read_text())["travel_checked"] is checked
    folder = tmp_path / "programs"
    program("G0 X1\nM2\n", "programs/a.nc")
    listed = cncrun("check", str(folder), "--jobs", "1", "--machine", str(mill))[1]
    assert listed.splitlines()[-1] == f"travel was {said}"


def test_alone_it_shows_the_commands_and_asks_for_a_program(cncrun):
    code, out, err = cncrun()
    assert code == 2
    assert "Verify programs without a board" in out
    assert last_message(err, "usage")
