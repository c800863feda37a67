"""Docstrings of public functions and classes name the InputError that their own code raises."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[2] / "src"
# `unknown_name` makes an InputError.
ERRORS = ("InputError", "unknown_name")
CONSTRUCTORS = ("__init__", "__post_init__", "__new__")

Definition = ast.FunctionDef | ast.AsyncFunctionDef


def raises_input_error(node: ast.AST) -> bool:
    """Whether the body of `node` raises one itself; functions defined inside it do not count."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, Definition | ast.Lambda | ast.ClassDef):
            continue
        if isinstance(child, ast.Raise) and isinstance(child.exc, ast.Call):
            name = ast.unparse(child.exc.func).rpartition(".")[2]
            if name in ERRORS:
                return True
        if raises_input_error(child):
            return True
    return False


def silent(tree: ast.Module) -> Iterator[str]:
    """Names of public functions, methods and classes that raise InputError and do not say so."""
    for node in tree.body:
        if isinstance(node, Definition) and not node.name.startswith("_"):
            if raises_input_error(node) and "InputError" not in (ast.get_docstring(node) or ""):
                yield node.name
        elif isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            for method in node.body:
                if not isinstance(method, Definition) or not raises_input_error(method):
                    continue
                if method.name in CONSTRUCTORS:
                    documented = ast.get_docstring(node)
                elif method.name.startswith("_"):
                    continue
                else:
                    # A method without a docstring of its own has that of the class it overrides.
                    documented = ast.get_docstring(method) or ("InputError" if node.bases else "")
                if "InputError" not in (documented or ""):
                    yield f"{node.name}.{method.name}"


def test_public_docstrings_name_the_input_error_that_is_raised() -> None:
    found = [
        f"{file.relative_to(SOURCE)}: {name}"
        for file in sorted(SOURCE.rglob("*.py"))
        for name in silent(ast.parse(file.read_text(encoding="utf-8")))
    ]
    assert not found, "These raise InputError, and their docstrings do not say when:\n" + "\n".join(found)


def test_a_silent_function_and_a_silent_class_are_found() -> None:
    source = '''
def told():
    """Reads. Raises InputError."""
    raise InputError("no")

def untold():
    """Reads."""
    if True:
        raise errors.InputError("no")

def inner():
    """Makes a function."""
    def check():
        raise InputError("no")
    return check

class Kept:
    """A thing."""
    def __post_init__(self):
        raise unknown_name("thing", "x", ())

    def say(self):
        """Speaks."""
        raise InputError("no")

    def _hidden(self):
        raise InputError("no")

class _Private:
    def __init__(self):
        raise InputError("no")
'''
    assert list(silent(ast.parse(source))) == ["untold", "Kept.__post_init__", "Kept.say"]
