"""The kernels behind reading, without the compiler."""

from pathlib import Path

from support import check_without_compiler

ROOM = Path(__file__).parent
FILES = [ROOM / name for name in ("test_scanner.py", "test_text.py", "test_straight.py")]
LEFT_OUT = "not words_of_the_grammar and not fast_lane_gives"


def test_the_same_without_the_compiler() -> None:
    check_without_compiler(*FILES, some=LEFT_OUT)
