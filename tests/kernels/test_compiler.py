"""Compiled code on disk: shared by processes, whole or not there, loaded without a compiler."""

from __future__ import annotations

import importlib
import json
import os
import pickle
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from cnc.compiled import code_cache, jit
from cnc.compiled.loader import Code
from tests.support.paths import ROOT
from tests.support.soak import share
from tests.support.waiting import HANG, wait_until

pytestmark = [
    pytest.mark.own_code,
    pytest.mark.skipif(not jit.compiling(), reason="kernels run as plain Python"),
]

KERNELS = '''
from cnc.compiled.jit import njit


@njit
def small(x: float) -> float:
    return x + 1.0


@njit
def large(x: float, n: int) -> float:
    """Return a sum; longer than what callers contain."""
    total = 0.0
    for k in range(n):
        if k % 3 == 0:
            total += small(x) * k
        elif k % 3 == 1:
            total -= x / (k + 1.0)
        else:
            total *= 0.5
        if total > 100.0 * k:
            total -= 7.0 * x
        if total < -100.0 * k:
            total += 11.0 * x
    return total


@njit
def top(x: float, n: int) -> float:
    return large(x, n) + large(2.0 * x, n)
'''
EXPECTED = (1.5, 10)
CALL = """
import json, sys
from cnc.compiled import jit
import example
sys.stdout.write("ready\\n"); sys.stdout.flush()
sys.stdin.readline()
from cnc.compiled.kernel import watchers
compiled = []
watchers.append(lambda kernel: compiled.append(kernel.name))
value = example.top(1.5, 10)
print(json.dumps([value, compiled]))
"""


class Place:
    """A folder with a file of kernels and a cache, and processes that call them."""

    def __init__(self, folder: Path) -> None:
        self.source, self.cache = folder / "example.py", folder / "cache"
        self.source.write_text(KERNELS)
        self._path = os.pathsep.join((str(ROOT), str(folder)))

    def start(self, code: str = CALL, **environment: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-c", code],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ
            | {"PYTHONPATH": self._path, "NUMBA_CACHE_DIR": str(self.cache)}
            | environment,
        )

    def call(self, **environment: str) -> tuple[float, list[str]]:
        """Return the value, and the kernels that were compiled for it."""
        return answer(self.start(**environment))

    def files(self, name: str = "*") -> list[Path]:
        return sorted(self.cache.glob(f"example-*/{name}"))


def contents(path: Path) -> bytes:
    """Return the contents of a file of compiled code; nothing if it is damaged."""
    return code_cache.read(path.parents[1], f"{path.parent.name}/{path.name}") or b""


def code_of(path: Path) -> Code:
    return Code._make(pickle.loads(contents(path)))


def answer(process: subprocess.Popen[str]) -> tuple[float, list[str]]:
    out, _ = process.communicate("go\n", timeout=HANG)
    assert process.returncode == 0
    value, compiled = json.loads(out.splitlines()[-1])
    return value, compiled


def in_python() -> float:
    names: dict[str, Any] = {}
    exec(KERNELS.replace("from cnc.compiled.jit import njit", "njit = lambda f: f"), names)
    return float(names["top"](*EXPECTED))


@pytest.fixture
def place(tmp_path: Path) -> Place:
    return Place(tmp_path)


@pytest.fixture(scope="module")
def first_call(tmp_path_factory: pytest.TempPathFactory) -> tuple[Place, tuple[float, list[str]]]:
    """A place whose kernels were called once, and the answer to this call."""
    place = Place(tmp_path_factory.mktemp("code"))
    return place, place.call()


@pytest.fixture(scope="module")
def code(first_call: tuple[Place, tuple[float, list[str]]]) -> Path:
    """A folder with the compiled code of the kernels, to be copied."""
    return first_call[0].cache


@pytest.fixture
def warm(place: Place, code: Path) -> Place:
    """A place whose kernels have been compiled."""
    shutil.copytree(code, place.cache)
    return place


