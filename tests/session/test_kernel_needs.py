"""Kernels are compiled for the programs that need them, before anything moves."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from cnc.api import Callbacks, Outputs
from cnc.boards.loopback import PacedLoopback
from cnc.cli import progress
from cnc.compiled import code_cache, jit, kernel
from cnc.machine.load import load_machine
from cnc.model.operator_control import Control
from cnc.session import kernel_cache, kernel_examples, kernel_needs
from cnc.session.kernel_jobs import BLENDS, FITS, JOBS, PLANNING, READING
from tests.support.paths import ROOT
from tests.support.session.runs import check_with, run_with
from tests.support.soak import share
from tests.support.waiting import HANG, wait_until

compiled = pytest.mark.skipif(not jit.compiling(), reason="kernels run as plain Python")
MOTION = {*PLANNING, "pulses"}
CORNER = "G21 G90 G17\nG1 X10 F600\nY10\nG2 X20 Y0 I5 J-5\nM2\n"


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> set[str]:
    """Return the set to which each job is added that a session asks for; none is done."""
    jobs: set[str] = set()
    monkeypatch.setattr(
        kernel_needs, "ensure_compiled", lambda on_compiling, on_kernel, names: jobs.update(names)
    )
    monkeypatch.setattr(kernel_needs, "is_compiled", lambda job: False)
    return jobs


def checked(folder: Path, text: str, **options: Any) -> None:
    file = folder / "p.nc"
    file.write_text(text)
    assert check_with(file, **options).ok


def test_a_small_program_without_blends_asks_for_motion_only(tmp_path: Path, asked) -> None:
    checked(tmp_path, "G61\n" + CORNER)
    assert asked == MOTION


def test_a_blend_asks_for_corners(tmp_path: Path, asked) -> None:
    checked(tmp_path, "G64 P0.05\n" + CORNER)
    assert asked == MOTION | set(BLENDS)


def test_outputs_ask_for_their_kernels(tmp_path: Path, asked) -> None:
    outputs = Outputs(trace=str(tmp_path / "t.npz"), picture=str(tmp_path / "p.html"))
    checked(tmp_path, "G61\n" + CORNER, outputs=outputs, interpolator="sampled")
    assert asked == MOTION | {"samples", "drawing"}


def test_lines_for_a_board_ask_for_their_kernels(tmp_path: Path, asked) -> None:
    checked(tmp_path, "G61\n" + CORNER, outputs=Outputs(lines=str(tmp_path / "lines.gcode")))
    assert asked == MOTION | {*READING, "GRBL lines"}


def test_a_board_that_moves_asks_for_holds(tmp_path: Path, asked) -> None:
    (tmp_path / "p.nc").write_text("G61\nG1 X0.1 F600\nM2\n")
    machine = load_machine()
    run_with(tmp_path / "p.nc", machine, board=PacedLoopback(machine, (0.0, 0.0, 0.0)))
    assert asked == MOTION | {"holds"}


def test_a_long_program_asks_for_reading_first(tmp_path: Path, asked, monkeypatch) -> None:
    monkeypatch.setattr(kernel_needs, "SMALL_BYTES", 0)
    order: list[tuple[str, ...]] = []
    monkeypatch.setattr(
        kernel_needs, "ensure_compiled", lambda _, __, names: order.append(tuple(names))
    )
    checked(tmp_path, "G64 P0.05\n" + CORNER)
    assert order[0] == READING
    assert order[1] == FITS
    assert set(order[-1]) == MOTION | set(BLENDS)


def test_a_wrong_program_asks_for_nothing(tmp_path: Path, asked) -> None:
    file = tmp_path / "p.nc"
    file.write_text("G21 G90\nG1 X\n")
    assert not check_with(file).ok
    file.write_text("G21 G90\nG1 X9999 F100\n")
    assert not check_with(file).ok
    assert asked == set()


@pytest.fixture
def called(monkeypatch: pytest.MonkeyPatch) -> set[str]:
    """Return the set to which the module of each kernel is added that Python calls compiled."""
    modules: set[str] = set()
    call = kernel.Kernel.__call__

    def recorded(self: kernel.Kernel, *arguments: Any) -> Any:
        if kernel.compiled_modules.get() is None:
            modules.add(self.__module__)
        return call(self, *arguments)

    monkeypatch.setattr(kernel.Kernel, "__call__", recorded)
    return modules


@compiled
@pytest.mark.parametrize(
    "name", ["trident", "engraving", "siemens-bspline", *share(["pocket"], [])]
)
def test_what_a_program_calls_it_has_asked_for(name: str, asked, called) -> None:
    run_with(ROOT / "programs" / f"{name}.nc")
    known = frozenset().union(*(JOBS[job].modules for job in asked))
    assert called
    assert called <= known


@pytest.mark.soak
@compiled
def test_no_kernel_of_motion_has_a_second_set_of_types() -> None:
    """The examples of the jobs call the kernels with the types with which programs call them."""
    code = """
