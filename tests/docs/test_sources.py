"""Every table of figures names its commit, date and machine, and the tool finds those whose code changed since."""

from __future__ import annotations

import csv
import re
import subprocess
from pathlib import Path

import pytest
from tools.stale import SOURCES, report, sources

ROOT = Path(__file__).parents[2]
ENTRIES = sources(ROOT)


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry["title"])
def test_what_an_entry_names_is_there(entry: dict) -> None:
    absent = [path for path in (*entry["files"], *entry["code"]) if not (ROOT / path).exists()]
    assert not absent
    assert all(entry[key] for key in ("title", "command", "commit", "date", "machine"))
    pages = [file for file in entry["files"] if file.endswith(".md")]
    assert pages
    assert [page for page in pages if entry["commit"] not in (ROOT / page).read_text(encoding="utf-8")] == []


def test_every_table_has_an_entry_and_rows_as_long_as_its_head() -> None:
    named = {file for entry in ENTRIES for file in entry["files"]}
    tables = sorted((ROOT / "docs" / "results").rglob("*.csv"))
    assert [table for table in tables if str(table.relative_to(ROOT)) not in named] == []
    for table in tables:
        with table.open(newline="", encoding="utf-8") as stream:
            head, *rows = csv.reader(stream)
        assert rows
        assert {len(row) for row in rows} == {len(head)}, table


def test_the_page_of_contact_has_the_figures_of_its_tables() -> None:
    lines = (ROOT / "docs" / "self_contact.md").read_text(encoding="utf-8").splitlines()
    linked = [line for line in lines if line.startswith("| [") and ".csv)" in line]
    assert len(linked) == 8
    for line in linked:
        table = ROOT / "docs" / re.findall(r"\((results/\S+\.csv)\)", line)[0]
        clips = list(csv.DictReader(table.read_text(encoding="utf-8").splitlines()))

        def of(column: str) -> list[float]:
            return [float(clip[column]) for clip in clips]  # noqa: B023

        pairs, limbs = of("body pairs, frames"), of("limbs through, frames")
        skin, strain = of("skin, most [%]"), of("strain, most")
        expected = [
            f"{sum(of('frames')):,.0f}",
            f"{sum(pairs):.0f}, {sum(each > 0 for each in pairs)}",
            f"{sum(limbs):.0f}, {sum(each > 0 for each in limbs)}",
            f"{sum(each > 0.05 for each in skin)}, {max(skin):.2f} %",
            f"{sum(each > 1.5 for each in strain)}, {max(strain):.2f}",
            f"{max(of('deepest [mm]')):.1f}",
        ]
        assert [cell.strip() for cell in line.split("|")[2:-1]] == expected
        assert max(of("cloth pairs, most")) == 0.0


def test_figures_are_stale_once_their_code_has_changed(tmp_path: Path) -> None:
    def git(*words: str) -> str:
        call = ["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@example.org", *words]
        return subprocess.run(call, check=True, capture_output=True, text=True).stdout.strip()

    def commit(file: str, text: str) -> str:
        path = tmp_path / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        git("add", "-A")
        git("commit", "-qm", file)
        return git("rev-parse", "--short", "HEAD")

    git("init", "-q")
    made = commit("src/solver.py", "steps = 1\n")
    entry = f'title = "Times"\nfiles = ["page.md"]\ncommit = "{made}"\ndate = 2026-11-28\nmachine = "two cores"\n'
    commit(str(SOURCES), f'[code]\nsolver = ["src"]\n\n[[figures]]\n{entry}code = ["solver"]\n')
    assert [is_stale for is_stale, _ in report(tmp_path)] == [False]
    commit("src/solver.py", '"""The solver."""\n\nsteps = 1  # a step\n"""Number of steps."""\n')
    assert [is_stale for is_stale, _ in report(tmp_path)] == [False]
    commit("src/solver.py", "steps = 2\n")
    ((is_stale, line),) = report(tmp_path)
    assert is_stale
    assert "Times: stale, 1 files of code changed since, such as src/solver.py" in line
    assert list(report(tmp_path, "other")) == []
