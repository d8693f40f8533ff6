"""The kernels of the language without the compiler."""

from pathlib import Path

from tests.support.soak import check_without_compiler

FOLDER = Path(__file__).parent
FILES = [
    FOLDER / name
    for name in (
        "syntax/test_scanner.py",
        "syntax/test_source_text.py",
        "program/test_plain_lines.py",
    )
]
LEFT_OUT = "not words_of_the_grammar and not fast_lane_gives"


def test_results_are_equal_without_the_compiler() -> None:
    check_without_compiler(*FILES, some=LEFT_OUT)
