"""A share of the planner's tests without the compiler."""

from pathlib import Path

from tests.support.soak import check_without_compiler

SHARE = (
    "valley or a_stop or too_fast or theor or errata or tangent or jump or exact_stop"
    " or short_dwell or (cusp and not bad_input)"
)


def test_a_share_passes_without_the_compiler() -> None:
    check_without_compiler(Path(__file__).parent, some=SHARE)
