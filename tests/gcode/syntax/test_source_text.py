"""The text of a program by line number: files and lines in memory, in any order."""

from __future__ import annotations

import os
import random
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from cnc.gcode.reader import source_text as module
from cnc.gcode.reader.parser import Syntax
from cnc.gcode.reader.source_text import KEPT_WINDOWS, Text, Window
from cnc.model.diagnostics import GcodeError, UsageError
from tests.support.soak import share

NGC = Syntax()


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr(module, "WINDOW_BYTES", 64)
    return 64


def texts(text: Text) -> list[str]:
    found: list[str] = []
    while window := text.window(len(found) + 1):
        assert window.first == len(found) + 1
        found += [window.text(index) for index in range(window.count)]
    assert text.lines == len(found)
    return found


def lines_of(folder: Path, data: bytes) -> list[str]:
    path = folder / "a.nc"
    path.write_bytes(data)
    return texts(Text.of_file(path))


@pytest.mark.parametrize(
    ("data", "lines"),
    [
        (b"", []),
        (b"a", ["a"]),
        (b"a\n", ["a"]),
        (b"\n", [""]),
        (b"a\n\nb", ["a", "", "b"]),
        (b"a\r\nb\r\n", ["a", "b"]),
        (b"a\rb\r", ["a", "b"]),
        (b"a\r\rb", ["a", "", "b"]),
        (b"a\n\rb", ["a", "", "b"]),
        (b"\xef\xbb\xbfG0", ["G0"]),
        (b"\xef\xbb\xbf", []),
        (b"\xef\xbb", ["\xef\xbb"]),
        (b"(\xc3\xa4)\n(\xe4)\n", ["(\xe4)", "(\xe4)"]),
        (b"a\x0bb\x0cc\x1cd\xc2\x85e\n", ["a\x0bb\x0cc\x1cd\x85e"]),
    ],
)
def test_lines_of_a_file(tmp_path: Path, data: bytes, lines: list[str]) -> None:
    assert lines_of(tmp_path, data) == lines


@pytest.mark.parametrize("end", [b"\n", b"\r\n", b"\r"])
@pytest.mark.parametrize("shift", range(-3, 4))
@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
def test_a_line_end_at_the_end_of_a_window(
    tmp_path: Path, small: int, end: bytes, shift: int, mark: bytes
) -> None:
    second = small + shift - 20 - len(end)
    data = mark + b"x" * 20 + end + b"y" * second + end + b"G0" + end
    assert lines_of(tmp_path, data) == ["x" * 20, "y" * second, "G0"]


@pytest.mark.parametrize("end", [b"\n", b"\r\n", b"\r"])
@pytest.mark.parametrize("length", [62, 63, 64, 65, 66, 126, 127, 128, 129, 1000])
def test_a_line_longer_than_a_window_is_cut(
    tmp_path: Path, small: int, end: bytes, length: int
) -> None:
    found = lines_of(tmp_path, b"G0" + end + b"x" * length + end + b"G1" + end + b"G2")
    assert found == ["G0", "x" * min(length, small), "G1", "G2"]
    assert lines_of(tmp_path, b"x" * length) == ["x" * min(length, small)]


