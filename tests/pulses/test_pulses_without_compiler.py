"""The tests of this folder without the compiler: a share in every run, all in ``make soak``."""

from pathlib import Path

import pytest

from tests.support.soak import check_without_compiler, share

SHARE = (
    "(arcs_in_all_octants and 0.7-0) or cut_at_the_ends or turning_back or square[0] "
    "or circle_of_the_paper or ties or at_once or small_buffers or as_the_paper_has_it "
    "or integer_lines or joints or left_behind or dwells "
    "or rotary or nothing_moves or equations or goes_back"
)


@pytest.mark.own_code
def test_the_same_without_the_compiler() -> None:
    check_without_compiler(Path(__file__).parent, some=share("not without_the_compiler", SHARE))
