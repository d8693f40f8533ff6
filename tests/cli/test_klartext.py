"""A program of Heidenhain's Klartext on the command line."""

from __future__ import annotations

import shutil

from tests.support.paths import ROOT


def test_a_program_of_klartext_is_recognised(cncrun, tmp_path):
    for name in ("part.h", "part.nc"):
        file = tmp_path / name
        shutil.copy(ROOT / "programs" / "klartext.h", file)
        ended, out, err = cncrun("check", str(file))
        assert ended == 0, err
        assert "heidenhain (recognised)" in out + err
        assert "millimetres, as" not in out + err


def test_the_tools_of_klartext_are_listed(cncrun, tmp_path):
    ended, out, _ = cncrun("tools", str(ROOT / "programs" / "klartext.h"))
    assert ended == 0
    assert [
        line.split()[1] for line in out.splitlines() if line.startswith("; T") and line[3].isdigit()
    ] == ["T1", "T2"]
