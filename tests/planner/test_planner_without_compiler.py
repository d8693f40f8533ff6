"""A share of the planner's tests without the compiler."""

from pathlib import Path

import pytest

from tests.support.soak import check_without_compiler, share

SHARE = "valley or a_stop or too_fast or errata or tangent or jump or exact_stop or short_dwell"
QUICK = (
    f"({SHARE}) and not bad_input and not requests_at_joints "
    "and not (parts_of_a_piece and not (corexy and few)) "
    "or theoretical_time[0.1-blocks0]"
)
FULL = f"{SHARE} or theor or (cusp and not bad_input)"


FOLDER = Path(__file__).parent
FILES = [
    FOLDER / f"test_{name}.py"
    for name in ("corners", "joint_path", "legality", "lookahead", "operator")
]


@pytest.mark.own_code
def test_a_share_passes_without_the_compiler() -> None:
    check_without_compiler(*share((FOLDER,), FILES), some=share(FULL, QUICK))
