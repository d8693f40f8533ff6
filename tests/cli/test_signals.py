"""A terminal that is closed, and Ctrl-Z: the machine does not go on alone."""

from __future__ import annotations

import errno
import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from cnc.cli import exit_code
from cnc.cli.signals import OperatorSignals
from cnc.model.operator_control import Control, StoppedAtOnce
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from cnc.simulators.grbl.ports import PtyServer
from tests.support.soak import share
from tests.support.waiting import HANG, wait_until

pty = pytest.importorskip("pty")

ROOT = Path(__file__).parents[2]
FAST = {110: 5000.0, 111: 5000.0, 112: 5000.0, 120: 250.0, 121: 250.0, 122: 250.0}
PROGRAM = "G21 G90\nM3 S900\nG1 X20 F600\nX0\nX3\nM5\nM2\n"


@pytest.fixture(autouse=True)
def hang_up_is_not_ignored() -> Iterator[None]:
    """Tests that nohup has started inherit that the signal is ignored."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


def own_terminal() -> None:
    """Make standard input the controlling terminal of the process."""
    import fcntl
    import termios

    fcntl.ioctl(0, termios.TIOCSCTTY, 0)


class Run:
    """A run of the program in a terminal, on a simulated board in real time.

    own: The terminal is the controlling one of its session; only then does the system send SIGHUP.
    """

    def __init__(self, folder: Path, server: PtyServer, *, own: bool = True) -> None:
        self.simulator = server.simulator
        (folder / "p.nc").write_text(PROGRAM)
        self.terminal, theirs = pty.openpty()

        self.process = subprocess.Popen(
            [sys.executable, "-m", "cnc.cli", str(folder / "p.nc"), "--machine", "grbl-uno"]
            + ["--port", server.name, "--log", str(folder / "log.txt")],
            cwd=ROOT,
            env=os.environ | {"XDG_STATE_HOME": str(folder)},
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            start_new_session=True,
            preexec_fn=own_terminal if own else None,
        )
        os.close(theirs)
        os.set_blocking(self.terminal, False)
        wait_until(lambda: self.read() and self.simulator.position[0] > 1.0)

    def read(self) -> bool:
        """Empty the terminal, so that nobody waits for it."""
        # Nothing to read is one OSError, and a terminal whose program has ended another.
        with suppress(OSError):
            os.read(self.terminal, 65536)
        return True

    def state(self) -> str:
        self.read()
        return Path(f"/proc/{self.process.pid}/stat").read_text().rsplit(")", 1)[1].split()[0]


@contextmanager
def running(folder: Path, settings: dict[int, float], *, own: bool = True) -> Iterator[Run]:
    """Provide a run on a board with these settings."""
    if sys.platform != "linux":
        pytest.skip("reads the state of a process from /proc")
    with PtyServer(GrblSimulator(settings=settings)) as server:
        started = Run(folder, server, own=own)
        try:
            yield started
        finally:
            started.process.kill()
            started.process.wait()


@pytest.fixture
def run(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Run]:
    with running(tmp_path, FAST, own=getattr(request, "param", True)) as started:
        yield started


@pytest.fixture
def slow_run(tmp_path: Path) -> Iterator[Run]:
    """A run on a machine that takes a second to come to rest."""
    with running(tmp_path, FAST | {120: 10.0}) as started:
        yield started


@pytest.mark.parametrize("run", share([True, False], [True]), indirect=True)
def test_a_closed_terminal_stops_the_machine(run: Run) -> None:
    os.close(run.terminal)
    assert run.process.wait(HANG) == 130
    core = run.simulator.core
    assert run.simulator.speed == 0.0
    assert core.spindle_text == "M5 0"
    # It came to rest by a hold before the reset, so that the position is kept.
    kinds = [event.kind for event in run.simulator.events]
    assert "hold" in kinds
    assert "alarm" not in kinds
    assert 1.0 < run.simulator.position[0] < 19.0


def test_a_second_stop_tells_that_the_position_is_kept_and_where_to_go_on(slow_run: Run) -> None:
    run = slow_run
    run.process.send_signal(signal.SIGINT)
    # While the board decelerates the first stop is under way.
    wait_until(lambda: run.read() and run.simulator.core.state == "Hold")
    run.process.send_signal(signal.SIGINT)
    said = b""
    while run.process.poll() is None or select.select([run.terminal], [], [], 0.0)[0]:
        with suppress(BlockingIOError):
            try:
                said += os.read(run.terminal, 65536)
            except OSError as error:
                if error.errno == errno.EIO:
                    break
                raise
    assert run.process.wait(HANG) == 130
    text = said.decode()
    assert "to continue: --from-line 3" in text
    assert "at once; the board has kept its position" in text
    assert run.simulator.speed == 0.0
    assert "alarm" not in [event.kind for event in run.simulator.events]
    assert 1.0 < run.simulator.position[0] < 19.0


def test_only_the_first_stop_at_once_leaves_the_board_its_time() -> None:
    with OperatorSignals(Control()) as signals:
        signals.moving = True
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(StoppedAtOnce):
            signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt, match="the position is lost") as caught:
            signal.raise_signal(signal.SIGINT)
        assert caught.type is KeyboardInterrupt


def test_control_z_holds_the_machine_before_the_program_is_suspended(run: Run) -> None:
    os.write(run.terminal, b"\x1a")
    wait_until(lambda: run.state() == "T")
    assert run.simulator.core.state == "Hold"
    assert run.simulator.speed == 0.0
    place = run.simulator.position
    suspended = run.simulator.now
    # Longer than the silence after which a board counts as dead.
    wait_until(lambda: run.simulator.now > suspended + 2.5)
    assert run.simulator.position == place
    run.process.send_signal(signal.SIGCONT)
    os.write(run.terminal, b" ")
    wait_until(lambda: run.read() and run.process.poll() is not None)
    os.close(run.terminal)
    assert run.process.returncode == 0
    assert run.simulator.position == pytest.approx((3.0, 0.0, 0.0), abs=0.005)


def test_a_second_hang_up_does_not_end_the_program_at_once() -> None:
    control = Control()
    with OperatorSignals(control) as signals:
        signals.moving = True
        for _ in range(2):
            signal.raise_signal(signal.SIGHUP)
        assert control.stopped
        # The shell may send more signals to the programs of a closed terminal.
        signal.raise_signal(signal.SIGTERM)


def test_a_hang_up_before_any_motion_ends_the_program() -> None:
    with pytest.raises(KeyboardInterrupt), OperatorSignals(Control()):
        signal.raise_signal(signal.SIGHUP)


@pytest.mark.parametrize("module", ["cnc.cli.options", "cnc.api"][:: share(1, 2)])
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_while_the_program_is_loaded_ends_it_with_a_message(
    module: str, name: str
) -> None:
    code = f"""
