"""The kernels of the language without the compiler."""

from pathlib import Path

import pytest

from tests.support.soak import check_without_compiler, share

FOLDER = Path(__file__).parent
FILES = [
    FOLDER / name
    for name in (
        "reader/test_lines.py",
        "syntax/test_source_text.py",
        "program/test_plain_lines.py",
        *share(("program/test_compiled_lines_in_programs.py",), ()),
        "syntax/test_compiled_expressions.py",
    )
]
LEFT_OUT = "not words_of_the_grammar and not fast_lane_gives"
LONG = (
    " and not (polyline_is_full and True) and not (power_on_arrays and True) and not on_demand "
    "and not memoised and not label_of_random and not polylines_are_cut and not at_once "
    "and not (between_other_blocks and (4094 or 4097 or 7000))"
)
"""Of the long polylines those that end at the end of an array, or a move before it, stay."""


@pytest.mark.own_code
def test_results_are_equal_without_the_compiler() -> None:
    check_without_compiler(*FILES, some=LEFT_OUT + share("", LONG))
