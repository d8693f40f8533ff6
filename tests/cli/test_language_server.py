"""The language server, over its standard input and output, with the client of pygls."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pygls", reason="pip install 'cncrun[lsp]'")

from lsprotocol import types as lsp
from pygls.lsp.client import LanguageClient

PROGRAM = """\
O100 (PART)
G21 G90 G17 G40
(T5 D6. FLAT MILL)
T5 M6
S2000 M3
#100=5.
N10 G0 X1. Y2. Z5.
G1 Z-1. F300.
X#100 (a (b))
M98 P200
M30
O200
G91 G1 X2.
G90
M99
"""


class Client(LanguageClient):
    """A client that keeps the findings and the messages of the server."""

    def __init__(self) -> None:
        super().__init__("test", "1")
        self.findings: dict[int | None, list[lsp.Diagnostic]] = {}
        self.messages: list[str] = []
        self.news = asyncio.Event()

        @self.feature(lsp.TEXT_DOCUMENT_PUBLISH_DIAGNOSTICS)
        def published(params: lsp.PublishDiagnosticsParams) -> None:
            self.findings[params.version] = list(params.diagnostics)
            self.news.set()

        @self.feature(lsp.WINDOW_SHOW_MESSAGE)
        def shown(params: lsp.ShowMessageParams) -> None:
            self.messages.append(params.message)

    async def codes(self, version: int) -> list[str | int | None]:
        """Return the codes of the findings of a version, when they have come."""
        while version not in self.findings:
            self.news.clear()
            await asyncio.wait_for(self.news.wait(), 120)
        return [finding.code for finding in self.findings[version]]


Talk = Callable[[Client, str], Awaitable[None]]


def talk(
    folder: Path, talk_to: Talk, text: str = PROGRAM, project: str = 'dialect = "fanuc"'
) -> None:
    """Start a server, open a program, and talk to it."""
    file = folder / "part.nc"
    file.write_text(text)
    (folder / "cncrun.toml").write_text(project)

    async def session() -> None:
        client = Client()
        await client.start_io(sys.executable, "-m", "cnc.cli", "lsp", "--stdio")
        try:
            capabilities = lsp.ClientCapabilities()
            params = lsp.InitializeParams(capabilities, root_uri=folder.as_uri())
            await client.initialize_async(params)
            client.initialized(lsp.InitializedParams())
            item = lsp.TextDocumentItem(file.as_uri(), "gcode", 1, text)
            client.text_document_did_open(lsp.DidOpenTextDocumentParams(item))
            await asyncio.wait_for(talk_to(client, file.as_uri()), 120)
            await client.shutdown_async(None)
        finally:
            client.exit(None)
            await client.stop()

    asyncio.run(session())


def at(line: int, character: int) -> dict[str, Any]:
    return {"position": lsp.Position(line - 1, character)}


def change(line: int, begin: int, end: int, text: str) -> lsp.TextDocumentContentChangePartial:
    place = lsp.Range(lsp.Position(line - 1, begin), lsp.Position(line - 1, end))
    return lsp.TextDocumentContentChangePartial(range=place, text=text)


def spans(locations: Any) -> list[tuple[int, int, int]]:
    return [
        (found.range.start.line + 1, found.range.start.character, found.range.end.character)
        for found in locations
    ]


def test_findings_follow_the_text(tmp_path: Path) -> None:
    async def talk_to(client: Client, uri: str) -> None:
        assert await client.codes(1) == ["comment-not-open"]
        (finding,) = client.findings[1]
        assert (finding.range.start.line, finding.range.start.character) == (8, 12)
        assert finding.severity == lsp.DiagnosticSeverity.Error
        document = lsp.VersionedTextDocumentIdentifier(version=2, uri=uri)
        edits = [change(9, 9, 13, "b)"), change(8, 3, 7, "Z-1. X[2\nY3.")]
        client.text_document_did_change(lsp.DidChangeTextDocumentParams(document, edits))
        assert await client.codes(2) == ["bracket-not-closed"]
        document = lsp.VersionedTextDocumentIdentifier(version=3, uri=uri)
        edits = [change(8, 7, 11, "")]
        client.text_document_did_change(lsp.DidChangeTextDocumentParams(document, edits))
        assert "bracket-not-closed" not in await client.codes(3)

    talk(tmp_path, talk_to)


def test_a_wrong_project_file_is_a_finding(tmp_path: Path) -> None:
    async def talk_to(client: Client, uri: str) -> None:
        assert await client.codes(1) == ["project-file"]
        (tmp_path / "cncrun.toml").write_text('dialect = "fanuc"')
        client.findings.clear()
        config = lsp.TextDocumentIdentifier((tmp_path / "cncrun.toml").as_uri())
        client.text_document_did_save(lsp.DidSaveTextDocumentParams(config))
        assert await client.codes(1) == ["comment-not-open"]

    talk(tmp_path, talk_to, project='dialect = "fanuk"')


def test_features(tmp_path: Path) -> None:
    """Every feature of one program: what it answers stands in tests/editor in full."""
    text = PROGRAM.replace("(a (b))", "(\u00e9 \U0001f600) Y1.")

    async def talk_to(client: Client, uri: str) -> None:
        this = {"text_document": lsp.TextDocumentIdentifier(uri)}
        assert "comment-not-open" not in await client.codes(1)

        hover = await client.text_document_hover_async(lsp.HoverParams(**this, **at(8, 1)))
        assert hover is not None
        assert "**G1**: straight move at the feed" in hover.contents.value
        assert "position behind the line: X1 Y2 Z-1" in hover.contents.value
        # Places count in pairs of bytes: a character beyond them has two.
        hover = await client.text_document_hover_async(lsp.HoverParams(**this, **at(9, 13)))
        assert hover is not None
        assert hover.range is not None
        assert (hover.range.start.character, hover.range.end.character) == (13, 16)

        items = await client.text_document_completion_async(
            lsp.CompletionParams(**this, **at(8, 1))
        )
        listed = {item.label: item.detail for item in items}
        assert listed["G43"].startswith("tool length")
        assert "G38.2" not in listed

        found = await client.text_document_definition_async(
            lsp.DefinitionParams(**this, **at(10, 6))
        )
        assert spans(found) == [(12, 1, 4)]
        context = lsp.ReferenceContext(include_declaration=True)
        found = await client.text_document_references_async(
            lsp.ReferenceParams(**this, **at(9, 3), context=context)
        )
        assert spans(found) == [(6, 1, 4), (9, 2, 5)]
        edit = await client.text_document_rename_async(
            lsp.RenameParams(**this, **at(9, 3), new_name="#101")
        )
        assert edit is not None
        assert [change.new_text for change in edit.changes[uri]] == ["101", "101"]
        refused = await client.text_document_rename_async(
            lsp.RenameParams(**this, **at(9, 3), new_name="depth")
        )
        assert refused is None
        assert "no name of a variable" in client.messages[-1]

        entries = await client.text_document_document_symbol_async(lsp.DocumentSymbolParams(**this))
        names = [(entry.name, [child.name for child in entry.children]) for entry in entries]
        assert names == [("O100", ["T5 D6. FLAT MILL"]), ("O200", [])]

        tokens = await client.text_document_semantic_tokens_full_async(
            lsp.SemanticTokensParams(**this)
        )
        assert list(tokens.data[:10]) == [0, 0, 1, 8, 0, 0, 1, 3, 8, 0]

        whole = lsp.Range(lsp.Position(0, 0), lsp.Position(20, 0))
        hints = await client.text_document_inlay_hint_async(
            lsp.InlayHintParams(**this, range=whole)
        )
        shown = {hint.position.line + 1: hint.label for hint in hints}
        assert shown[8] == "X1 Y2 Z-1"
        assert shown[9] == "X5 Y1 Z-1 F300"
        assert shown[13] == "X7 Y1 Z-1 F300"

    talk(tmp_path, talk_to, text)


def test_repairs_and_form(tmp_path: Path) -> None:
    text = "O1 (a (b))\nG21 G90\nX1 Y2\nM30\n"

    async def talk_to(client: Client, uri: str) -> None:
        this = {"text_document": lsp.TextDocumentIdentifier(uri)}
        assert "motion-assumed" in await client.codes(1)
        whole = lsp.Range(lsp.Position(0, 0), lsp.Position(3, 0))
        context = lsp.CodeActionContext(list(client.findings[1]))
        made = await client.text_document_code_action_async(
            lsp.CodeActionParams(**this, range=whole, context=context)
        )
        titles = {action.title: action for action in made}
        (edit,) = titles["write G0"].edit.changes[uri]
        assert (edit.range.start.line, edit.range.start.character, edit.new_text) == (2, 0, "G0 ")
        lines = titles["make all safe repairs"].edit.changes[uri]
        assert [edit.new_text for edit in lines] == ["O1 (a [b])", "G0 X1. Y2."]
        options = lsp.FormattingOptions(tab_size=4, insert_spaces=True)
        edits = await client.text_document_formatting_async(
            lsp.DocumentFormattingParams(**this, options=options)
        )
        assert list(edits) == []

    talk(tmp_path, talk_to, text, project='dialect = "auto"')