def test_a_kernel_is_compiled_once_and_then_loaded(first_call: tuple[Place, Any]) -> None:
    place, (value, compiled) = first_call
    assert value == in_python()
    assert compiled == ["top", "large", "small"]
    assert place.call() == (value, [])


@pytest.mark.soak
def test_a_caller_contains_small_kernels_only(warm: Place) -> None:
    code = {path.name.partition("-")[0]: path.read_bytes() for path in warm.files("*.code")}
    assert code.keys() == {"small", "large", "top"}
    (each,) = warm.files("large-*.code")
    each.unlink()
    # The caller's code is loaded; what it refers to is made anew, under the same name.
    assert warm.call() == (in_python(), ["large"])
    (small,) = warm.files("small-*.code")
    small.unlink()
    assert warm.call() == (in_python(), [])


def test_two_processes_compile_each_kernel_once(place: Place) -> None:
    processes = [place.start() for _ in range(2)]
    for process in processes:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
    for process in processes:
        assert process.stdin is not None
        process.stdin.write("go\n")
        process.stdin.flush()
    results = [answer(process) for process in processes]
    assert [value for value, _ in results] == [in_python()] * 2
    assert sorted(results[0][1] + results[1][1]) == ["large", "small", "top"]


def test_a_killed_process_leaves_no_lock(place: Place) -> None:
    hold = """
import sys
from cnc.compiled import code_cache
with code_cache.locked("a kernel"):
    print("held", flush=True)
    sys.stdin.readline()
"""
    holder = place.start(hold)
    assert holder.stdout is not None
    assert holder.stdout.readline() == "held\n"
    waiting = place.start(hold)
    assert waiting.stdout is not None
    holder.kill()
    holder.communicate()
    assert waiting.stdout.readline() == "held\n"
    waiting.communicate("\n", timeout=HANG)
    assert waiting.returncode == 0


def test_a_lock_is_waited_for(place: Place) -> None:
    hold = """
import sys
from pathlib import Path
from cnc.compiled import code_cache
mine = sys.argv[1:] or ["second"]
with code_cache.locked("a kernel"):
    print("held", flush=True)
    sys.stdin.readline()
    Path(code_cache.cache_folder(), "released").touch()
"""
    look = """
from pathlib import Path
from cnc.compiled import code_cache
print("asks", flush=True)
with code_cache.locked("a kernel"):
    print(Path(code_cache.cache_folder(), "released").exists(), flush=True)
"""
    holder = place.start(hold)
    assert holder.stdout is not None
    assert holder.stdout.readline() == "held\n"
    second = place.start(look)
    assert second.stdout is not None
    assert second.stdout.readline() == "asks\n"
    holder.communicate("\n", timeout=HANG)
    assert second.stdout.readline() == "True\n"
    second.communicate(timeout=HANG)


def test_damaged_files_are_compiled_again(warm: Place) -> None:
    for each in warm.files("*.code"):
        whole = each.read_bytes()
        each.write_bytes(
            {
                "top": b"",
                "large": b"half of a fi",
                "small": whole[:-1] + bytes([whole[-1] ^ 1]),
            }[each.name.partition("-")[0]]
        )
    assert warm.call() == (in_python(), ["top", "large", "small"])
    assert warm.call() == (in_python(), [])


def swap(one: Path, other: Path) -> None:
    whole = one.read_bytes()
    one.write_bytes(other.read_bytes())
    other.write_bytes(whole)


def in_its_place(make: Callable[[Path], object]) -> Callable[[list[Path]], None]:
    """Return a damage: something else is in the place of each file."""

    def damage(files: list[Path]) -> None:
        for file in files:
            file.unlink()
            make(file)

    return damage


def no_folder(files: list[Path]) -> None:
    """Put a file in the place of the folder."""
    shutil.rmtree(files[0].parent)
    files[0].parent.touch()


def link_to_nothing(files: list[Path]) -> None:
    shutil.rmtree(files[0].parent)
    files[0].parent.symlink_to("nowhere")


