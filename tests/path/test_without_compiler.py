"""A share of the curves' tests without the compiler."""

from pathlib import Path

import pytest

from tests.support.soak import check_without_compiler, share

FILES = [
    Path(__file__).parent / f"test_{name}.py"
    for name in ("curve_kernels", "turning_and_bounds", "build")
]
REST = "arcs_in_all or spirals or measured_over or a_cusp or repeated_control or one_chunk"
SPANS = share("spans_are_the_nurbs", "spans_are_the_nurbs and -3]")


@pytest.mark.own_code
def test_the_same_without_the_compiler() -> None:
    check_without_compiler(*FILES, some=f"({SPANS}) or {REST}")