from collections import Counter
from cnc.compiled.loader import loader
from cnc.session.kernel_cache import load_kernels
from cnc.session.kernel_jobs import JOBS
from cnc.api import check
load_kernels(JOBS)
for name in ("trident", "engraving"):
    check(f"programs/{name}.nc")
# folder/kernel-types.code; text comes in two kinds of arrays
types = Counter(file.rpartition("-")[0] for file in loader.files
                if file.endswith(".code") and not file.startswith("gcode."))
assert types
several = [kernel for kernel, count in types.items() if count > 1]
assert not several, several
"""
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, timeout=HANG)


@compiled
def test_the_example_of_a_fit_calls_each_kernel_of_a_fit() -> None:
    """Another one would be compiled when a program needs it first."""
    code = """
from cnc.compiled.kernel import Kernel
from cnc.path import fit
from cnc.session import kernel_examples

kernel_examples.fit()
kernels = {name: each for name, each in vars(fit).items() if isinstance(each, Kernel)}
assert len(kernels) > 10
assert [name for name, each in kernels.items() if not each._entries] == []
"""
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, timeout=HANG)


@compiled
def test_nothing_is_compiled_during_a_run(tmp_path: Path) -> None:
    """The examples of the jobs make all that programs call, so numba need not be imported."""
    code = f"""
import sys
from cnc import Outputs, RunOptions, check, run
from cnc.session.kernel_cache import ensure_compiled

ensure_compiled()
for name in ("trident", "pocket", "engraving"):
    assert check(f"programs/{{name}}.nc").ok
lines = Outputs(lines={str(tmp_path / "lines.gcode")!r})
assert check("programs/pocket.nc", options=RunOptions(outputs=lines, interpolator="sampled")).ok
assert run("programs/trident.nc", "config/stepper-uno.toml", board="loopback").ok
# Holds inside of motions past corners, and one behind them.
from tests.planner.test_hold_in_corners import rests
assert all(rests(seed) for seed in (5, 11, 37))
assert "numba.core" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, timeout=HANG)


@compiled
def test_a_check_imports_only_what_it_needs() -> None:
    """Each of these would lengthen the start of all programs."""
    code = """
import sys
from cnc.cli import exit_code

assert exit_code(["check", "programs/trident.nc"]) == 0
unneeded = {
    "numba", "lark", "rich", "scipy", "cnc.checks.baseline", "cnc.session.homing",
    "cnc.gcode.turning.cycles", "cnc.gcode.turning.roughing", "cnc.grbl_lines.translator",
    "cnc.session.run_lines", "cnc.grbl_lines.grbl_timing", "cnc.view.writer",
    "cnc.stock.simulation", "cnc.stock.stl", "cnc.checks.tool_list", "cnc.report.findings",
    "cnc.batch.dask_cluster", "cnc.machine.height_map", "cnc.path.warp", "numpy.polynomial",
    "xml.etree.ElementTree", "asyncio", "serial",
}
found = unneeded & set(sys.modules)
assert not found, found
"""
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, timeout=HANG)


