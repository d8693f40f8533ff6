"""The amount of work of a test: quick in every run, full under ``make soak``."""

import os
import subprocess
import sys
from pathlib import Path
from typing import TypeVar

from tests.support.paths import ROOT

Amount = TypeVar("Amount")


def soaking() -> bool:
    """Return whether this is a run of ``make soak``."""
    return os.environ.get("CNC_SOAK") == "1"


def share(full: Amount, quick: Amount) -> Amount:
    """Return ``full`` under ``make soak``, else ``quick``."""
    return full if soaking() else quick


def check_without_compiler(*paths: Path, some: str) -> None:
    """Run tests without the compiler, where every index is checked.

    Without the compiler this does nothing: the tests run in this mode already.

    Args:
        paths: Files or folders of tests.
        some: The tests of them to run, as an expression for ``pytest -k``.
    """
    if os.environ.get("NUMBA_DISABLE_JIT") == "1":
        return
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-p",
            "no:cacheprovider",
            *map(str, paths),
            "-k",
            some,
        ],
        cwd=ROOT,
        env={**os.environ, "NUMBA_DISABLE_JIT": "1", "CNC_SOAK": "0"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-3000:]
