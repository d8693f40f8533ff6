"""The tests of planning find the kernels that a run would wait for."""

import traceback
from pathlib import Path

import pytest

import cnc
from cnc.compiled import loader
from cnc.session.kernel_cache import is_compiled
from cnc.session.kernel_jobs import JOBS

PRODUCT = Path(cnc.__file__).parent


@pytest.fixture(scope="session")
def compiled_late():
    """Return a list to which each kernel is added that the product compiles outside of its jobs.

    A run would wait for the compiler there. It stays empty where not all jobs are done: then a test
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
            frames = [Path(frame.filename) for frame in traceback.extract_stack()]
            callers = [file for file in frames if PRODUCT / "compiled" not in file.parents]
            # The last one is this function. Kernels that run as Python call others.
            caller, examples = callers[-2], PRODUCT / "session" / "kernel_examples.py"
            in_product = PRODUCT in caller.parents and caller.parent.name != "kernels"
            if in_product and examples not in callers:
                late.append(f"{caller}: {files[-1]}")
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
