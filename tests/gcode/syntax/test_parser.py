"""The parser: long lines, memory of lines, and the cache of the grammar."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from cnc.gcode.reader import tables
from cnc.gcode.reader.parser import MAX_LINE, MEMO, Syntax, parse_line
from cnc.gcode.reader.statements import Statement
from cnc.model.diagnostics import GcodeError
from tests.support.waiting import HANG
from tests.support.work import at_most


@pytest.mark.parametrize("length", [MAX_LINE, MAX_LINE + 1])
def test_the_longest_line(length: int) -> None:
    text = "G0 X1".ljust(length)
    if length <= MAX_LINE:
        assert len(parse_line(text).words) == 2
    else:
        with pytest.raises(GcodeError):
            parse_line(text)


@pytest.mark.parametrize(
    "text",
    [
        "X" + " " * 4000,
        "(X" + " " * 4000 + "c) 5",
        "X1" + " " * 4000 + "-",
        "X" + " 1" * 2000 + " x",
        "X" + "1 ." * 1300,
        "(" * 4000,
        "G1" * 2000 + "/",
        "-" * 4000,
        "X" * 4000,
    ],
)
def test_the_work_of_awkward_lines_grows_with_their_length(text: str) -> None:
    with pytest.raises(GcodeError), at_most(calls=200 * len(text)):
        parse_line(text)


def test_equal_lines_are_parsed_once_and_the_memo_is_bounded() -> None:
    assert parse_line("G0 X1.25") is parse_line("G0 X1.25")
    assert parse_line.cache_info().maxsize == MEMO


READ = "from cnc.gcode.reader.parser import parse_line; print(parse_line('G1 X2').words[1].number)"


def read_in_a_process(home: Path) -> None:
    environment = {**os.environ, "XDG_CACHE_HOME": str(home)}
    found = subprocess.run(
        [sys.executable, "-c", READ],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
        timeout=HANG,
    )
    assert (found.stdout, found.stderr) == ("2.0\n", "")


def test_the_grammar_is_cached_and_the_cache_is_used(tmp_path: Path) -> None:
    read_in_a_process(tmp_path)
    (cache,) = (tmp_path / "cnc").iterdir()
    written = cache.stat().st_mtime_ns
    read_in_a_process(tmp_path)
    assert [cache] == list((tmp_path / "cnc").iterdir())
    assert cache.stat().st_mtime_ns == written


def test_a_damaged_cache_is_replaced(tmp_path: Path) -> None:
    read_in_a_process(tmp_path)
    (cache,) = (tmp_path / "cnc").iterdir()
    cache.write_bytes(cache.read_bytes()[:100])
    read_in_a_process(tmp_path)
    whole = cache.stat()
    assert whole.st_size > 1000
    read_in_a_process(tmp_path)
    assert cache.stat().st_mtime_ns == whole.st_mtime_ns, "the new one is good"


def test_an_unwritable_cache_file(tmp_path: Path) -> None:
    """A folder of the same name. Root ignores permissions, but not this."""
    read_in_a_process(tmp_path)
    (cache,) = (tmp_path / "cnc").iterdir()
    cache.unlink()
    cache.mkdir()
    read_in_a_process(tmp_path)
    assert cache.is_dir()


def test_an_unwritable_cache_folder(tmp_path: Path) -> None:
    (tmp_path / "cnc").write_text("a file where the folder should be")
    read_in_a_process(tmp_path)


def test_the_cache_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert tables.cache_folder() == tmp_path / "cnc"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr(sys, "platform", "linux")
    assert tables.cache_folder() == tmp_path / ".cache" / "cnc"
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path / "local"))
    assert tables.cache_folder() == tmp_path / "local" / "cnc" / "cache"


@pytest.mark.parametrize(
    ("text", "read"),
    [
        ("G28 X Y ; home X", "G28 X0 Y0"),
        ("N2 g28 z*71", "N2 G28 Z0"),
        ("G28 O X", "G28 X0"),
        ("G28 W", "G28"),
        ("G28 X5 Y", "G28 X5 Y0"),
    ],
)
def test_the_homing_of_marlin_names_axes_without_numbers(text: str, read: str) -> None:
    numbers = [
        [
            (word.letter, word.number)
            for word in parse_line(each, Syntax("ngc", dialect=dialect)).words
        ]
        for each, dialect in ((text, "marlin"), (read, "linuxcnc"))
    ]
    assert numbers[0] == numbers[1]
    with pytest.raises(GcodeError):
        parse_line("G28 X Y", Syntax("ngc", dialect="linuxcnc"))


@pytest.mark.parametrize("text", ["*71", " *7 ", "\t*0"])
def test_a_line_of_only_a_checksum_is_empty(text: str) -> None:
    """Senders of Marlin number and sum every line, empty ones too."""
    assert parse_line(text, Syntax("ngc", dialect="marlin")) == Statement()
