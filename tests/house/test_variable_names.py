"""Variables are called by what they hold (pairs, report, residual), not by a word of grammar (found, told, kept)."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[2] / "src" / "pb4u"
GRAMMAR = {
    "asked", "done", "each", "found", "given", "held", "its", "kept", "known", "left", "listed", "made", "met", "moved",
    "named", "own", "said", "told", "wanted", "whole", "worn",
}  # fmt: skip
# What is left: kernels and what calls them.
MOST_OF_PACKAGE = Counter(collision=75, physics=74)
# Elsewhere: steps done of a total, the left side, arguments and fields that are public, kernels of the network.
MOST_OF_NAME = Counter(done=12, left=8, kept=5, own=5, worn=2, found=1, given=1, held=1, listed=1, wanted=1)


def bound_names(tree: ast.AST) -> Iterator[tuple[str, int]]:
    """Name and line of all that is assigned, looped over or taken as an argument."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id, node.lineno
        elif isinstance(node, ast.arg):
            yield node.arg, node.lineno


def test_variables_are_called_by_what_they_hold() -> None:
    places: dict[str, list[str]] = {}
    for file in SOURCE.rglob("*.py"):
        path = file.relative_to(SOURCE)
        for name, line in bound_names(ast.parse(file.read_text(encoding="utf-8"))):
            if name in GRAMMAR:
                group = path.parts[0] if path.parts[0] in MOST_OF_PACKAGE else name
                places.setdefault(group, []).append(f"{path}:{line} {name}")
    most = MOST_OF_PACKAGE + MOST_OF_NAME
    too_many = {group: sorted(lines) for group, lines in places.items() if len(lines) > most[group]}
    assert not too_many, "Call one more of these by what it holds"


def test_assignments_loops_and_arguments_are_seen() -> None:
    source = (
        "def f(told, *, kept=0):\n    found = [own for own in told]\n    for each in found:\n        each.made = 1\n"
    )
    assert {name for name, _ in bound_names(ast.parse(source))} == {"told", "kept", "found", "own", "each"}
