"""A share of the planner's tests as plain Python, where an index out of its array can't go unnoticed."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOM = Path(__file__).parent
SHARE = "valley or a_stop or cannot_be or theory or errata or tangent or jump or exact_stop or short_dwell or cusp"


@pytest.mark.skipif(os.environ.get("NUMBA_DISABLE_JIT") == "1", reason="already without the compiler")
def test_the_same_without_the_compiler():
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(ROOM), "-k", SHARE, "--ignore-glob=*bad_input*"],
        cwd=ROOM.parents[1],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1", "CNC_SOAK": "0"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-3000:]
    assert "passed" in done.stdout
