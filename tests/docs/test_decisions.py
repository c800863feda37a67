"""Decisions speak of the code as it is, and someone who reads the code or a page meets them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DECISIONS = sorted((ROOT / "docs" / "decisions").glob("*.md"))
PATH = re.compile(r"`((?:[\w.-]+/)+[\w.-]*|[\w-]+\.(?:py|md|toml))(?:::?\w+)?`")
COMMIT = re.compile(r"\bcommit `?[0-9a-f]{7,40}\b")
HISTORY = {ROOT / "CHANGELOG.md", ROOT / "LAB_LOG.md"}


def _exists(path: str) -> bool:
    roots = (ROOT, ROOT / "src" / "pb4u", ROOT / "src" / "pb4u" / "paper", ROOT / "docs")
    return any((root / path).exists() for root in roots)


@pytest.fixture(scope="module")
def readers() -> str:
    """All that a reader of today's code or pages sees."""
    files = [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")]
    for folder in ("docs/guides", "docs/science", "docs/api", "src", "tests", "tools", "benchmarks"):
        files += [path for path in (ROOT / folder).rglob("*") if path.suffix in (".md", ".py")]
    return "\n".join(path.read_text(encoding="utf-8") for path in files if path not in HISTORY)


@pytest.mark.parametrize("decision", DECISIONS, ids=lambda path: path.stem)
def test_every_path_in_a_decision_exists_or_is_named_with_a_commit(decision: Path) -> None:
    for paragraph in decision.read_text(encoding="utf-8").split("\n\n"):
        absent = [path for path in PATH.findall(paragraph) if not _exists(path)]
        assert not absent or COMMIT.search(paragraph), f"{absent} in: {paragraph[:80]}"


@pytest.mark.parametrize("decision", DECISIONS, ids=lambda path: path.stem)
def test_every_decision_is_cited_where_its_choice_is_met(decision: Path, readers: str) -> None:
    number = int(decision.name[:4])
    assert re.search(rf"{re.escape(decision.stem)}|decisions? (?:\d+ and )?{number}\b", readers, re.IGNORECASE)
