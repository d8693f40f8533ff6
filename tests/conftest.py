"""Settings of all tests.

Hypothesis makes the same examples in every run and has no deadline, because the first call of a
kernel compiles it. Positions of boards are kept in a temporary folder.
"""

import gc
import traceback
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

import cnc
from cnc.compiled import loader
from cnc.session.kernel_cache import is_compiled
from cnc.session.kernel_jobs import JOBS
from tests.support.soak import share, soaking

PRODUCT = Path(cnc.__file__).parent
COMPILED = PRODUCT / "compiled"
EXAMPLES = PRODUCT / "session" / "kernel_examples.py"

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


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out the tests with the marker ``soak``, except under ``make soak``."""
    if not soaking():
        left_out = [item for item in items if item.get_closest_marker("soak")]
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if not item.get_closest_marker("soak")]


def pytest_collection_finish() -> None:
    """Exclude all that was imported from garbage collection, which would visit it in every test."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def compiled_late():
    """Return a list to which each kernel is added that the product compiles outside of its jobs.

    A run would wait for the compiler there. It is empty where not all jobs are done: then a test
    compiles what it needs.
    """
    late: list[str] = []
    if not all(map(is_compiled, JOBS)):
        yield late
        return
    entry_of = loader.first_entry

    def first_entry(files, variables):
        entry = entry_of(files, variables)
        if entry is None:
            frames = [frame.filename for frame in traceback.extract_stack()]
            callers = [file for file in frames if not file.startswith(str(COMPILED))]
            if callers[-2].startswith(str(PRODUCT)) and str(EXAMPLES) not in callers:
                late.append(f"{callers[-2]}: {files[-1]}")
        return entry

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loader, "first_entry", first_entry)
        yield late


@pytest.fixture(autouse=True)
def nothing_is_compiled_late(compiled_late):
    """Fail a test in which a run would have waited for the compiler."""
    compiled_late.clear()
    yield
    assert not compiled_late


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