DAMAGES: dict[str, Callable[[list[Path]], object]] = {
    "two files swapped": lambda files: swap(*files[:2]),
    "all files alike": lambda files: [file.write_bytes(files[0].read_bytes()) for file in files],
    "a pipe": in_its_place(os.mkfifo),
    "a folder": in_its_place(lambda file: (file / "inner").mkdir(parents=True)),
    "a link to nothing": in_its_place(lambda file: file.symlink_to("nowhere")),
    "a link to a folder": in_its_place(lambda file: file.symlink_to(".")),
    "no permission": lambda files: [file.chmod(0) for file in files],
    "a file instead of the folder": no_folder,
    "a link to nothing instead of the folder": link_to_nothing,
}


@pytest.mark.skipif(os.name == "nt", reason="Windows has no pipes in folders")
@pytest.mark.parametrize("name", [*DAMAGES][:: share(1, 2)])
def test_a_cache_that_is_damaged_in_any_way_heals(warm: Place, name: str) -> None:
    DAMAGES[name](warm.files("*.*"))
    value, _ = warm.call()
    assert value == in_python()
    assert warm.call() == (in_python(), [])


RECORDS = '''
import numpy as np

from cnc.compiled.jit import njit

ROW = np.dtype([("x", "f8"), ("n", "i8")])


@njit
def large(row, n):
    """Change a record; longer than what callers contain."""
    total = 0.0
    for k in range(n):
        if k % 3 == 0:
            total += row["x"] * k
        elif k % 3 == 1:
            total -= row["x"] / (k + 1.0)
        else:
            total *= 0.5
        if total > 100.0 * k:
            total -= 7.0 * row["x"]
        if total < -100.0 * k:
            total += 11.0 * row["x"]
        row["n"] += k
    return total


@njit
def top(rows, n):
    return large(rows[0], n) + large(rows[1], n)
'''
CALL_WITH_RECORDS = """
import json
import numpy as np
from numba import from_dtype
from cnc.compiled.kernel import watchers
for k in range({others}):
    from_dtype(np.dtype([(f"a{{k}}", "f8")]))
import example
compiled = []
watchers.append(lambda kernel: compiled.append(kernel.name))
print(json.dumps([example.top(np.ones(2, dtype=example.ROW), 10), compiled]))
"""


def test_a_missing_kernel_of_records_is_made_under_the_same_name(place: Place) -> None:
    """numba counts the types of records of a process, and puts this count into names."""
    place.source.write_text(RECORDS)
    value, compiled = answer(place.start(CALL_WITH_RECORDS.format(others=0)))
    assert compiled == ["top", "large"]
    (large,) = place.files("large-*.code")
    before = code_of(large)
    large.unlink()
    assert answer(place.start(CALL_WITH_RECORDS.format(others=5))) == (value, ["large"])
    assert code_of(large)[:3] == before[:3]
    assert answer(place.start(CALL_WITH_RECORDS.format(others=3))) == (value, [])


def test_callers_of_a_function_of_another_name_are_compiled_again(warm: Place) -> None:
    """LLVM would not check the name: the call of a function that is not there crashes."""
    (top,) = warm.files("top-*.code")
    (wrapper,) = warm.files("top-*.wrapper")
    for file in (top, wrapper):
        code = code_of(file)
        renamed = code._replace(needs={need: f"{name}x" for need, name in code.needs.items()})
        name = f"{file.parent.name}/{file.name}"
        code_cache.write(warm.cache, name, pickle.dumps(tuple(renamed)))
    assert warm.call() == (in_python(), ["top"])
    assert warm.call() == (in_python(), [])


def test_a_compiling_process_that_is_killed_leaves_whole_files(place: Place) -> None:
    process = place.start()
    assert process.stdin is not None
    process.stdin.write("go\n")
    process.stdin.flush()
    wait_until(lambda: place.files("*.code") or process.poll() is not None)
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=HANG)
    assert all(contents(path) for path in place.files("*.code"))
    value, compiled = place.call()
    assert value == in_python()
    assert len(compiled) < 3


