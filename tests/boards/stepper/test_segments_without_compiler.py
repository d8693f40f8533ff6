"""A share of the segments' tests without the compiler."""

from pathlib import Path

import pytest

from tests.support.soak import check_without_compiler

FILES = [Path(__file__).parent / name for name in ("test_segments.py", "test_windows.py")]


@pytest.mark.own_code
def test_segments_without_the_compiler() -> None:
    check_without_compiler(*FILES, some="flushed or refused")
