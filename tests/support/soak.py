"""Helpers that any test may import."""

import os
import subprocess
import sys
from pathlib import Path
from typing import TypeVar

from tests.support.paths import ROOT

Amount = TypeVar("Amount")


def soaking() -> bool:
    """Whether the long runs were asked for (``make soak``)."""
    return os.environ.get("CNC_SOAK") == "1"


def share(full: Amount, quick: Amount) -> Amount:
    """The amount of work of a long test: ``full`` under ``make soak``, ``quick`` in every run."""
    return full if soaking() else quick


def check_without_compiler(*paths: Path, some: str) -> None:
    """Run tests as plain Python, where an index out of its array can't go unnoticed: those that
    match ``some``.

    With the compiler switched off already they are run as they are.
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
