"""Settings of all tests.

Hypothesis makes the same examples in every run and has no deadline, because the first call of a
kernel compiles it. Positions of boards are kept in a temporary folder.
"""

import gc
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from tests.support.soak import share, soaking

CONSOLE_IN_A_BROWSER = Path(__file__).parent / "server" / "page"

settings.register_profile(
    "cnc",
    derandomize=True,
    max_examples=share(100, 7),
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("cnc")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Collect tests without garbage collection: it takes a fifth of the time, and finds little."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out the tests with the marker ``soak``, except under ``make soak``.

    Those of the console in a browser come first: processes that have run out of tests take the last
    ones of others, and each would start a browser, and a server and a board for each file, anew.
    """
    if not soaking():
        left_out = [item for item in items if item.get_closest_marker("soak")]
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if not item.get_closest_marker("soak")]
    items.sort(key=lambda item: CONSOLE_IN_A_BROWSER not in item.path.parents)


def pytest_collection_finish() -> None:
    """Exclude all that was imported from garbage collection, which would visit it in every test."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def one_core():
    """Let a check of several programs start one process; each start costs half a second."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cnc.batch.pool.cores", lambda: 1)
        yield


@pytest.fixture
def one_process(monkeypatch):
    """Check several programs in this process: the start of a worker takes a second."""

    def check_here(tasks, *_):
        for index, task in enumerate(tasks):
            yield index, task.perform()

    monkeypatch.setattr("cnc.batch.pool._check_locally", check_here)


@pytest.fixture(scope="session", autouse=True)
def state_folder(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield
