"""Tables of a Lark grammar for the automaton (:mod:`cnc.gcode.kernels.automaton`).

Lark makes the LALR table of a grammar, and interegular the finite automaton of each terminal. Their
product is one automaton over bytes. The tables are kept as a file: making them takes a second.

A rule of a single symbol that makes no node is folded into the rows of that symbol: one whose name
begins with ``_``, or one with ``?``. A grammar with a conflict, or with two terminals for one text
at one place, is an error.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cnc.gcode.kernels.automaton import INLINED, NODE, NODE_OF_SEVERAL, NONE, OTHER, Tables

if TYPE_CHECKING:
    from lark import Lark

NAMES = ("ngc", "macro", "sinumerik", "klartext")
"""Names of the grammars."""
_DIGEST = 32
_FORMAT = 9
"""Version of the tables' form."""
_KEPT = 8
"""So many files of a grammar stay in the user's cache: other installations use the older ones."""
_MOST_TEXTS = 64
"""A terminal with up to so many texts is a list of keywords: each text has a number of its own."""
_FOREIGN = "\xff"
"""A character that stands for all others."""
_ROW = OTHER + 1
"""Columns of the automaton: ASCII, and one for all other characters."""

Ints = NDArray[np.int64]


class GrammarError(Exception):
    """A grammar that cannot be read without doubt. The text names the rule or the terminals."""


class Grammar(NamedTuple):
    """A grammar as tables.

    Attributes:
        tables: The tables of the automaton.
        terminals: Names of the terminals.
        rules: Name of each rule, or of its alternative (``-> name``).
        texts: The texts of keywords; an event of a keyword has the index of its text.
        wanted: Names of the terminals that each state of the parser accepts.
        is_keyword: Whether each terminal is one of the texts.
        methods: Name of the method for each rule.
    """

    tables: Tables
    terminals: tuple[str, ...]
    rules: tuple[str, ...]
    texts: tuple[str, ...]
    wanted: tuple[frozenset[str], ...]
    is_keyword: tuple[bool, ...]
    methods: tuple[str, ...]


def cache_folder() -> Path:
    """Return the user's cache folder: ``XDG_CACHE_HOME``, or the usual one of the platform."""
    if named := os.environ.get("XDG_CACHE_HOME"):
        return Path(named) / "cnc"
    if sys.platform == "win32" and (local := os.environ.get("LOCALAPPDATA")):
        return Path(local) / "cnc" / "cache"
    return Path(os.path.expanduser("~")) / ".cache" / "cnc"


@cache
def grammar(name: str) -> Grammar:
    """Return a grammar by its name, from a file of tables if there is one.

    A file that cannot be written is made anew at each start.
    """
    folder, file_name = _folder(), _file_name(name)
    places: list[Traversable] = [folder, cache_folder()]
    for place in places:
        with suppress(OSError):
            if (kept := _unpacked(place.joinpath(file_name).read_bytes())) is not None:
                return kept
    made = make(folder.joinpath(f"{name}.lark"), folder)
    with suppress(OSError):
        cache_folder().mkdir(parents=True, exist_ok=True)
        write(made, cache_folder() / file_name)
        written = cache_folder().glob(f"{name}-*.tables")
        for older in sorted(written, key=lambda file: file.stat().st_mtime)[:-_KEPT]:
            older.unlink()
    return made


def write_named(name: str, folder: Path) -> Path:
    """Write the tables of a grammar into a folder, under the name by which they are found."""
    write(grammar(name), folder / _file_name(name))
    return folder / _file_name(name)


def _file_name(name: str) -> str:
    """Return the name of the file of a grammar's tables: it depends on all grammars."""
    folder = _folder()
    names = sorted(file.name for file in folder.iterdir() if file.name.endswith(".lark"))
    texts = [folder.joinpath(file).read_bytes() for file in names]
    digest = hashlib.sha256(b"\0".join([str(_FORMAT).encode(), *texts])).hexdigest()[:16]
    return f"{name}-{digest}.tables"


def _folder() -> Traversable:
    """Return the folder of the grammars: in an installed package, or in a checkout."""
    installed = files("cnc").joinpath("grammars")
    return installed if installed.is_dir() else Path(__file__).parents[3] / "grammars"


def write(made: Grammar, file: Path) -> None:
    """Write a file of tables. It is written beside its place and renamed, so it is always whole."""
    arrays = [np.ascontiguousarray(table) for table in made.tables]
    head = {
        "arrays": [(table.dtype.str, table.shape) for table in arrays],
        "names": made.terminals,
        "rules": made.rules,
        "texts": made.texts,
        "wanted": [sorted(table) for table in made.wanted],
    }
    body = b"\n".join([json.dumps(head).encode(), b"".join(table.tobytes() for table in arrays)])
    part = tempfile.NamedTemporaryFile(dir=file.parent, delete=False)  # noqa: SIM115 renamed below
    try:
        with part:
            part.write(hashlib.sha256(body).digest() + body)
        os.replace(part.name, file)
    except OSError:
        os.unlink(part.name)
        raise


def _unpacked(data: bytes) -> Grammar | None:
    """Return the grammar of a file; None for a damaged one."""
    digest, body = data[:_DIGEST], data[_DIGEST:]
    if hashlib.sha256(body).digest() != digest:
        return None
    line, _, numbers = body.partition(b"\n")
    head = json.loads(line)
    arrays: list[NDArray[Any]] = []
    at = 0
    for kind, shape in head["arrays"]:
        count = math.prod(shape)
        # A copy is aligned: else the tables of each grammar would be other types to the kernel.
        arrays.append(np.frombuffer(numbers, kind, count, at).reshape(shape).copy())
        at += arrays[-1].nbytes
    return _grammar(Tables(*arrays), head["names"], head["rules"], head["texts"], head["wanted"])


def _grammar(
    tables: Tables, terminals: Iterable[str], rules: Iterable[str], texts: Iterable[str],
    wanted: Iterable[Iterable[str]],
) -> Grammar:  # fmt: skip
    names, rule_names = tuple(terminals), tuple(rules)
    keywords = set(tables.token[tables.spelling >= 0].tolist())
    return Grammar(
        tables, names, rule_names, tuple(texts), tuple(map(frozenset, wanted)),
        tuple(k in keywords for k in range(len(names))), tuple(f"_{name}" for name in rule_names),
    )  # fmt: skip


def make(file: Traversable, folder: Traversable) -> Grammar:
    """Return the tables of a grammar file.

    Args:
        file: The file.
        folder: Folder of the files that it imports.

    Raises:
        GrammarError: The grammar has a conflict, or a text is two terminals at one place.
    """
    import lark

    def imported(_base: str | None, name: str) -> tuple[str, str]:
        """Return a file that the grammar imports."""
        return name, folder.joinpath(name).read_text(encoding="utf-8")

    try:
        parser = lark.Lark(
            file.read_text(encoding="utf-8"),
            source_path=file.name,
            import_paths=[imported],
            parser="lalr",
            maybe_placeholders=False,
            strict=True,
        )
    except lark.exceptions.GrammarError as error:
        raise GrammarError(f"{file.name}: {error}") from None
    return _Maker(parser, file.name).grammar()


class _Rows(NamedTuple):
    """The first row, and tables of rows: see :class:`cnc.gcode.kernels.automaton.Tables`."""

    first: int
    reached: NDArray[np.uint16]
    pair: NDArray[np.uint16]
    after: NDArray[np.uint16]
    action: NDArray[np.int16]


