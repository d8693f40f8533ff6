"""Lines from files, and the grammar's cache."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from cnc.errors import GcodeError, UsageError
from cnc.gcode import parser
from cnc.gcode.parser import MAX_LINE, MEMO, parse_line, read_lines


def lines_of(folder: Path, data: bytes) -> list[str]:
    path = folder / "a.nc"
    path.write_bytes(data)
    return list(read_lines(path))


@pytest.mark.parametrize(
    ("data", "lines"),
    [
        (b"", []),
        (b"a", ["a"]),
        (b"a\n", ["a"]),
        (b"a\n\nb", ["a", "", "b"]),
        (b"a\r\nb\r\n", ["a", "b"]),
        (b"a\rb\r", ["a", "b"]),
        (b"a\r\rb", ["a", "", "b"]),
        (b"\xef\xbb\xbfG0", ["G0"]),
        (b"\xef\xbb\xbf", []),
        (b"(\xc3\xa4)\n(\xe4)\n", ["(\xe4)", "(\xe4)"]),
        (b"a\x0bb\x0cc\x1cd\xc2\x85e\n", ["a\x0bb\x0cc\x1cd\x85e"]),
    ],
)
def test_lines_of_a_file(tmp_path: Path, data: bytes, lines: list[str]) -> None:
    assert lines_of(tmp_path, data) == lines


@pytest.mark.parametrize("end", [b"\n", b"\r\n", b"\r"])
@pytest.mark.parametrize("shift", range(4))
def test_a_line_end_on_the_border_of_a_chunk(tmp_path: Path, end: bytes, shift: int) -> None:
    """The file is read in pieces of 65536 bytes after the first three."""
    count = 3 + 65536 - 2 + shift
    second = count - 100 - len(end)
    assert lines_of(tmp_path, b"x" * 100 + end + b"y" * second + end + b"G0") == ["x" * 100, "y" * second, "G0"]


def test_a_file_without_line_ends_is_read_in_pieces(tmp_path: Path) -> None:
    pieces = lines_of(tmp_path, b"x" * 1_000_000)
    assert "".join(pieces) == "x" * 1_000_000
    assert max(map(len, pieces)) <= 2 * 65536 + 3
    assert len(pieces[0]) > MAX_LINE, "the language refuses it"


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(UsageError) as caught:
        next(read_lines(tmp_path / "none.nc"))
    assert caught.value.diagnostic.code == "no-such-file"


def test_a_file_that_can_not_be_read(tmp_path: Path) -> None:
    with pytest.raises(UsageError) as caught:
        next(read_lines(tmp_path))
    assert caught.value.diagnostic.code == "unreadable-file"


def test_reading_streams(tmp_path: Path) -> None:
    path = tmp_path / "long.nc"
    path.write_bytes(b"G0 X1\n" * 50_000)
    lines = read_lines(path)
    next(lines)
    path.write_bytes(b"")
    assert sum(1 for _ in lines) < 50_000


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
def test_awkward_lines_take_no_time(text: str) -> None:
    import time

    begin = time.process_time()
    with pytest.raises(GcodeError):
        parse_line(text)
    assert time.process_time() - begin < 0.5


def test_equal_lines_are_parsed_once_and_the_memo_is_bounded() -> None:
    assert parse_line("G0 X1.25") is parse_line("G0 X1.25")
    assert parse_line.cache_info().maxsize == MEMO


READ = "from cnc.gcode.parser import parse_line; print(parse_line('G1 X2').words[1].number)"


def read_in_a_process(home: Path) -> None:
    environment = {**os.environ, "XDG_CACHE_HOME": str(home)}
    found = subprocess.run([sys.executable, "-c", READ], env=environment, capture_output=True, text=True, check=True, timeout=60)
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


def test_a_cache_that_can_not_be_written(tmp_path: Path) -> None:
    """Permissions do not bind a superuser, but a folder in the file's place binds everybody."""
    read_in_a_process(tmp_path)
    (cache,) = (tmp_path / "cnc").iterdir()
    cache.unlink()
    cache.mkdir()
    read_in_a_process(tmp_path)
    assert cache.is_dir()


def test_a_cache_folder_that_can_not_be_made(tmp_path: Path) -> None:
    (tmp_path / "cnc").write_text("a file where the folder should be")
    read_in_a_process(tmp_path)


def test_the_cache_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert parser.cache_folder() == tmp_path / "cnc"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr(sys, "platform", "linux")
    assert parser.cache_folder() == tmp_path / ".cache" / "cnc"
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path / "local"))
    assert parser.cache_folder() == tmp_path / "local" / "cnc" / "cache"
