"""The page: tables as Markdown, figures as files, and faults that a user can mend."""

import builtins

import pytest

from cnc import cli
from cnc.model.diagnostics import UsageError
from cnc.papers import contents, page
from cnc.papers.page import Figure, Section, Table

PNG = b"\x89PNG\r\n\x1a\n"
TABLE = Table(
    "Steps",
    ("curve", "published", "ours"),
    [("circle", "5 655", 5656), ("a|b", "", 0.1234567)],
    "A note.",
)


def drawing(canvas):
    canvas.add_subplot().plot([0, 1], [1, 0])


SECTION = Section("A paper", "What it does.", [TABLE], [Figure("line", "A line", drawing)])


def test_a_section_becomes_markdown():
    assert page.markdown(SECTION) == "\n".join([
        "## A paper",
        "",
        "What it does.",
        "",
        "**Steps**",
        "",
        "| curve  | published | ours     |",
        "|--------|-----------|----------|",
        "| circle | 5 655     | 5656     |",
        "| a\\|b   |           | 0.123457 |",
        "",
        "A note.",
        "",
        "![A line](line.png)",
        "",
        "A line",
    ])  # fmt: skip


def test_page_and_pictures_are_written(tmp_path):
    file = page.write([SECTION, SECTION], page.prepared(tmp_path / "new" / "folder"))
    assert sorted(each.name for each in file.parent.iterdir()) == ["line.png", "papers.md"]
    assert file.read_text().count("## A paper") == 2
    assert (file.parent / "line.png").read_bytes().startswith(PNG)


def test_a_folder_that_can_not_be_made_is_a_usage_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError) as caught:
        page.prepared(tmp_path / "file" / "below")
    assert caught.value.diagnostic.code == "can-not-write"


def test_a_page_that_can_not_be_written_is_a_usage_error(tmp_path):
    (tmp_path / page.PAGE).mkdir()
    with pytest.raises(UsageError) as caught:
        page.write([SECTION], tmp_path)
    assert caught.value.diagnostic.code == "can-not-write"
    assert page.PAGE in caught.value.diagnostic.message


def test_without_matplotlib_there_are_tables_without_figures(tmp_path, monkeypatch, capsys):
    ordinary = builtins.__import__

    def without(name, *rest):
        if name.startswith("matplotlib"):
            raise ImportError(name)
        return ordinary(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    monkeypatch.setattr(contents, "sections", lambda: iter([SECTION]))
    assert cli.exit_code(["papers", str(tmp_path / "p")]) == 0
    printed, message = capsys.readouterr()
    assert "| circle | 5 655     | 5656     |" in printed
    assert "figures-missing" in message and "pip install" in message
    (written,) = (tmp_path / "p").iterdir()
    text = written.read_text()
    assert "| circle | 5 655     | 5656     |" in text
    assert "line.png" not in text


def test_the_command_prints_the_sections_and_writes_them(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(contents, "sections", lambda: iter([SECTION]))
    assert cli.exit_code(["papers", str(tmp_path)]) == 0
    assert capsys.readouterr().out == f"{page.markdown(SECTION)}\n\n{tmp_path / page.PAGE}\n"
    assert (tmp_path / "line.png").exists()
    assert cli.exit_code(["papers", str(tmp_path), "--quiet"]) == 0
    assert capsys.readouterr().out == ""