class _Maker:
    """Makes the tables of one grammar."""

    def __init__(self, parser: Lark, name: str) -> None:
        self._name = name
        frontend: Any = parser.parser
        self._table = frontend.parser.parser.parse_table
        self._terminals = list(parser.terminals)
        self._names = [terminal.name for terminal in self._terminals]
        self._ignored = set(parser.ignore_tokens)
        self._states = {state: index for index, state in enumerate(self._in_order())}
        self._number = {name: index for index, name in enumerate([*self._names, "$END"])}
        self._rules = sorted(
            {target for _, target in self._acts() if not isinstance(target, int)}, key=str
        )
        self._nonterminals = {
            name: index
            for index, name in enumerate(
                sorted(
                    {symbol for symbol, _ in self._acts() if symbol not in self._number}
                    | {rule.origin.name for rule in self._rules}
                )
            )
        }

    def _in_order(self) -> Iterator[Any]:
        """Yield the states of the parser from the first one on, in an order that stays."""
        table = self._table.states
        waiting = [self._table.start_states["start"]]
        seen = set(waiting)
        for state in waiting:
            yield state
            for _, (_, target) in sorted(table[state].items()):
                if isinstance(target, int) and target not in seen:
                    seen.add(target)
                    waiting.append(target)

    def _acts(self) -> Iterator[tuple[str, Any]]:
        """Yield all entries of the parser's table: symbol, and the next state or a rule."""
        for state in self._states:
            for symbol, (_, target) in self._table.states[state].items():
                yield symbol, target

    def grammar(self) -> Grammar:
        """Return the grammar."""
        action, goto = self._parser_tables()
        lexer_of, lexers = self._lexers(action)
        moves, begins, accepts, texts = self._automaton(lexers)
        token = [self._chosen(accepted) if accepted else NONE for accepted in accepts]
        spelling = [
            accepted.get(chosen, -1) for accepted, chosen in zip(accepts, token, strict=True)
        ]
        rows = self._rows_of(action, goto)
        rules = [str(rule.alias or rule.origin.name) for rule in self._rules]
        final = (moves == NONE).all(axis=1)
        end = self._table.end_states["start"]
        tables = Tables(
            moves=moves,
            final=final.astype(np.uint8),
            start=begins[lexer_of][rows.reached],
            token=np.array(token, np.uint16),
            spelling=np.array(spelling, np.int16),
            reached=rows.reached,
            pair=rows.pair,
            after=rows.after,
            action=rows.action,
            length=np.array([len(rule.expansion) for rule in self._rules], np.int64),
            left=np.array([self._nonterminals[rule.origin.name] for rule in self._rules], np.int16),
            kind=np.array([self._kind(rule) for rule in self._rules], np.uint8),
            kept=np.array([self._is_kept(name) for name in self._names], np.int64),
            ignored=np.array([name in self._ignored for name in self._names], np.uint8),
            number=np.array([name == "NUMBER" for name in self._names], np.uint8),
            ends=np.array([rows.first, self._states[end]], np.int64),
        )
        names = [name.lstrip("_") for name in self._names]
        wanted = [[names[k] for k in np.flatnonzero(row[:-1])] for row in action]
        return _grammar(tables, self._names, rules, texts, wanted)

    def _parser_tables(self) -> tuple[NDArray[np.int16], dict[tuple[int, int], int]]:
        """Return the actions (state + 1 of a shift, -rule - 1, 0 for an error) and the gotos."""
        action = np.zeros((len(self._states), len(self._names) + 1), np.int16)
        rules = {rule: index for index, rule in enumerate(self._rules)}
        gotos: dict[tuple[int, int], int] = {}
        for state, index in self._states.items():
            for symbol, (_, target) in sorted(self._table.states[state].items()):
                if symbol not in self._number:
                    gotos[index, self._nonterminals[symbol]] = self._states[target]
                elif isinstance(target, int):
                    action[index, self._number[symbol]] = self._states[target] + 1
                else:
                    action[index, self._number[symbol]] = -rules[target] - 1
        return action, gotos

    @staticmethod
    def _kind(rule: Any) -> int:
        inlined = rule.origin.name.startswith("_")
        if not inlined and (rule.alias or not rule.options.expand1):
            return NODE
        return INLINED if inlined or len(rule.expansion) == 1 else NODE_OF_SEVERAL

    def _is_kept(self, name: str) -> bool:
        """Return whether a terminal is a node: Lark leaves out those without a name."""
        for rule in self._rules:
            for symbol in rule.expansion:
                if symbol.is_term and symbol.name == name:
                    return not symbol.filter_out
        return False

    def _rows_of(self, action: NDArray[np.int16], gotos: dict[tuple[int, int], int]) -> _Rows:
        """Return the rows; equal ones are one.

        The state after a symbol is the state after all reductions of a single symbol that make no
        node.
        """
        count, columns = action.shape
        silent = [self._kind(rule) == INLINED and len(rule.expansion) == 1 for rule in self._rules]
        left = [self._nonterminals[rule.origin.name] for rule in self._rules]
        rows: dict[tuple[int, ...], int] = {}

        def row_of(below: int, target: int) -> int:
            """Return the row of a state that was reached from the state ``below``."""
            after = [target]
            for column in range(columns):
                state = target
                while (act := int(action[state, column])) < 0 and silent[-act - 1]:
                    state = gotos[below, left[-act - 1]]
                after.append(state)
            return rows.setdefault(tuple(after), len(rows))

        first = row_of(-1, self._states[self._table.start_states["start"]])
        shifts = action.copy()
        for state, column in np.argwhere(action > 0).tolist():
            shifts[state, column] = row_of(state, int(action[state, column]) - 1) + 1
        pair = np.full((count, len(self._nonterminals)), NONE, np.uint16)
        for (below, nonterminal), target in gotos.items():
            pair[below, nonterminal] = row_of(below, target)
        table = np.array(list(rows), np.uint16)
        after = np.ascontiguousarray(table[:, 1:])
        reached = np.ascontiguousarray(table[:, 0])
        return _Rows(first, reached, pair, after, shifts[after, np.arange(columns)])

    def _automaton(
        self, lexers: Iterable[frozenset[int]]
    ) -> tuple[NDArray[np.uint16], NDArray[np.uint16], list[dict[int, int]], list[str]]:
        """Return the moves of the automaton, its first states, what its states accept, and texts.

        A lexer begins at a state that knows its terminals only. What a state accepts is the index
        of the text of each terminal, -1 if it has none.
        """
        parts: list[_Keyword | _Pattern] = []
        texts: list[str] = []
        for number, terminal in enumerate(self._terminals):
            fsm = _fsm(terminal.pattern.to_regexp())
            if words := _texts(fsm):
                for word in words:
                    parts.append(_Keyword(number, word, len(texts)))
                    texts.append(word)
            else:
                parts.append(_Pattern(number, fsm))
        numbers: dict[tuple[tuple[int, int], ...], int] = {}
        waiting = []
        begins = []
        for wanted in lexers:
            begin = tuple(
                (index, part.begin) for index, part in enumerate(parts) if part.terminal in wanted
            )
            if begin not in numbers:
                numbers[begin] = len(numbers)
                waiting.append(begin)
            begins.append(numbers[begin])
        rows: list[NDArray[np.uint16]] = []
        accepts: list[dict[int, int]] = []
        for state in waiting:
            row = np.full(_ROW, NONE, np.uint16)
            for column in range(_ROW):
                following = tuple(
                    (index, after)
                    for index, at in state
                    if (after := parts[index].step(at, column)) is not None
                )
                if following:
                    if following not in numbers:
                        numbers[following] = len(numbers)
                        waiting.append(following)
                    row[column] = numbers[following]
            rows.append(row)
            accepts.append(
                {
                    parts[index].terminal: parts[index].text
                    for index, at in state
                    if parts[index].accepts(at)
                }
            )
        return np.array(rows), np.array(begins, np.uint16), accepts, texts

    def _lexers(
        self, action: NDArray[np.int16]
    ) -> tuple[NDArray[np.uint16], dict[frozenset[int], int]]:
        """Return the lexer of each parser state, and the numbers of lexers by their terminals.

        A parser state reads only the terminals that it accepts, and those that are ignored.
        """
        lexers: dict[frozenset[int], int] = {}
        lexer_of = np.empty(len(action), np.uint16)
        ignored = {self._number[name] for name in self._ignored}
        for state, row in enumerate(action[:, :-1]):
            accepted = frozenset(np.flatnonzero(row).tolist()) | ignored
            lexer_of[state] = lexers.setdefault(accepted, len(lexers))
        return lexer_of, lexers

    def _chosen(self, accepted: Iterable[int]) -> int:
        """Return the terminal of highest priority.

        Raises:
            GrammarError: Two terminals of one priority have a text in common.
        """
        ranked = sorted(accepted, key=lambda number: -self._terminals[number].priority)
        best = [
            number
            for number in ranked
            if self._terminals[number].priority == self._terminals[ranked[0]].priority
        ]
        if len(best) > 1:
            names = " and ".join(self._names[number] for number in best)
            raise GrammarError(f"{self._name}: {names} have a text in common: give one a priority")
        return best[0]


