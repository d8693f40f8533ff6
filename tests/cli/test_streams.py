"""Standard input, output and error that are closed or full: the exit code is that of the work."""

from __future__ import annotations

import os
import subprocess
import sys
from itertools import product
from pathlib import Path

import pytest

from tests.support.paths import ROOT
from tests.support.soak import share
from tests.support.waiting import HANG

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="/dev/full")
STATES = "open", "closed", "full"
COMMANDS: list[tuple[list[str], int, bool]] = [
    (["check", "good.nc"], 0, True),
    (["check", "bad.nc"], 1, False),
    (["check", "good.nc", "--format", "json"], 0, True),
    (["check", "good.nc", "bad.nc"], 1, True),
    (["good.nc", "--board", "loopback"], 0, True),
    (["good.nc", "--board", "loopback", "--quiet"], 0, False),
    (["--help"], 0, True),
    (["schema", "machine"], 0, True),
    (["check", "missing.nc", "--verbose"], 2, False),
]
"""Command lines, their exit codes, and whether they print to standard output."""
CASES = [
    (*command, inputs, out, err)
    for command in COMMANDS
    for inputs, out, err in product(STATES[:2], STATES, STATES)
    if (inputs, out, err) != ("open", "open", "open")
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("streams")
    (folder / "good.nc").write_text("G21 G90\nG1 X1 F600\nM2\n")
    (folder / "bad.nc").write_text("G21 G90\nG1 X\nM2\n")
    return folder


def carried_out(folder: Path, arguments: list[str], states: list[str]) -> tuple[int, str]:
    def prepare() -> None:
        for number, state in enumerate(states):
            if state == "closed":
                os.close(number)
            elif state == "full":
                os.dup2(os.open("/dev/full", os.O_WRONLY), number)

    done = subprocess.run(
        [sys.executable, "-m", "cnc.cli", *arguments],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT), "XDG_STATE_HOME": str(folder / "state")},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=HANG,
        preexec_fn=prepare,
        check=False,
    )
    return done.returncode, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("arguments", "code", "prints", "inputs", "out", "err"), CASES[:: share(1, 23)]
)
def test_closed_and_full_streams(
    folder: Path, arguments: list[str], code: int, prints: bool, inputs: str, out: str, err: str
) -> None:
    found, said = carried_out(folder, arguments, [inputs, out, err])
    assert "internal-error" not in said
    assert "Traceback" not in said
    assert "Exception ignored" not in said
    # A result that a full disk does not take is an error; a closed output is not wanted.
    lost = prints and out == "full"
    assert found == (2 if lost else code)
    if lost and err == "open":
        assert "standard output cannot be written" in said


def test_a_program_from_a_closed_input_cannot_be_read(folder: Path) -> None:
    found, said = carried_out(folder, ["check", "-"], ["closed", "open", "open"])
    assert (found, "can-not-read" in said) == (2, True)


def test_no_file_gets_the_number_of_a_closed_stream() -> None:
    """A board's port under the number of standard error would receive the messages."""
    code = """
import os
for number in range(3):
    os.close(number)
import sys
sys.stdin = sys.stdout = sys.stderr = None
from cnc.cli.signals import prepare_streams
prepare_streams()
sys.exit(10 * (os.open(os.devnull, os.O_RDONLY) > 2) + (os.write(2, b"x") == 1))
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, timeout=HANG, check=False)
    assert done.returncode == 11
