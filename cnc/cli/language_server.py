"""The language server of ``cncrun lsp``: the features of :mod:`cnc.editor` over the protocol."""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from lsprotocol import types as lsp
from pygls.lsp.server import LanguageServer
from pygls.uris import from_fs_path, to_fs_path

from cnc.cli.options import CommonOptions
from cnc.cli.projects import options_of
from cnc.editor import changes, states, symbols, words
from cnc.editor.analysis import Analysis, Settings, analysed, dialect_of
from cnc.editor.document import Document, Span, TextEdit, characters, units
from cnc.gcode.dialects import Dialect
from cnc.gcode.reader.parser import Flavour
from cnc.machine.project import FILE, SHARED_FILE, forget_projects
from cnc.model.diagnostics import CncError, Diagnostic
from cnc.model.operator_control import Control
from cnc.session.program_reader import TEXT_NAME, subroutine_folders
from cnc.version import __version__

PAUSE = 0.1
"""s from the last keystroke to the check."""
MOST_TOKEN_LINES = 20_000
"""Lines whose tokens are sent to an editor that asks for those of the whole text."""
MOST_HINTS = 1000
"""Lines with inlay hints in one answer."""

Result = TypeVar("Result")
_SEVERITIES = {
    "error": lsp.DiagnosticSeverity.Error,
    "warning": lsp.DiagnosticSeverity.Warning,
    "note": lsp.DiagnosticSeverity.Information,
}
_COMPLETIONS = {
    "code": lsp.CompletionItemKind.Function,
    "keyword": lsp.CompletionItemKind.Keyword,
    "variable": lsp.CompletionItemKind.Variable,
    "subprogram": lsp.CompletionItemKind.Module,
}
_SYMBOLS = {
    "subprogram": lsp.SymbolKind.Function,
    "tool": lsp.SymbolKind.Class,
    "operation": lsp.SymbolKind.Method,
}


@dataclass
class Program:
    """An open program.

    Attributes:
        uri: Its address.
        document: Its present text.
        settings: What holds for it; None before the first check.
        rules: Its dialect; None if it can't be told.
        analysis: The last check that was not stopped.
        control: Stops the check that is running.
        timer: Begins the next check.
        hints: States of lines of a version, by the range that was asked for.
    """

    uri: str
    document: Document
    settings: Settings | None = None
    rules: Dialect | None = None
    analysis: Analysis | None = None
    control: Control = field(default_factory=Control)
    timer: asyncio.TimerHandle | None = None
    hints: dict[tuple[int, int, int], dict[int, states.LineState]] = field(default_factory=dict)


