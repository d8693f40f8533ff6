"""Imports between the modules of the package: none leads back, whether inside a function or not."""

import ast
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[2]
MOST_INSIDE_FUNCTIONS = 40
"""Each one needs a reason: something that most commands do without takes long to import."""


def modules() -> dict[str, Path]:
    """Return the files of all modules by name."""
    files = {}
    for file in sorted((ROOT / "cnc").rglob("*.py")):
        parts = file.relative_to(ROOT).with_suffix("").parts
        files[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    return files


@cache
def tree_of(file: Path) -> ast.Module:
    """Return the syntax of a file."""
    return ast.parse(file.read_text(encoding="utf-8"))


def imports(tree: ast.AST) -> Iterator[ast.Import | ast.ImportFrom]:
    """Yield the imports of a file, wherever they stand."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            yield node


def targets(node: ast.Import | ast.ImportFrom, known: dict[str, Path]) -> Iterator[str]:
    """Yield the modules of the package that an import names."""
    if isinstance(node, ast.Import):
        yield from (name.name for name in node.names if name.name in known)
        return
    for name in node.names:
        module = f"{node.module}.{name.name}"
        yield from (each for each in [module if module in known else node.module] if each in known)


def test_no_module_is_imported_by_a_module_that_it_imports() -> None:
    """The sorter raises CycleError, which names the modules of the cycle."""
    files = modules()
    graph = {
        name: {target for node in imports(tree_of(file)) for target in targets(node, files)}
        for name, file in files.items()
    }
    assert sum(map(len, graph.values())) > 1000
    TopologicalSorter(graph).prepare()


def test_few_imports_stand_inside_functions() -> None:
    found = [
        f"{file.relative_to(ROOT)}:{node.lineno}"
        for file in modules().values()
        for function in ast.walk(tree_of(file))
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef)
        for node in imports(function)
    ]
    assert len(set(found)) <= MOST_INSIDE_FUNCTIONS, "\n".join(found)
