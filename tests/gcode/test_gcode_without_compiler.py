"""The kernels of this room as plain Python: numbers that wrap round and types that only the compiler sees can't hide there."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOM = Path(__file__).parent
FILES = [str(ROOM / name) for name in ("test_scanner.py", "test_text.py", "test_straight.py")]
LEFT_OUT = "not words_of_the_grammar and not fast_lane_gives"


@pytest.mark.skipif(os.environ.get("NUMBA_DISABLE_JIT") == "1", reason="already without the compiler")
def test_the_same_without_the_compiler() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *FILES, "-k", LEFT_OUT],
        cwd=ROOM.parents[1],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1", "CNC_SOAK": "0"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-3000:]
    assert "passed" in done.stdout