class CncLanguageServer(LanguageServer):
    """The server: its open programs, and two threads, one for checks and one for answers.

    Args:
        common: Options of the command line that count more than those of project files.
    """

    def __init__(self, common: CommonOptions) -> None:
        super().__init__("cncrun", __version__)
        self.common = common
        self.programs: dict[str, Program] = {}
        self._checks = ThreadPoolExecutor(1, "check")
        self._answers = ThreadPoolExecutor(1, "answer")

    # Places

    @property
    def encoding(self) -> str:
        """How the editor counts places in a line."""
        return self.workspace.position_encoding or "utf-16"

    def range_of(self, document: Document, span: Span) -> lsp.Range:
        """Return a part of a line as the protocol has it."""
        return self.range(document, TextEdit(span.line, span.begin, span.line, span.end, ""))

    def range(self, document: Document, edit: TextEdit) -> lsp.Range:
        """Return the part of a text that an edit replaces as the protocol has it."""
        encoding = self.encoding
        return lsp.Range(
            lsp.Position(edit.line - 1, units(document.line(edit.line), edit.begin, encoding)),
            lsp.Position(edit.last - 1, units(document.line(edit.last), edit.end, encoding)),
        )

    def place(self, document: Document, at: lsp.Position) -> tuple[int, int]:
        """Return line (from 1) and character (from 0) of a place of the protocol."""
        line = document.line(at.line + 1)
        return at.line + 1, characters(line, at.character, self.encoding)

    def edits(self, document: Document, edits: Sequence[TextEdit]) -> list[lsp.TextEdit]:
        """Return edits as the protocol has them."""
        return [lsp.TextEdit(self.range(document, edit), edit.text) for edit in edits]

    # Texts and checks

    def open(self, uri: str, text: str, version: int) -> None:
        """Take the text of a program that was opened, and check it."""
        program = Program(uri, Document.of(to_fs_path(uri) or TEXT_NAME, text, version))
        self.programs[uri] = program
        self.check_soon(program, 0.0)

    def change(self, params: lsp.DidChangeTextDocumentParams) -> None:
        """Take the changes of a text."""
        program = self.programs[params.text_document.uri]
        document = program.document
        version = params.text_document.version
        for change in params.content_changes:
            if isinstance(change, lsp.TextDocumentContentChangePartial):
                line, begin = self.place(document, change.range.start)
                last, end = self.place(document, change.range.end)
                document = document.edited([TextEdit(line, begin, last, end, change.text)], version)
            else:
                document = Document.of(document.name, change.text, version)
        program.document = document
        self.check_soon(program, PAUSE)

    def check_soon(self, program: Program, pause: float) -> None:
        """Check a program after a pause; a check that is running is stopped."""
        program.control.stop()
        program.hints.clear()
        if program.timer is not None:
            program.timer.cancel()
        loop = asyncio.get_running_loop()
        program.timer = loop.call_later(pause, lambda: asyncio.ensure_future(self._check(program)))

    async def _check(self, program: Program) -> None:
        document, control = program.document, Control()
        program.control = control
        loop = asyncio.get_running_loop()
        analysis = await loop.run_in_executor(
            self._checks, self._analysed, program, document, control
        )
        if control.stopped or program.document is not document:
            return
        program.analysis = analysis
        self.text_document_publish_diagnostics(
            lsp.PublishDiagnosticsParams(
                program.uri,
                [self.diagnostic(document, finding) for finding in analysis.findings],
                document.version,
            )
        )
        capabilities = self.client_capabilities.workspace
        if capabilities and capabilities.inlay_hint and capabilities.inlay_hint.refresh_support:
            self.workspace_inlay_hint_refresh(None)

    def _analysed(self, program: Program, document: Document, control: Control) -> Analysis:
        """Check a text. A fault of the project file is its finding."""
        if control.stopped:
            return Analysis(document)
        try:
            settings = self._settings(document.name)
            if program.settings is None or program.rules is None:
                program.rules = dialect_of(document, settings)
            program.settings = settings
            analysis = analysed(document, settings, control)
            program.rules = analysis.rules or program.rules
            return analysis
        except CncError as error:
            finding = error.diagnostic
            message = f"{finding.location()}: {finding.message}" if finding.file else ""
            fault = Diagnostic(finding.code, message or finding.message, hint=finding.hint)
            return Analysis(document, [fault])

    def _settings(self, name: str) -> Settings:
        chosen = options_of(name, self.common)
        options = chosen.check.run_options(chosen.common)
        return Settings(chosen.machine, options, chosen.style)

    def diagnostic(self, document: Document, finding: Diagnostic) -> lsp.Diagnostic:
        """Return a finding as the protocol has it."""
        line = max(finding.line, 1)
        text = document.line(line)
        begin = finding.column - 1 if finding.column else len(text) - len(text.lstrip())
        end = begin + finding.length if finding.column else len(text)
        span = Span(line, min(begin, len(text)), min(max(end, begin), len(text)))
        message = f"{finding.message}\nhelp: {finding.hint}" if finding.hint else finding.message
        return lsp.Diagnostic(
            self.range_of(document, span),
            message,
            severity=_SEVERITIES[finding.severity],
            code=finding.code,
            source="cncrun",
        )

    async def answer(self, work: Callable[[], Result]) -> Result:
        """Return what a function returns that reads the program; it runs in a thread."""
        return await asyncio.get_running_loop().run_in_executor(self._answers, work)

    async def ready(self, uri: str) -> tuple[Program, Settings] | None:
        """Return a program whose settings and dialect are read; None if there is none.

        A request may come right behind the text; it waits for them for a moment.
        """
        program = self.programs.get(uri)
        for _ in range(100):
            if program is None or program.settings is not None:
                break
            await asyncio.sleep(0.05)
        if program is None or program.settings is None:
            return None
        return program, program.settings

    async def readable(self, uri: str) -> tuple[Document, Settings, Dialect] | None:
        """Return a text, what holds for it, and its dialect; None if that can't be told."""
        ready = await self.ready(uri)
        if ready is None or ready[0].rules is None:
            return None
        return ready[0].document, ready[1], ready[0].rules

    def states(
        self, program: Program, settings: Settings, first: int, last: int
    ) -> dict[int, states.LineState]:
        """Return the states of lines of the present text."""
        document = program.document
        key = document.version, first, last
        if key not in program.hints:
            program.hints[key] = states.line_states(
                document, settings, first, last, lambda: program.document is not document
            )
        return program.hints[key]