import signal, sys

# A shell without job control starts its processes in the background with SIGINT ignored.
signal.signal(signal.SIGINT, signal.default_int_handler)

class Interrupted:
    def find_spec(self, name, path, target=None):
        if name == "{module}":
            signal.raise_signal(signal.{name})

sys.meta_path.insert(0, Interrupted())
sys.argv = ["cncrun", "programs/trident.nc"]
import cnc.cli
cnc.cli.main()
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 130
    assert done.stderr == "stopped by the operator; nothing has moved\n"


def test_a_terminal_that_is_closed_while_the_program_is_loaded_ends_it() -> None:
    code = """
import sys, time

class Slow:
    def find_spec(self, name, path, target=None):
        if name == "cnc.cli.options":
            print("loading", flush=True)
            time.sleep(60.0)

sys.meta_path.insert(0, Slow())
sys.argv = ["cncrun", "programs/trident.nc"]
import cnc.cli
from tests.support.soak import share
cnc.cli.main()
"""
    terminal, theirs = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=ROOT,
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        start_new_session=True,
        preexec_fn=own_terminal,
    )
    os.close(theirs)
    assert b"loading" in os.read(terminal, 100)
    os.close(terminal)
    assert process.wait(HANG) == 130


def test_an_interruption_after_motion_does_not_claim_that_nothing_has_moved(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("cnc.cli.checking.show", interrupted)
    assert exit_code([str(ROOT / "programs/trident.nc"), "--quiet"]) == 130
    assert capsys.readouterr().err.splitlines()[-1] == "stopped by the operator"
