"""Fixtures of the command line: a program file, and a command in this process."""

from __future__ import annotations

import pytest

from cnc import cli


@pytest.fixture
def program(tmp_path):
    def write(text: str, name: str = "p.nc") -> str:
        file = tmp_path / name
        file.parent.mkdir(exist_ok=True, parents=True)
        file.write_text(text)
        return str(file)

    return write


@pytest.fixture
def cncrun(capfd):
    """Return a function that gives exit code, standard output and standard error."""

    def carry_out(*arguments: str) -> tuple[int, str, str]:
        code = cli.exit_code(arguments)
        out, err = capfd.readouterr()
        return code, out, err

    return carry_out
