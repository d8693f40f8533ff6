"""Names of files and texts of programs that would control a terminal or a CI runner."""

from __future__ import annotations

import json
import os
from itertools import cycle, product
from pathlib import Path
from xml.etree import ElementTree

import pytest

from cnc.cli import exit_code
from tests.support.soak import share

pytestmark = pytest.mark.skipif(os.name == "nt", reason="Windows has no such names")
NAMES = [
    "\x1b[2J\x1b]0;title\x07.nc",
    "::stop-commands::pause.nc",
    " \t::error::blank.nc",
    "a\n::stop-commands::pause.nc",
    "a\r::stop-commands::pause.nc",
    "##[stop-commands]pause.nc",
    "\x9b31m\x7f.nc",
    "\u202egnp\u2028.nc",
    os.fsdecode(b"\xff\xfe.nc"),
]
PROGRAMS = {
    "right": "G21 G90\nG1 X1 F600\nM2\n",
    "wrong": "G21 G90\nG1 X9999 F600\nM2\n",
    "hostile": "::stop-commands::\x1b[2J\n##[stop-commands]x\nG1 X99999 (##[x]\n",
}
FORMATS = ["text", "json", "sarif", "junit", "github"]


def assert_harmless(text: str, *, own_commands: bool = False) -> None:
    for line in text.split("\n"):
        assert all(each.isprintable() for each in line), repr(line)
        assert "##[" not in line
        if line.lstrip().startswith("::"):
            assert own_commands
            assert line.startswith(("::error ", "::warning ", "::notice "))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def outputs(capsys: pytest.CaptureFixture[str]) -> tuple[str, str]:
    return capsys.readouterr()


@pytest.mark.parametrize(
    ("name", "form"), share(list(product(NAMES, FORMATS)), list(zip(NAMES, cycle(FORMATS))))
)
def test_a_check_shows_names_without_their_effect(
    folder: Path,
    capsys: pytest.CaptureFixture[str],
    request: pytest.FixtureRequest,
    name: str,
    form: str,
) -> None:
    """Names go through a process of their own for one form; the others have this one."""
    if form != "text" or name not in NAMES[:: share(1, 9)]:
        request.getfixturevalue("one_process")
    for kind, text in PROGRAMS.items():
        Path(name).write_text(text)
        code = exit_code(["check", "--format", form, "--", name])
        assert code == (0 if kind == "right" else 1)
        out, err = outputs(capsys)
        assert_harmless(out, own_commands=form == "github")
        assert_harmless(err)
        if form in ("json", "sarif"):
            found = json.loads(out)
            if form == "json":
                assert found["program"] == name
        elif form == "junit":
            ElementTree.fromstring(out)
    Path("other.nc").write_text(PROGRAMS["wrong"])
    assert exit_code(["check", "--format", form, "--", name, "other.nc"]) == 1
    out, err = outputs(capsys)
    assert_harmless(out, own_commands=form == "github")
    assert_harmless(err)


@pytest.mark.usefixtures("one_process")
@pytest.mark.parametrize("name", NAMES[:: share(1, 2)])
def test_messages_about_files_show_names_without_their_effect(
    folder: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    assert exit_code(["check", "--", name]) == 2
    Path("p.nc").write_text(PROGRAMS["right"])
    assert exit_code(["check", "p.nc", "--machine", name]) == 2
    assert exit_code(["check", "p.nc", "--json", f"none/{name}"]) == 2
    assert exit_code(["check", "p.nc", "--baseline", name]) == 2
    assert exit_code(["check", "p.nc", f"--{name}"]) == 2
    assert exit_code([name, "p.nc"]) == 2
    Path("inner").mkdir()
    Path("inner", name).write_text(PROGRAMS["wrong"])
    assert exit_code(["check", "inner", "--verbose"]) == 1
    Path("inner", name).write_text("G21 T1 M6\nG0 X1\nM2\n")
    assert exit_code(["tools", f"inner/{name}"]) == 0
    assert exit_code(["diff", "p.nc", f"inner/{name}"]) == 0
    out, err = outputs(capsys)
    assert_harmless(out)
    assert_harmless(err)


@pytest.mark.parametrize("suffix", [".svg", ".html"])
def test_a_picture_shows_names_without_their_effect(
    folder: Path, capsys: pytest.CaptureFixture[str], suffix: str
) -> None:
    for name in NAMES[:: share(1, 4)]:
        Path(name).write_text(PROGRAMS["right"])
        output = name.removesuffix(".nc") + suffix
        assert exit_code(["view", "--output", output, "--", name]) == 0
        drawn = Path(output).read_text(encoding="utf-8")
        assert "\x1b" not in drawn
        assert "\x9b" not in drawn
        out, err = outputs(capsys)
        assert_harmless(out)
        assert_harmless(err)
