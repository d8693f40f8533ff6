"""The wheel and the source distribution hold all data files, and find them wherever they stand."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from cnc.gcode.reader.tables import NAMES
from tests.support.paths import ROOT

USE = """
import sys
sys.path.insert(0, sys.argv[1])
import cnc
assert cnc.__file__.startswith(sys.argv[1]), cnc.__file__
from cnc.gcode.reader.parser import parse_line
from cnc.machine.load import load_machine, shipped_machines
assert parse_line("G1 X[1 + 2]").words[1].letter == "X"
assert {"default", "grbl-uno"} <= set(shipped_machines())
print(load_machine("grbl-uno").axis_names)
"""
"""A program that reads a line by the grammar, and a shipped machine file."""


def _built(target: str, folder: Path) -> Path:
    """Build a distribution and return its file."""
    command = [sys.executable, "-m", "hatchling", "build", "-d", str(folder), "-t", target]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True, timeout=300)
    (file,) = folder.iterdir()
    return file


def test_a_wheel_with_compiled_kernels_is_for_one_platform(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "compiled" / "path.curve-x"
    folder.mkdir(parents=True)
    (folder / "curve_eval-0.code").write_bytes(b"code")
    monkeypatch.setenv("CNC_COMPILED", str(folder.parent))
    file = _built("wheel", tmp_path / "wheel")
    assert f"cp{sys.version_info.major}{sys.version_info.minor}-" in file.name
    assert not file.name.endswith("-any.whl")
    with zipfile.ZipFile(file) as archive:
        assert "cnc/compiled/code/path.curve-x/curve_eval-0.code" in archive.namelist()
        (tags,) = [name for name in archive.namelist() if name.endswith("/WHEEL")]
        assert b"Root-Is-Purelib: false" in archive.read(tags)
        tables = [name for name in archive.namelist() if name.endswith(".tables")]
    assert {name.split("/")[-1].split("-")[0] for name in tables} == set(NAMES)


RUNS = [
    ["check", "programs/trident.nc"],
    ["check", "programs/finishing.nc"],
    ["check", "programs/ngc-nurbs.nc"],
    ["check", "programs/pocket.nc", "--machine", "config/corexy.toml"],
    ["check", "programs/pocket.nc", "--machine", "config/delta.toml"],
    ["check", "programs/pocket.nc", "--stock", "X0:100,Y0:60,Z-12:0"],
    ["run", "programs/pocket.nc", "--quiet"],
    ["run", "programs/trident.nc", "--board", "grbl-sim", "--quiet"],
    [
        "run",
        "programs/trident.nc",
        "--machine",
        "config/klipper-uno.toml",
        "--board",
        "klipper-sim",
    ],
    ["view", "programs/trident.nc", "--output", "PLACE/trident.html"],
    ["convert", "programs/finishing.nc", "--to", "fanuc", "--curves", "nurbs", "-o", "PLACE/a.nc"],
    ["format", "programs/trident.nc", "--check"],
]
"""Commands that use most kernels together. PLACE stands for a folder."""


@pytest.mark.soak
def test_a_released_wheel_compiles_nothing(tmp_path: Path) -> None:
    """As ``make wheel`` builds it. The folder of a user's compiled code stays empty."""
    compiled, cache = tmp_path / "compiled", tmp_path / "cache"
    environment = os.environ | {"NUMBA_CPU_NAME": "generic", "NUMBA_CACHE_DIR": str(compiled)}
    warm = [sys.executable, "-m", "cnc.cli", "warm", "--quiet"]
    subprocess.run(warm, cwd=ROOT, env=environment, check=True, timeout=3000)
    command = [sys.executable, "-m", "hatchling", "build", "-d", str(tmp_path / "d"), "-t", "wheel"]
    building = os.environ | {"CNC_COMPILED": str(compiled)}
    subprocess.run(command, cwd=ROOT, env=building, check=True, capture_output=True, timeout=600)
    (file,) = (tmp_path / "d").iterdir()
    with zipfile.ZipFile(file) as archive:
        archive.extractall(tmp_path / "site")
    for arguments in RUNS:
        done = subprocess.run(
            [sys.executable, "-P", "-m", "cnc.cli"]
            + [argument.replace("PLACE", str(tmp_path)) for argument in arguments],
            cwd=ROOT,
            env=os.environ
            | {
                "PYTHONPATH": str(tmp_path / "site"),
                "XDG_CACHE_HOME": str(cache),
                "XDG_STATE_HOME": str(tmp_path / "state"),
                "NUMBA_CACHE_DIR": "",
            },
            capture_output=True,
            text=True,
            check=False,
            timeout=600,
        )
        # The form of the program is another one.
        expected = 1 if arguments[0] == "format" else 0
        assert done.returncode == expected, (arguments, done.stderr)
        assert "compiling" not in done.stderr, (arguments, done.stderr)
    assert not list(cache.rglob("*.code"))


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _built("wheel", tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The unpacked source distribution."""
    import tarfile

    folder = tmp_path_factory.mktemp("source")
    file = _built("sdist", folder / "dist")
    with tarfile.open(file) as archive:
        archive.extractall(folder, filter="data")
    return folder / file.name.removesuffix(".tar.gz")


def _used_from(place: Path, cache: Path) -> str:
    done = subprocess.run(
        [sys.executable, "-P", "-c", USE, str(place)],
        cwd=cache,
        env=os.environ | {"PYTHONPATH": "", "XDG_CACHE_HOME": str(cache)},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_checkout_finds_grammars_and_machines(tmp_path: Path) -> None:
    assert "x" in _used_from(ROOT, tmp_path)


def test_an_installed_wheel_finds_grammars_and_machines(wheel: Path, tmp_path: Path) -> None:
    place = tmp_path / "site"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(place)
    assert "x" in _used_from(place, tmp_path)


def test_a_wheel_on_the_path_finds_grammars_and_machines(wheel: Path, tmp_path: Path) -> None:
    assert "x" in _used_from(wheel, tmp_path)


@pytest.mark.soak
def test_an_unpacked_source_distribution_finds_grammars_and_machines(
    source: Path, tmp_path: Path
) -> None:
    assert "x" in _used_from(source, tmp_path)


def test_the_wheel_holds_what_the_repository_holds(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    for folder in ("grammars", "config"):
        for file in (ROOT / folder).iterdir():
            assert f"cnc/{folder}/{file.name}" in names
    for file in (ROOT / "cnc").rglob("*"):
        if file.suffix in {".py", ".toml", ".js", ".css", ".html"}:
            assert file.relative_to(ROOT).as_posix() in names
