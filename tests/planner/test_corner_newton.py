"""A step of the search for a motion past corners, against a general solver."""

import numpy as np
import pytest

from cnc.planner.kernels.corner_newton import Newton, newton_step

FREE, WIDTH, GROUPS = 40, 9, 5


def system(rng, dense):
    """Return a random system: Newton's arrays, and the whole matrix.

    dense: whether the first column (else the last alone) has entries in all rows.
    """
    root = np.triu(rng.normal(size=(FREE, FREE))) * (
        np.abs(np.subtract.outer(np.arange(FREE), np.arange(FREE))) < WIDTH
    )
    inner = root.T @ root + 0.5 * np.eye(FREE)
    side = rng.normal(size=(GROUPS + 1, FREE))
    for g in range(GROUPS):
        begin = 0 if dense else FREE * g // GROUPS
        side[g, :begin] = 0.0
        side[g, begin + 2 * FREE // GROUPS :] = 0.0
    square = rng.normal(size=(GROUPS + 1, GROUPS + 1))
    block = square @ square.T + side @ np.linalg.solve(inner, side.T)
    band = np.zeros((FREE, WIDTH))
    for j in range(WIDTH):
        band[: FREE - j, j] = np.diagonal(inner, j)
    fields = dict.fromkeys(Newton._fields, np.zeros((1, 1)))
    fields |= {"spans": np.zeros(GROUPS), "least": np.zeros(GROUPS), "share": np.zeros(GROUPS)}
    fields |= {"tried_spans": np.zeros(GROUPS), "weight": np.zeros((1, 1, 1))}
    fields |= {"band": band, "side": side, "block": block}
    fields |= {"slope": rng.normal(size=FREE), "other": rng.normal(size=GROUPS + 1)}
    whole = np.block([[inner, side.T], [side, block]])
    return Newton(**fields), whole


@pytest.mark.parametrize("dense", [False, True])
@pytest.mark.parametrize(("first", "end"), [(0, GROUPS), (0, GROUPS + 1), (GROUPS, GROUPS + 1)])
@pytest.mark.parametrize("seed", range(3))
def test_a_step_solves_the_whole_system(seed, first, end, dense):
    n, whole = system(np.random.default_rng(seed), dense)
    used = [*range(FREE), *range(FREE + first, FREE + end)]
    gradient = np.concatenate((n.slope, n.other))[used]
    wanted = -np.linalg.solve(whole[np.ix_(used, used)], gradient)
    decrement = newton_step(n, first, end)
    assert n.slope == pytest.approx(wanted[:FREE], rel=1e-8, abs=1e-9)
    assert n.other[first:end] == pytest.approx(wanted[FREE:], rel=1e-8, abs=1e-9)
    assert not n.other[:first].any()
    assert not n.other[end:].any()
    assert decrement == pytest.approx(-gradient @ wanted, rel=1e-8)