def test_random_line_ends_and_lengths(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = random.Random(5)
    for _ in range(share(3000, 80)):
        monkeypatch.setattr(module, "WINDOW_BYTES", rng.randint(40, 80))
        data = b"".join(
            rng.choice([b"\n", b"\r", b"\r\n", b"x" * rng.randint(0, 15)])
            for _ in range(rng.randint(0, 200))
        )
        longest = max(map(len, data.splitlines()), default=0)
        if longest < module.WINDOW_BYTES - 1:
            assert lines_of(tmp_path, data) == data.decode().splitlines(), data


def test_a_long_line_is_refused_after_one_window(tmp_path: Path) -> None:
    path = tmp_path / "a.nc"
    path.write_bytes(b"x" * 2_000_000 + b"\nG0")
    text = Text.of_file(path)
    window = text.window(1)
    assert window is not None
    assert len(window.text(0)) == module.WINDOW_BYTES
    with pytest.raises(GcodeError) as caught:
        window.statement(0, NGC)
    assert caught.value.diagnostic.code == "line-too-long"
    assert texts(text)[1] == "G0"


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_lines_in_any_order(tmp_path: Path, small: int, end: str) -> None:
    rng = random.Random(3)
    lines = ["G1 X" + "5" * rng.randint(0, 40) for _ in range(400)]
    path = tmp_path / "a.nc"
    path.write_text(end.join(lines), newline="")
    for text in (Text.of_file(path, "a"), Text.of_lines(lines, "a")):
        assert text.name == "a"
        for _ in range(400):
            number = rng.randint(-2, len(lines) + 5)
            window = text.window(number)
            if not 1 <= number <= len(lines):
                assert window is None
                continue
            assert window is not None
            assert window.first <= number < window.first + window.count
            assert window.text(number - window.first) == lines[number - 1]
        assert text.lines == len(lines)


def test_only_some_windows_are_kept(tmp_path: Path, small: int) -> None:
    path = tmp_path / "a.nc"
    path.write_bytes(b"G1 X1\n" * 1000)
    text, windows, line = Text.of_file(path), [], 1
    while window := text.window(line):
        windows.append(window)
        line += window.count
    kept = [text.window(window.first) is window for window in windows[-KEPT_WINDOWS:]]
    assert all(kept)
    again = text.window(1)
    assert again is not windows[0], "it was read anew"
    assert again is text.window(1), "and is kept"
    assert again is not None
    assert again.count == windows[0].count


def test_lines_in_memory_are_read_on_demand() -> None:
    read = 0

    def lines() -> Iterator[str]:
        nonlocal read
        while True:
            read += 1
            yield f"G0 X{read}\n"

    text = Text.of_lines(lines(), "endless")
    window = text.window(1)
    assert window is not None
    assert window.text(0) == "G0 X1"
    assert read < 1000
    far = text.window(50_000)
    assert far is not None
    assert far.text(50_000 - far.first) == "G0 X50000"
    assert read < 100_000


@pytest.mark.parametrize(
    "line",
    [
        "",
        "G0\x0bX1",
        "(\ud800)",
        "a\nb",
        "a\rb",
        "a\n",
        "?",
        "(ä) X1",
        "\ufeffG0",
        "\udcff",
        "(what?)",
        "o1 sub (ä)",
        "\0",
        "G1 X1\r",
    ],
)
def test_lines_in_memory_are_not_changed(line: str) -> None:
    found = texts(Text.of_lines([line, line, "G1"], "t"))
    assert found == [line.removesuffix("\n").removesuffix("\r")] * 2 + ["G1"]


def test_text_that_is_not_utf8_is_not_plain() -> None:
    window = Text.of_lines(["G0 X1 (\ud800)", "G0 \n X1", "; \r x", "O1 (\ud800)"], "t").window(1)
    assert window is not None
    assert window.plain.tolist() == [0, 0, 0, 0]
    assert window.head.tolist() == [ord("G"), ord("G"), 0, ord("O")]


def test_equal_lines_share_a_statement_and_each_syntax_has_its_own() -> None:
    window = Text.of_lines(["G1 X1", "#1=5", "G1 X1", "#1=5"], "t").window(1)
    assert window is not None
    assert window.statement(0, NGC) is window.statement(2, NGC)
    grbl = Syntax("none")
    assert window.statement(0, NGC) is window.statement(0, grbl)
    with pytest.raises(GcodeError):
        window.statement(1, grbl)


def test_plain_statements_are_memoised_by_text_in_bounded_memory(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "_memo", {})

    def statement(line: str) -> object:
        window = Text.of_lines([line], "t").window(1)
        assert isinstance(window, Window)
        return window.statement(0, NGC)

    assert statement("G1 X1") is statement("G1 X1")
    for number in range(3 * module.MEMO):
        statement(f"G1 X{number}")
    assert len(module._memo) <= module.MEMO


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(UsageError) as caught:
        Text.of_file(tmp_path / "none.nc")
    assert caught.value.diagnostic.code == "no-such-file"
    assert caught.value.diagnostic.file == str(tmp_path / "none.nc")


def test_an_unreadable_file(tmp_path: Path) -> None:
    with pytest.raises(UsageError) as caught:
        Text.of_file(tmp_path)
    assert caught.value.diagnostic.code == "unreadable-file"


def test_a_file_that_is_deleted_during_reading(tmp_path: Path, small: int) -> None:
    path = tmp_path / "a.nc"
    path.write_bytes(b"G1 X1\n" * 100)
    text = Text.of_file(path)
    text.window(1)
    path.unlink()
    with pytest.raises(UsageError) as caught:
        text.window(100)
    assert caught.value.diagnostic.code == "no-such-file"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes here")
def test_a_pipe_is_read_in_any_order(tmp_path: Path, small: int) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)
    writer = threading.Thread(
        target=path.write_bytes, args=(b"".join(b"X%d\n" % n for n in range(1, 101)),)
    )
    writer.start()
    text = Text.of_file(path)
    writer.join()
    assert texts(text) == [f"X{n}" for n in range(1, 101)]
    window = text.window(1)
    assert window is not None
    assert window.text(0) == "X1"