class _Keyword:
    """A terminal's text."""

    begin = 0

    def __init__(self, terminal: int, word: str, text: int) -> None:
        self.terminal, self.text, self._word = terminal, text, word

    def step(self, at: int, column: int) -> int | None:
        """Return the place after a character, or None."""
        is_next = at < len(self._word) and ord(self._word[at]) == column
        return at + 1 if is_next else None

    def accepts(self, at: int) -> bool:
        """Return whether the text is complete."""
        return at == len(self._word)


class _Pattern:
    """A terminal with a regular expression."""

    text = -1

    def __init__(self, terminal: int, fsm: Any) -> None:
        self.terminal, self._finals = terminal, fsm.finals
        self.begin = fsm.initial
        alphabet = fsm.alphabet
        chars = [chr(column) if column < OTHER else _FOREIGN for column in range(_ROW)]
        keys = [alphabet[char] for char in chars]
        live = {state for state in fsm.states if fsm.islive(state)}
        self._after = {
            state: [after if (after := moves.get(key)) in live else None for key in keys]
            for state, moves in fsm.map.items()
        }

    def step(self, at: int, column: int) -> int | None:
        """Return the state after a character, or None."""
        return self._after[at][column] if at in self._after else None

    def accepts(self, at: int) -> bool:
        """Return whether the text may end here."""
        return at in self._finals


def _fsm(pattern: str) -> Any:
    import interegular

    return interegular.parse_pattern(pattern).to_fsm()


def _texts(fsm: Any) -> list[str]:
    """Return all texts of an automaton; none if there are many."""
    try:
        if fsm.cardinality() > _MOST_TEXTS:
            return []
    except OverflowError:
        return []
    texts = list(fsm.strings())
    # The mark for all other characters is no text.
    if not all(isinstance(part, str) for parts in texts for part in parts):
        return []
    return sorted("".join(parts) for parts in texts)
