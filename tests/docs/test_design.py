"""Design pages speak of the code as it is, and someone who reads the code or a page meets them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted((ROOT / "docs" / "design").glob("*.md"))
PATH = re.compile(r"`((?:[\w.-]+/)+[\w.-]*|[\w-]+\.(?:py|md|toml))(?:::?\w+)?`")
CITED = re.compile(r"design/(\w+)\.md")
NUMBERED = re.compile(r"\bdecisions? \d+\b", re.IGNORECASE)
MOST_PAGES, MOST_WORDS, MOST_WORDS_OF_ALL = 20, 12_000, 45_000


def _exists(path: str) -> bool:
    return any((ROOT / root / path).exists() for root in ("", "src/pb4u", "src/pb4u/paper", "docs"))


def _texts() -> dict[Path, str]:
    """All that a reader of today's code or pages sees, but for the list of design pages."""
    files = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]
    for folder in ("src", "tests", "tools", "benchmarks"):
        files += (ROOT / folder).rglob("*.py")
    return {file: file.read_text(encoding="utf-8") for file in files}


TEXTS = _texts()
ELSEWHERE = {file: text for file, text in TEXTS.items() if file.parent.name != "design"}


def test_the_pages_can_be_read_whole() -> None:
    assert len(PAGES) <= MOST_PAGES
    assert sum(len(TEXTS[page].split()) for page in PAGES) <= MOST_WORDS
    assert sum(len(text.split()) for file, text in TEXTS.items() if ROOT / "docs" in file.parents) <= MOST_WORDS_OF_ALL


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_every_path_on_a_page_exists(page: Path) -> None:
    assert [path for path in PATH.findall(page.read_text(encoding="utf-8")) if not _exists(path)] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_every_page_begins_with_its_answer_and_a_table_or_picture(page: Path) -> None:
    title, answer, *rest = page.read_text(encoding="utf-8").split("\n\n")
    assert title.startswith("# ")
    assert answer.startswith("**")
    assert any(part.lstrip().startswith(("|", "![")) for part in rest[:2])


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_every_page_is_cited_where_its_choice_is_met(page: Path) -> None:
    assert any(page.stem in CITED.findall(text) for text in ELSEWHERE.values())


def test_every_citation_leads_to_a_page() -> None:
    stems = {page.stem for page in PAGES}
    astray = {(file.name, stem) for file, text in TEXTS.items() for stem in CITED.findall(text) if stem not in stems}
    assert astray == set()
    numbered = {file.name: NUMBERED.findall(text) for file, text in ELSEWHERE.items() if file != Path(__file__)}
    assert {name: found for name, found in numbered.items() if found} == {}
