"""The pages for people: links that a code host can follow, the navigation, and the tables."""

from __future__ import annotations

import re
import subprocess
import textwrap
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

from cnc.api import check, from_text
from docs import dialect_tables, formulas
from tests.support.paths import ROOT

LINK = re.compile(r"\]\(([^)\s]+)\)")
PAGES = sorted(
    page.relative_to(ROOT).as_posix()
    for page in (*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("firmware/**/*.md"))
)


def _text(page: Path) -> str:
    """Return a page without its blocks of code, whose brackets are no links."""
    return re.sub(r"^```.*?^```|^    .*?$", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)


def _anchors(page: Path) -> set[str]:
    """Return the anchors of the headings of a page, as code hosts and the site make them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    words = (re.sub(r"[^\w\- ]", "", heading.lower()).strip() for heading in headings)
    return {re.sub(r"[ ]", "-", heading) for heading in words}


def dead_links(page: Path) -> list[str]:
    """Return the relative links of a page that lead to no file, or to no heading of it."""
    dead = []
    for link in LINK.findall(_text(page)):
        if "://" in link or link.startswith("mailto:"):
            continue
        name, _, anchor = link.partition("#")
        target = page.parent / name if name else page
        if not target.exists() or (anchor and anchor not in _anchors(target)):
            dead.append(link)
    return dead


@pytest.mark.parametrize("page", PAGES)
def test_relative_links_lead_to_files_of_the_repository(page: str) -> None:
    assert dead_links(ROOT / page) == []


def test_a_dead_link_is_found(tmp_path: Path) -> None:
    page = tmp_path / "a.md"
    page.write_text("# A b\n[x](#a-b) [y](a.md#c) [z](b.md) [w](https://example.org/b.md)\n")
    assert dead_links(page) == ["a.md#c", "b.md"]


def test_the_navigation_names_every_page_once() -> None:
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    named = re.findall(r": (\S+\.md)$", text[text.index("\nnav:") :], flags=re.MULTILINE)
    made = re.findall(r'\("(\S+\.md)", ', (ROOT / "docs/generate_reference.py").read_text())
    written = [page.removeprefix("docs/") for page in PAGES if page.startswith("docs/")]
    assert sorted(named) == sorted([*made, *written])
    assert yaml.safe_load(text[text.index("\nnav:") :])


def test_generated_pages_are_not_in_the_repository() -> None:
    made = re.findall(r'\("(\S+\.md)", ', (ROOT / "docs/generate_reference.py").read_text())
    tracked = subprocess.run(
        ["git", "ls-files", *(f"docs/{page}" for page in made)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert tracked.stdout == ""


def test_every_code_of_a_dialect_has_a_topic() -> None:
    assert "other" not in dialect_tables.by_topic()


def test_the_tables_tell_what_the_dialects_mean() -> None:
    rows = {
        cells[1].strip(): dict(zip(dialect_tables.NAMES, map(str.strip, cells[2:]), strict=False))
        for line in dialect_tables.page().splitlines()
        if (cells := line.split("|"))[2:]
    }
    assert rows["G43.4"]["fanuc"] == "yes"
    assert rows["G43.4"]["grbl"] == ""
    assert rows["time of G4"]["fanuc"] == "P (ms), X (s)"
    assert rows["time of G4"]["siemens"] == "F (s), S (turns)"
    assert rows["motion after G80"]["linuxcnc"] == ""
    assert "| M42 | haas | high gear |" in dialect_tables.page()


def test_the_programs_that_the_first_page_names_exist() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    names = set(re.findall(r"programs/[\w./-]+\.nc", text))
    assert "programs/part.nc" in names
    assert [name for name in sorted(names) if not (ROOT / name).is_file()] == []


def test_the_errors_of_the_first_page_and_of_the_tutorial_are_those_of_the_command() -> None:
    page = (ROOT / "README.md").read_text(encoding="utf-8")
    part = (ROOT / "programs/part.nc").read_text(encoding="utf-8")
    (fault,) = check(from_text(part.replace("G1 Y50", "G1 Y350"))).faults[:1]
    shown = fault.diagnostic
    assert f"part.nc:{shown.line}:{shown.column}: {shown.code}: {shown.message}" in page
    tutorial = (ROOT / "docs/tutorial/first-part.md").read_text(encoding="utf-8")
    text = re.search(r"Write `first.nc`:\n\n((?:    .*\n)+)", tutorial)
    change = re.search(r"Change `(.*?)` to `(.*?)` and check again", tutorial)
    assert text is not None
    assert change is not None
    program = textwrap.dedent(text[1])
    assert check(from_text(program)).ok
    wrong = check(from_text(program.replace(change[1], change[2]))).faults[0].diagnostic
    assert (wrong.code, wrong.line, wrong.column) == ("soft-limit", 8, 4)


def test_formulas_become_mathml() -> None:
    """Every formula of the pages is one that the site can draw."""
    count = 0
    for page in PAGES:
        text = (ROOT / page).read_text(encoding="utf-8")
        drawn = formulas.on_page_markdown(text)
        count += drawn.count("<math ")
        assert "$$" not in re.sub(r"```.*?```|`[^`]*`", "", drawn, flags=re.DOTALL), page
    assert count >= 3


def test_the_parts_of_a_formula_are_those_of_its_text() -> None:
    drawn = formulas.on_page_markdown("at most\n\n$$\n\\sqrt{\\frac{a}{b}}\n$$\n\nas `$$` in code")
    root = ElementTree.fromstring(drawn[drawn.index("<math") : drawn.index("</math>") + 7])
    kinds = [item.tag.rpartition("}")[2] for item in root.iter()]
    assert [kind for kind in kinds if kind != "mrow"] == ["math", "msqrt", "mfrac", "mi", "mi"]
    assert [item.text for item in root.iter() if item.text] == ["a", "b"]
    assert drawn.endswith("as `$$` in code")