def create_server(common: CommonOptions | None = None) -> CncLanguageServer:
    """Return a server with all its features."""
    server = CncLanguageServer(common or CommonOptions())
    _follow_texts(server)
    _explain(server)
    _find(server)
    _colour(server)
    _change(server)
    return server


def _follow_texts(server: CncLanguageServer) -> None:
    @server.feature(lsp.TEXT_DOCUMENT_DID_OPEN)
    def opened(params: lsp.DidOpenTextDocumentParams) -> None:
        item = params.text_document
        server.open(item.uri, item.text, item.version)

    @server.feature(lsp.TEXT_DOCUMENT_DID_CHANGE)
    def changed(params: lsp.DidChangeTextDocumentParams) -> None:
        server.change(params)

    @server.feature(lsp.TEXT_DOCUMENT_DID_CLOSE)
    def closed(params: lsp.DidCloseTextDocumentParams) -> None:
        program = server.programs.pop(params.text_document.uri, None)
        if program is not None:
            program.control.stop()
            if program.timer is not None:
                program.timer.cancel()
            empty = lsp.PublishDiagnosticsParams(program.uri, [])
            server.text_document_publish_diagnostics(empty)

    def check_all() -> None:
        forget_projects()
        for program in server.programs.values():
            server.check_soon(program, PAUSE)

    @server.feature(lsp.TEXT_DOCUMENT_DID_SAVE)
    def saved(params: lsp.DidSaveTextDocumentParams) -> None:
        name = Path(to_fs_path(params.text_document.uri) or "").name
        if name in (FILE, SHARED_FILE) or params.text_document.uri in server.programs:
            check_all()

    @server.feature(lsp.WORKSPACE_DID_CHANGE_WATCHED_FILES)
    def watched(params: lsp.DidChangeWatchedFilesParams) -> None:
        check_all()


def _explain(server: CncLanguageServer) -> None:
    @server.feature(lsp.TEXT_DOCUMENT_HOVER)
    async def hover(params: lsp.HoverParams) -> lsp.Hover | None:
        ready = await server.readable(params.text_document.uri)
        if ready is None:
            return None
        document, settings, rules = ready
        program = server.programs[params.text_document.uri]
        line, character = server.place(document, params.position)
        word = words.meaning_at(document, line, character, rules, settings.machine)
        state = (await server.answer(lambda: server.states(program, settings, line, line))).get(
            line
        )
        parts = [] if word is None else [f"**{word.word}**: {word.text}  \n*{rules.name}*"]
        if state is not None:
            lines = states.described(state, settings.machine.axis_names)
            parts.append("  \n".join(lines))
        if not parts:
            return None
        where = (
            None if word is None else server.range_of(document, Span(line, word.begin, word.end))
        )
        text = lsp.MarkupContent(lsp.MarkupKind.Markdown, "\n\n".join(parts))
        return lsp.Hover(text, where)

    @server.feature(
        lsp.TEXT_DOCUMENT_COMPLETION, lsp.CompletionOptions(trigger_characters=["#", "<"])
    )
    async def complete(params: lsp.CompletionParams) -> list[lsp.CompletionItem]:
        ready = await server.readable(params.text_document.uri)
        if ready is None:
            return []
        document, settings, rules = ready
        line, character = server.place(document, params.position)
        items = words.completions(document, line, character, rules, settings.machine)
        return [
            lsp.CompletionItem(
                item.text,
                kind=_COMPLETIONS[item.kind],
                detail=item.meaning,
                sort_text=f"{number:04}",
                text_edit=lsp.TextEdit(
                    server.range_of(document, Span(line, item.begin, character)), item.text
                ),
            )
            for number, item in enumerate(items)
        ]

    @server.feature(lsp.TEXT_DOCUMENT_INLAY_HINT)
    async def hints(params: lsp.InlayHintParams) -> list[lsp.InlayHint]:
        ready = await server.ready(params.text_document.uri)
        if ready is None:
            return []
        program, settings = ready
        document = program.document
        first = params.range.start.line + 1
        last = min(params.range.end.line + 1, document.count, first + MOST_HINTS)
        of_lines = await server.answer(lambda: server.states(program, settings, first, last))
        names = settings.machine.axis_names
        found = []
        for line, state in sorted(of_lines.items()):
            text = states.hint(state, names, document.code(line).upper())
            if text:
                end = len(document.line(line))
                at = server.range_of(document, Span(line, end, end)).start
                found.append(lsp.InlayHint(at, text, padding_left=True))
        return found


