"""No circle of modules imports itself, imports inside functions counted."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[2] / "src"


def module_name(file: Path) -> str:
    parts = file.relative_to(SOURCE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(node: ast.AST, package: str) -> Iterator[str]:
    """Every module, or name in a module, that the code under `node` imports when it runs."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
            for otherwise in child.orelse:
                yield from imports(ast.Module([otherwise], []), package)
        elif isinstance(child, ast.Import):
            yield from (alias.name for alias in child.names)
        elif isinstance(child, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - child.level + 1] if child.level else []
            home = ".".join([*above, *([child.module] if child.module else [])])
            yield from (f"{home}.{alias.name}" for alias in child.names)
        else:
            yield from imports(child, package)


def import_graph(files: dict[str, Path]) -> dict[str, set[str]]:
    """Module -> the modules of `files` that it imports; importing a package's name is importing the package."""
    graph: dict[str, set[str]] = {}
    for module, file in files.items():
        package = module if file.name == "__init__.py" else module.rpartition(".")[0]
        found = set()
        for name in imports(ast.parse(file.read_text(encoding="utf-8")), package):
            while name and name not in files:
                name = name.rpartition(".")[0]
            found |= {name} - {"", module}
        graph[module] = found
    return graph


def circle_in(graph: dict[str, set[str]]) -> list[str]:
    """Modules that import each the next and the last the first; none where there is no circle."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        # Found against the direction of the imports.
        return list(reversed(error.args[1]))
    return []


def test_no_module_imports_itself_through_others() -> None:
    files = {module_name(file): file for file in sorted(SOURCE.rglob("*.py"))}
    circle = circle_in(import_graph(files))
    assert not circle, " imports ".join(circle)


def test_circles_are_seen_inside_functions_and_not_where_only_types_are_checked(tmp_path: Path) -> None:
    sources = {
        "p.a": "import p.b\n",
        "p.b": "def f():\n    from p import c\n",
        "p.c": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from p.a import x\n",
    }
    files = {}
    for name, text in sources.items():
        files[name] = tmp_path / f"{name}.py"
        files[name].write_text(text)
    assert circle_in(import_graph(files)) == []
    files["p.c"].write_text("class C:\n    def f(self):\n        from p.a import x\n")
    circle = circle_in(import_graph(files))
    assert circle[0] == circle[-1]
    assert "p.a p.b p.c p.a" in " ".join([*circle, *circle[1:]])
