"""The documentation site: built without a warning, every page reached, no link or anchor that leads nowhere."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

import pb4u
from pb4u.run import ENTRIES

pytestmark = pytest.mark.slow
ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    for needed in ("mkdocs", "material", "mkdocstrings", "latex2mathml"):
        pytest.importorskip(needed, reason='needs the "docs" extra')
    out = tmp_path_factory.mktemp("site")
    call = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(out)]
    ended = subprocess.run(
        call, cwd=ROOT, capture_output=True, text=True, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert "WARNING" not in ended.stdout + ended.stderr
    return out


class Read(HTMLParser):
    """Links and anchors of a page."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.anchors: set[str] = set()
        self.feed(page.read_text())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name in ("href", "src") and value is not None:
                self.links.append(value)
            elif name in ("id", "name") and value is not None:
                self.anchors.add(value)


def dead_links(site: Path) -> Iterator[str]:
    pages = {page: Read(page) for page in site.rglob("*.html")}
    for page, read in pages.items():
        if page.name == "404.html":  # its links are from the root of wherever the site is put
            continue
        for link in read.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (page.parent / unquote(parts.path)).resolve() if parts.path else page
            target = target / "index.html" if target.is_dir() else target
            if not target.is_file():
                yield f"{page.relative_to(site)}: {link}"
            elif parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].anchors:
                yield f"{page.relative_to(site)}: {link} (no such anchor)"


def test_no_link_is_dead(site: Path, tmp_path: Path) -> None:
    assert len(list(site.rglob("*.html"))) > 50
    assert list(dead_links(site)) == []
    (tmp_path / "page.html").write_text('<a href="absent/">x</a><a href="#here">y</a><b id="there"></b>')
    assert list(dead_links(tmp_path)) == ["page.html: absent/", "page.html: #here (no such anchor)"]


def test_nothing_is_fetched_from_elsewhere(site: Path) -> None:
    for page in site.rglob("*.html"):
        fetched = re.findall(
            r"<(?:script|img|link|iframe|source)[^>]*(?:src|href)=\"?(https?:[^\" >]+)", page.read_text()
        )
        assert [link for link in fetched if "canonical" not in link] == [], page


def test_every_public_name_is_on_the_page_of_python(site: Path) -> None:
    page = (site / "api" / "python" / "index.html").read_text()
    for name in pb4u.__all__:
        assert f"pb4u.{name}" in page, name
    text = re.sub(r"<[^>]+>", "", page)
    assert "(frames, vertices, 3) float32 [m]" in text
    assert "Raises" in text


def test_every_verb_and_flag_is_on_the_page_of_commands(site: Path) -> None:
    page = re.sub(r"<[^>]+>", "", (site / "api" / "commands" / "index.html").read_text())
    for told in ("pb4u simulate", "pb4u batch", "pb4u assets write", "--propagation-steps K", "--clips-per-shard N"):
        assert told in page, told


def test_every_entry_of_a_scene_file_is_in_the_guide(site: Path) -> None:
    page = (site / "guides" / "scene_files" / "index.html").read_text()
    assert [name for name in ENTRIES if f"<code>{name}</code>" not in page] == []


def test_formulas_are_drawn_and_the_first_page_moves(site: Path) -> None:
    assert (site / "science" / "equations" / "index.html").read_text().count("<math") >= 10
    assert "images/outfit_dance.gif" in (site / "index.html").read_text()
    assert (site / "images" / "outfit_dance.gif").read_bytes()[:6] == b"GIF89a"
    pages = {page.stem for page in (ROOT / "docs" / "design").glob("*.md")} - {"index"}
    assert {page.parent.name for page in (site / "design").glob("*/index.html")} == pages
