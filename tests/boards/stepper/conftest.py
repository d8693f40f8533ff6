"""Fixtures of the stepper board: the simulated board, and a host that has configured it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.support.boards.stepper_host import Host
from tests.support.boards.stepper_rig import STACK
from tests.support.boards.stepper_simulator import Simulator


@pytest.fixture
def simulator() -> Iterator[Simulator]:
    """Yield the simulated board; afterwards it must have lost no byte and have stack left."""
    made = Simulator()
    yield made
    assert made.lost == 0
    assert made.worst_fill <= 2
    assert made.stack_left > STACK
    made.close()


@pytest.fixture
def host(simulator: Simulator) -> Host:
    """Return a host that has configured the board and set its position."""
    made = Host(simulator)
    made.hear()
    assert made.configure()
    assert made.stand_at(100, -200, 300)
    return made