def _find(server: CncLanguageServer) -> None:
    async def found_at(
        uri: str, at: lsp.Position
    ) -> tuple[Document, Settings, Flavour, symbols.Symbol] | None:
        ready = await server.readable(uri)
        if ready is None:
            return None
        document, settings, rules = ready
        symbol = symbols.symbol_at(document, rules.flavour, *server.place(document, at))
        return None if symbol is None else (document, settings, rules.flavour, symbol)

    def location(uri: str, document: Document, place: symbols.Symbol) -> lsp.Location:
        return lsp.Location(uri, server.range_of(document, place.span))

    @server.feature(lsp.TEXT_DOCUMENT_DEFINITION)
    async def definition(params: lsp.DefinitionParams) -> list[lsp.Location]:
        found = await found_at(params.text_document.uri, params.position)
        if found is None:
            return []
        document, settings, flavour, symbol = found
        places = symbols.definitions(document, flavour, symbol)
        if places:
            return [location(params.text_document.uri, document, place) for place in places]
        folders = subroutine_folders(Path(document.name), settings.machine)
        file = symbols.file_of(symbol, folders)
        start = lsp.Position(0, 0)
        uri = None if file is None else from_fs_path(str(file))
        return [] if uri is None else [lsp.Location(uri, lsp.Range(start, start))]

    @server.feature(lsp.TEXT_DOCUMENT_REFERENCES)
    async def references(params: lsp.ReferenceParams) -> list[lsp.Location]:
        found = await found_at(params.text_document.uri, params.position)
        if found is None:
            return []
        document, _, flavour, symbol = found
        wanted = params.context.include_declaration
        return [
            location(params.text_document.uri, document, place)
            for place in symbols.places(document, flavour, symbol)
            if wanted or not place.defines
        ]

    @server.feature(lsp.TEXT_DOCUMENT_RENAME)
    async def rename(params: lsp.RenameParams) -> lsp.WorkspaceEdit | None:
        found = await found_at(params.text_document.uri, params.position)
        if found is None:
            return None
        document, _, flavour, symbol = found
        try:
            edits = symbols.renamed(document, flavour, symbol, params.new_name)
        except symbols.NotRenamed as error:
            server.window_show_message(lsp.ShowMessageParams(lsp.MessageType.Error, str(error)))
            return None
        return lsp.WorkspaceEdit({params.text_document.uri: server.edits(document, edits)})

    @server.feature(lsp.TEXT_DOCUMENT_DOCUMENT_SYMBOL)
    async def outline(params: lsp.DocumentSymbolParams) -> list[lsp.DocumentSymbol]:
        program = server.programs.get(params.text_document.uri)
        if program is None:
            return []
        document = program.document
        entries = await server.answer(lambda: symbols.outline(document))

        def shown(entry: symbols.Entry) -> lsp.DocumentSymbol:
            whole = TextEdit(entry.line, 0, entry.last, len(document.line(entry.last)), "")
            first = Span(entry.line, 0, len(document.line(entry.line)))
            return lsp.DocumentSymbol(
                entry.name,
                _SYMBOLS[entry.kind],
                server.range(document, whole),
                server.range_of(document, first),
                children=[shown(child) for child in entry.children],
            )

        return [shown(entry) for entry in entries]


