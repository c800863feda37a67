"""Tells which figures of the documentation are stale: the code that they depend on has changed since they were made.

    python tools/stale.py                   # all figures
    python tools/stale.py --only contact

`docs/results/sources.toml` names the commit, date, machine and command of each set of figures, and the code that it
depends on. The exit code is 1 where any is stale.
"""

from __future__ import annotations

import argparse
import ast
import subprocess
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

from pb4u.io.toml_file import tomllib

ROOT = Path(__file__).resolve().parents[1]
SOURCES = Path("docs") / "results" / "sources.toml"


def sources(root: Path) -> list[dict[str, Any]]:
    """Entries of the file of sources; `code` of each is the list of paths that its figures depend on.

    Args:
        root: the repository.
    """
    content = tomllib.loads((root / SOURCES).read_text(encoding="utf-8"))
    groups = content["code"]
    return [
        entry | {"code": sorted({path for name in entry["code"] for path in groups[name]})}
        for entry in content["figures"]
    ]


def changed_files(root: Path, commit: str, paths: list[str]) -> list[str]:
    """Files of the paths whose code differs between `commit` and HEAD; comments and docstrings do not count.

    Args:
        root: the repository.
        commit: the commit that made the figures.
        paths: files and folders, from the root.

    Raises:
        SystemExit: the commit is not in the history, as in a shallow clone.
    """
    head = (_git(root, "rev-parse", "HEAD") or "").strip()
    differing = _git(root, "diff", "--name-only", "--no-renames", commit, head, "--", *paths)
    if differing is None:
        raise SystemExit(f"git does not know commit {commit}; fetch the whole history with git fetch --unshallow.")
    return [name for name in differing.splitlines() if _code(root, commit, name) != _code(root, head, name)]


def _git(root: Path, *words: str) -> str | None:
    ended = subprocess.run(["git", "-C", str(root), *words], capture_output=True, text=True, errors="replace")
    return None if ended.returncode else ended.stdout


def _is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


@cache
def _code(root: Path, commit: str, name: str) -> str:
    """What a file of a commit computes: its text, of Python its syntax tree without strings that stand alone."""
    text = _git(root, "show", f"{commit}:{name}") or ""
    if not name.endswith(".py"):
        return text
    tree = ast.parse(text)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [each for each in body if not _is_text(each)]
    return ast.dump(tree)


def report(root: Path, only: str = "") -> Iterator[tuple[bool, str]]:
    """Whether each set of figures is stale, and lines that say so.

    Args:
        root: the repository.
        only: text that the title or a file of a set contains.
    """
    for entry in sources(root):
        if only.lower() not in " ".join((entry["title"], *entry["files"])).lower():
            continue
        changed = changed_files(root, entry["commit"], entry["code"])
        state = f"stale, {len(changed)} files of code changed since, such as {changed[0]}" if changed else "fresh"
        made = f"commit {entry['commit']}, {entry['date']}, {entry['machine']}"
        yield bool(changed), f"{entry['title']}: {state}\n    {', '.join(entry['files'])}\n    {made}"


def main() -> None:
    """Print whether each set of figures is stale."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="text that the title or a file of the figures contains")
    lines = list(report(ROOT, parser.parse_args().only))
    print("\n".join(line for _, line in lines))
    raise SystemExit(any(is_stale for is_stale, _ in lines))


if __name__ == "__main__":
    main()
