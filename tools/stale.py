"""Tells which figures of the documentation are stale: the code that they depend on has changed since they were made.

    python tools/stale.py                            # all figures
    python tools/stale.py --only contact
    python tools/stale.py --only contact --make      # makes those that are stale again, one after another

`docs/results/sources.toml` names the commit, date, machine and commands of each set of figures, and the code that it
depends on. The exit code is 1 where any is stale. Records, as of trainings, never are: they say what was measured then.
`--make` takes hours for all of them. It writes the tables and the new commit and date; the pages that quote figures are
named, to be mended by hand. What the commands keep, so that they go on after a kill, is under `build/figures`.
"""

from __future__ import annotations

import argparse
import ast
import json
import re
import subprocess
from collections.abc import Iterator
from datetime import date
from functools import cache
from pathlib import Path
from types import CodeType
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


def changed_files(root: Path, commit: str, paths: list[str], shown: str = "") -> list[str]:
    """Files of the paths whose code differs between `commit` and HEAD; comments and docstrings do not count.

    Args:
        root: the repository.
        commit: the commit that made the figures.
        paths: files and folders, from the root.
        shown: text of the figures.

    Raises:
        SystemExit: the commit is not in the history, as in a shallow clone.
    """
    head = (_git(root, "rev-parse", "HEAD") or "").strip()
    differing = _git(root, "diff", "--name-only", "--no-renames", commit, head, "--", *paths)
    if differing is None:
        raise SystemExit(f"git does not know commit {commit}; fetch the whole history with git fetch --unshallow.")
    code = {name: (_code(root, commit, name), _code(root, head, name)) for name in differing.splitlines()}
    return [
        name
        for name, (before, after) in code.items()
        # Weights that came or went are of no figure that does not name them.
        if before != after and ((before and after) or not name.endswith(".safetensors") or Path(name).stem in shown)
    ]


def _note(root: Path, title: str, commit: str) -> None:
    """Write the commit and today's date to the entry of a title."""
    before, begun, entry = (root / SOURCES).read_text(encoding="utf-8").partition(f"title = {json.dumps(title)}")
    entry = re.sub(r"^commit = .*$", f'commit = "{commit}"', entry, count=1, flags=re.MULTILINE)
    entry = re.sub(r"^date = .*$", f"date = {date.today()}", entry, count=1, flags=re.MULTILINE)
    (root / SOURCES).write_text(before + begun + entry, encoding="utf-8")


def _is_meant(entry: dict[str, Any], only: str) -> bool:
    return only.lower() in " ".join((entry["title"], *entry["files"])).lower()


def _changed_since(root: Path, entry: dict[str, Any]) -> list[str]:
    if entry.get("record"):
        return []
    shown = "".join(
        path.read_text(encoding="utf-8", errors="ignore")
        for path in (root / f for f in entry["files"])
        if path.exists()
    )
    return changed_files(root, entry["commit"], entry["code"], shown)


def _git(root: Path, *words: str) -> str | None:
    ended = subprocess.run(["git", "-C", str(root), *words], capture_output=True, text=True, errors="replace")
    return None if ended.returncode else ended.stdout


@cache
def _code(root: Path, commit: str, name: str) -> object:
    """What a file of a commit computes: its text, of Python its bytecode.

    That has neither comments, docstrings nor the names of local variables. What is said to users does not count either.
    """
    text = _git(root, "show", f"{commit}:{name}") or ""
    if not name.endswith(".py"):
        return text
    tree = ast.parse(text)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [each for each in body if not _is_text(each)] or [ast.Pass()]  # type: ignore[attr-defined]
    return _computes(compile(ast.fix_missing_locations(tree), name, "exec"))


def _is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def _computes(code: CodeType) -> object:
    constants = [
        _computes(each) if isinstance(each, CodeType) else repr(each)
        for each in code.co_consts
        if not (isinstance(each, str) and " " in each)
    ]
    return code.co_code, constants, code.co_names


def report(root: Path, only: str = "") -> Iterator[tuple[bool, str]]:
    """Whether each set of figures is stale, and lines that say so.

    Args:
        root: the repository.
        only: text that the title or a file of a set contains.
    """
    for entry in sources(root):
        if not _is_meant(entry, only):
            continue
        changed = _changed_since(root, entry)
        state = f"stale, {len(changed)} files of code changed since, such as {changed[0]}" if changed else "fresh"
        if entry.get("record"):
            state = "a record"
        made = f"commit {entry['commit']}, {entry['date']}, {entry['machine']}"
        yield bool(changed), f"{entry['title']}: {state}\n    {', '.join(entry['files'])}\n    {made}"


def make(root: Path, only: str = "") -> None:
    """Make the stale figures again, with nothing beside them, and note the commit and date.

    Args:
        root: the repository; what differs from its last commit is refused, since the figures name a commit.
        only: text that the title or a file of a set contains.

    Raises:
        SystemExit: the repository has changes, or a command ends with an error.
    """
    if _git(root, "status", "--porcelain", "--untracked-files=no"):
        raise SystemExit("The figures name a commit: commit or stash the changes of the repository first.")
    head = (_git(root, "rev-parse", "--short=8", "HEAD") or "").strip()
    for entry in sources(root):
        if not _is_meant(entry, only) or not _changed_since(root, entry):
            continue
        print(f"{entry['title']} ..", flush=True)
        (root / "build" / "figures").mkdir(parents=True, exist_ok=True)
        for command in entry["commands"]:
            if subprocess.run(command, shell=True, cwd=root, check=False).returncode:
                raise SystemExit(f"This command failed; the figures stay as they were: {command}")
        _note(root, entry["title"], head)
        pages = [file for file in entry["files"] if file.endswith(".md")]
        print(f"    made at {head}; {', '.join(pages)} may quote what was.", flush=True)


def main() -> None:
    """Print whether each set of figures is stale, or make those that are again."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="text that the title or a file of the figures contains")
    parser.add_argument("--make", action="store_true", help="make the stale ones again")
    options = parser.parse_args()
    if options.make:
        make(ROOT, options.only)
    lines = list(report(ROOT, options.only))
    print("\n".join(line for _, line in lines))
    raise SystemExit(any(is_stale for is_stale, _ in lines))


if __name__ == "__main__":
    main()