def _colour(server: CncLanguageServer) -> None:
    legend = lsp.SemanticTokensLegend(list(words.TOKEN_TYPES), [])

    async def data(uri: str, first: int, last: int) -> lsp.SemanticTokens:
        ready = await server.readable(uri)
        if ready is None:
            return lsp.SemanticTokens([])
        document, _, rules = ready
        listed = await server.answer(lambda: list(words.tokens(document, rules, first, last)))
        numbers: list[int] = []
        before = lsp.Position(0, 0)
        for token in listed:
            place = server.range_of(document, Span(token.line, token.begin, token.end))
            start, length = place.start, place.end.character - place.start.character
            same = start.line == before.line
            numbers += [
                start.line - before.line,
                start.character - (before.character if same else 0),
                length,
                token.type,
                0,
            ]
            before = start
        return lsp.SemanticTokens(numbers)

    @server.feature(lsp.TEXT_DOCUMENT_SEMANTIC_TOKENS_FULL, legend)
    async def full(params: lsp.SemanticTokensParams) -> lsp.SemanticTokens:
        return await data(params.text_document.uri, 1, MOST_TOKEN_LINES)

    @server.feature(lsp.TEXT_DOCUMENT_SEMANTIC_TOKENS_RANGE, legend)
    async def part(params: lsp.SemanticTokensRangeParams) -> lsp.SemanticTokens:
        first, last = params.range.start.line + 1, params.range.end.line + 1
        return await data(params.text_document.uri, first, min(last, first + MOST_TOKEN_LINES))


def _change(server: CncLanguageServer) -> None:
    quick, everything = lsp.CodeActionKind.QuickFix, lsp.CodeActionKind.SourceFixAll
    options = lsp.CodeActionOptions(code_action_kinds=[quick, everything])

    @server.feature(lsp.TEXT_DOCUMENT_CODE_ACTION, options)
    async def actions(params: lsp.CodeActionParams) -> list[lsp.CodeAction]:
        ready = await server.ready(params.text_document.uri)
        if ready is None:
            return []
        program, settings = ready
        document, analysis = program.document, program.analysis
        if analysis is None or analysis.document is not document:
            return []
        only = params.context.only

        def is_wanted(kind: lsp.CodeActionKind) -> bool:
            """A kind that is asked for stands for those below it: source for source.fixAll."""
            return only is None or any(
                kind.value.startswith(getattr(name, "value", name)) for name in only
            )

        def action(title: str, kind: lsp.CodeActionKind, edits: list[TextEdit]) -> lsp.CodeAction:
            change = lsp.WorkspaceEdit({program.uri: server.edits(document, edits)})
            return lsp.CodeAction(title, kind=kind, edit=change)

        made: list[lsp.CodeAction] = []
        first, last = params.range.start.line + 1, params.range.end.line + 1
        for repair in changes.repairs(analysis, first, last) if is_wanted(quick) else ():
            note = "" if repair.safe else " (changes what the program does)"
            made.append(action(f"{repair.title}{note}", quick, repair.edits))
            made[-1].is_preferred = repair.safe
            made[-1].diagnostics = [server.diagnostic(document, repair.finding)]
        can_fix = any(finding.fix and finding.fix.safe for finding in analysis.findings)
        if can_fix and is_wanted(everything):
            edits = await server.answer(lambda: changes.all_repaired(document, settings))
            if edits:
                made.append(action("make all safe repairs", everything, edits))
        return made

    @server.feature(lsp.TEXT_DOCUMENT_FORMATTING)
    async def formatting(params: lsp.DocumentFormattingParams) -> list[lsp.TextEdit] | None:
        ready = await server.ready(params.text_document.uri)
        if ready is None:
            return None
        program, settings = ready
        document = program.document
        try:
            edits = await server.answer(lambda: changes.in_style(document, settings))
        except CncError as error:
            text = f"not formatted: {error.diagnostic.render()}"
            server.window_show_message(lsp.ShowMessageParams(lsp.MessageType.Error, text))
            return None
        return server.edits(document, edits)


def serve(common: CommonOptions) -> None:
    """Serve an editor on standard input and output until it ends."""
    # The server closes its streams, which are still needed at the end of the command.
    with (
        os.fdopen(os.dup(sys.stdin.fileno()), "rb") as source,
        os.fdopen(os.dup(sys.stdout.fileno()), "wb") as target,
    ):
        create_server(common).start_io(source, target)