@pytest.mark.soak
def test_installed_code_serves_another_processor(place: Place, tmp_path: Path) -> None:
    """Code for any processor is found beside the sources; nothing is compiled or written."""
    place.call(NUMBA_CPU_NAME="generic")
    installed = tmp_path / "installed"
    place.cache.rename(installed)
    elsewhere = CALL.replace(
        "import example",
        f"""
from pathlib import Path
from cnc.compiled import code_cache
code_cache.SHIPPED = Path({str(installed)!r})
import example""",
    )
    assert answer(place.start(elsewhere)) == (in_python(), [])
    assert not place.files()
    # Installed code of another text is not used.
    place.source.write_text(KERNELS.replace("x + 1.0", "x + 2.0"))
    value, compiled = answer(place.start(elsewhere))
    assert value != in_python()
    assert compiled == ["top", "large", "small"]


@pytest.mark.soak
def test_a_change_of_the_processor_compiles_again(warm: Place) -> None:
    assert warm.call(NUMBA_CPU_NAME="generic") == (in_python(), ["top", "large", "small"])
    assert warm.call() == (in_python(), [])


def test_kernels_run_as_python_where_nothing_is_compiled(
    kernel_of: Callable[[Mapping[str, Any]], Any],
) -> None:
    calls: list[str] = []
    kernel = kernel_of({"calls": calls})
    with jit.as_python():
        assert kernel(1.0) == 2.0
    assert calls == ["called"]
    assert "dispatcher" not in vars(kernel)


def test_an_interpreted_kernel_calls_other_kernels_as_python() -> None:
    """Else a single call of it would compile them."""
    variables: dict[str, Any] = {}
    exec(
        "def inner(x):\n    return x + 1.0\n"
        "def middle(x):\n    return 2.0 * inner(x)\n"
        "def outer(x, more=0.5):\n    return middle(x) + inner(x) + more\n",
        variables,
    )
    for name in ("inner", "middle", "outer"):
        variables[name].__module__ = "example"
        variables[name] = jit.njit(variables[name])
    assert jit.interpreted(variables["outer"])(1.0) == 6.5
    assert not [name for name in ("inner", "middle") if "dispatcher" in vars(variables[name])]


@pytest.fixture
def kernel_of() -> Callable[[Mapping[str, Any]], Any]:
    def make(names: Mapping[str, Any]) -> Any:
        variables = dict(names)
        exec("def f(x):\n    calls.append('called')\n    return x + 1.0\n", variables)
        variables["f"].__module__ = "example"
        return jit.njit(variables["f"])

    return make


def test_modules_can_be_excepted_from_running_as_python(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "excepted.py").write_text("def f(x):\n    return x + 1.0\n")
    monkeypatch.syspath_prepend(tmp_path)
    kernel = jit.njit(importlib.import_module("excepted").f)
    with jit.as_python(except_in=frozenset({"excepted"})):
        assert kernel(1.0) == 2.0
    assert kernel.is_on_disk


def test_code_on_disk_is_called_without_the_compiler(warm: Place) -> None:
    code = """
import json, sys
import example
value = example.top(1.5, 10)
assert not [name for name in ("numba", "numba.core") if name in sys.modules]
print(json.dumps([value, []]))
"""
    assert answer(warm.start(code)) == (in_python(), [])


WITH_ALL_WORK = CALL.replace(
    "compiled = []",
    "import contextlib; from cnc.compiled import compiler;"
    " compiler.repeated_work_left_out = contextlib.nullcontext; compiled = []",
)


@pytest.mark.soak
def test_the_machine_code_is_that_of_a_compiler_that_repeats_its_work(
    warm: Place, tmp_path: Path
) -> None:
    (tmp_path / "again").mkdir()
    again = Place(tmp_path / "again")
    assert answer(again.start(WITH_ALL_WORK))[0] == in_python()
    codes = []
    for place in (warm, again):
        found = {file.name: code_of(file) for file in place.files("*.*")}
        codes.append({name: (each.symbol, each.code) for name, each in found.items()})
    assert len(codes[0]) == 4  # small, large, top, and its conversion of arguments
    assert codes[0] == codes[1]