def fresh(folder: Path) -> dict[str, str]:
    return os.environ | {"NUMBA_CACHE_DIR": str(folder / "cache"), "PYTHONPATH": str(ROOT)}


@compiled
def test_a_new_installation_answers_without_the_compiler(tmp_path: Path) -> None:
    (tmp_path / "p.nc").write_text("G1 X\n")
    code = """
import sys
from cnc.cli import exit_code
for arguments in ["--help"], ["--version"], ["schema", "machine"], ["check", "p.nc"]:
    assert exit_code(arguments) == (arguments[0] == "check"), arguments
    assert "numba" not in sys.modules, arguments
"""
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env=fresh(tmp_path),
        capture_output=True,
        text=True,
        timeout=HANG,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("number-missing") == 1
    assert not list((tmp_path / "cache").glob("*/*"))


@pytest.mark.soak
@compiled
def test_ctrl_c_leaves_whole_files_and_no_process(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "cnc.cli", "warm"],
        env=fresh(tmp_path),
        stderr=subprocess.PIPE,
        text=True,
    )
    cache = tmp_path / "cache"
    wait_until(lambda: list(cache.glob("*/*.code")) or process.poll() is not None)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=HANG)
    assert process.returncode == 130, err
    assert "stopped by the operator" in err
    assert "\r" not in err  # no progress bar in a pipe
    assert err.startswith("compiling the kernels")
    files = list(cache.glob("*/*.code"))
    assert files
    names = (path.relative_to(cache).as_posix() for path in files)
    assert all(code_cache.read(cache, name) is not None for name in names)
    assert not list(cache.glob("*.done"))


def test_jobs_are_done_once_in_their_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernel_cache, "compiling", lambda: True)
    monkeypatch.setattr(kernel_cache, "_marks", lambda job: [tmp_path / f"{job}-x.done"])
    monkeypatch.setattr(code_cache, "cache_folder", lambda: tmp_path)
    done: list[str] = []

    def compiled_now(jobs: list[str]) -> Iterator[str]:
        for job in jobs:
            done.append(job)
            (tmp_path / f"{job}-x.done").touch()
            yield f"kernel of {job}"

    monkeypatch.setattr(kernel_cache, "_compiled_by_workers", compiled_now)
    monkeypatch.setattr(kernel_cache, "_missing_kernels", lambda jobs: [None] * 5)
    told: list[Any] = []
    for _ in range(2):
        kernel_cache.ensure_compiled(
            lambda: told.append("begin"), lambda *what: told.append(what), ["pulses", "paths"]
        )
    assert done == ["paths", "pulses"]
    assert told == ["begin", (0, 5, "kernel of paths"), (1, 5, "kernel of pulses")]


def test_the_bar_counts_kernels_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = io.StringIO()
    terminal.isatty = lambda: True  # type: ignore[method-assign]
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "120")
    with progress.ProgressDisplay(Control(), quiet=False) as display:
        callbacks: Callbacks = display.callbacks()
        assert callbacks.on_compiling is None
        assert callbacks.on_kernel is not None
        callbacks.on_kernel(3, 40, "path.curve.curve_eval")
    assert "3 of 40 kernels" in terminal.getvalue()
    assert "path.curve.curve_eval" in terminal.getvalue()


def test_no_bar_in_a_pipe(capsys: pytest.CaptureFixture[str]) -> None:
    with progress.ProgressDisplay(Control(), quiet=False) as display:
        assert display.callbacks().on_kernel is None


def test_the_example_of_intervals_calls_the_kernel_of_junctions(monkeypatch) -> None:
    """Python calls it only where a path goes on in another part of it."""
    calls: list[object] = []
    monkeypatch.setattr(
        "cnc.planner.known_path.piece_junction", lambda *arguments: calls.append(arguments)
    )
    kernel_examples._cross()
    assert len(calls) == 1
