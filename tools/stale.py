"""Tells which figures of the documentation are stale: the code that they depend on has changed since they were made.

    python tools/stale.py            # all figures, with the number of commits since
    python tools/stale.py --only contact

`docs/results/sources.toml` names the commit, date, machine and command of each set of figures, and the code that it
depends on. The exit code is 1 where any is stale.
"""

from __future__ import annotations

import argparse
import subprocess
from collections.abc import Iterator
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


def changes(root: Path, commit: str, paths: list[str]) -> list[str]:
    """Commits after `commit` that changed one of the paths, the latest first, each with its date.

    Args:
        root: the repository.
        commit: the commit that made the figures.
        paths: files and folders, from the root.

    Raises:
        SystemExit: the commit is not in the history, as in a shallow clone.
    """
    call = ["git", "-C", str(root), "log", "--format=%h of %as", f"{commit}..HEAD", "--", *paths]
    ended = subprocess.run(call, capture_output=True, text=True)
    if ended.returncode:
        raise SystemExit(f"git does not know commit {commit}; fetch the whole history with git fetch --unshallow.")
    return ended.stdout.splitlines()


def report(root: Path, only: str = "") -> Iterator[tuple[bool, str]]:
    """Whether each set of figures is stale, and a line that says so.

    Args:
        root: the repository.
        only: text that the title or a file of a set contains.
    """
    for entry in sources(root):
        if only.lower() not in " ".join((entry["title"], *entry["files"])).lower():
            continue
        since = changes(root, entry["commit"], entry["code"])
        state = f"stale, {len(since)} commits since, the last {since[0]}" if since else "fresh"
        made = f"commit {entry['commit']}, {entry['date']}, {entry['machine']}"
        yield bool(since), f"{entry['title']}: {state}\n    {', '.join(entry['files'])}\n    {made}"


def main() -> None:
    """Print a line for each set of figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="text that the title or a file of the figures contains")
    lines = list(report(ROOT, parser.parse_args().only))
    print("\n".join(line for _, line in lines))
    raise SystemExit(any(is_stale for is_stale, _ in lines))


if __name__ == "__main__":
    main()
