"""Every table of figures names its commit, date and machine, and the tool finds those whose code changed since."""

from __future__ import annotations

import csv
import re
import subprocess
from pathlib import Path

import pytest
from tools.stale import SOURCES, make, report, sources

ROOT = Path(__file__).parents[2]
ENTRIES = sources(ROOT)


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry["title"])
def test_what_an_entry_names_is_there(entry: dict) -> None:
    absent = [path for path in (*entry["files"], *entry["code"]) if not (ROOT / path).exists()]
    assert not absent
    assert all(entry[key] for key in ("title", "commands", "commit", "date", "machine"))
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
    assert len(linked) == 6
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


def committed(folder: Path, file: str, text: str) -> str:
    """Commit of a repository in which a file has a new text."""

    def git(*words: str) -> str:
        call = ["git", "-C", str(folder), "-c", "user.name=a", "-c", "user.email=a@example.org", *words]
        return subprocess.run(call, check=True, capture_output=True, text=True).stdout.strip()

    path = folder / file
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    git("init", "-q")
    git("add", "-A")
    git("commit", "-qm", file, "--allow-empty")
    return git("rev-parse", "--short=8", "HEAD")


def entry_of(commit: str, command: str = "exit 1", more: str = "") -> str:
    """A file of sources with one set of figures."""
    entry = f'title = "Times"\nfiles = ["page.md"]\ncommands = ["{command}"]\ncommit = "{commit}"\ndate = 2025-11-28\n'
    return (
        f'[code]\nsolver = ["src"]\n\n[[figures]]\n{entry}machine = "two cores"\ncode = ["solver"]\n{more}\n'
        '[[figures]]\ntitle = "Others"\nfiles = ["other.md"]\ncommands = []\ncommit = "0"\ndate = 2025-11-28\n'
        'machine = "two cores"\ncode = ["solver"]\nrecord = true\n'
    )


def test_stale_figures_are_made_again_and_name_the_new_commit(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    made = committed(tmp_path, "src/solver.py", "steps = 1\n")
    committed(tmp_path, str(SOURCES), entry_of(made, "cp src/solver.py page.md"))
    make(tmp_path)
    assert not (tmp_path / "page.md").exists()
    head = committed(tmp_path, "src/solver.py", "steps = 2\n")
    make(tmp_path)
    assert (tmp_path / "page.md").read_text() == "steps = 2\n"
    times, others = sources(tmp_path)
    assert (times["commit"], others["commit"]) == (head, "0")
    assert times["date"] > others["date"]
    assert "page.md may quote what was" in capsys.readouterr().out


def test_figures_stay_where_their_command_fails_or_the_repository_has_changes(tmp_path: Path) -> None:
    made = committed(tmp_path, "src/solver.py", "steps = 1\n")
    committed(tmp_path, str(SOURCES), entry_of(made))
    head = committed(tmp_path, "src/solver.py", "steps = 2\n")
    with pytest.raises(SystemExit, match="This command failed; the figures stay as they were: exit 1"):
        make(tmp_path)
    assert sources(tmp_path)[0]["commit"] == made != head
    (tmp_path / "src" / "solver.py").write_text("steps = 3\n")
    with pytest.raises(SystemExit, match="commit or stash the changes"):
        make(tmp_path)


def test_figures_are_stale_once_their_code_has_changed(tmp_path: Path) -> None:
    def commit(file: str, text: str) -> str:
        return committed(tmp_path, file, text)

    made = commit("src/solver.py", "steps = 1\n")
    commit(str(SOURCES), entry_of(made))
    assert [is_stale for is_stale, _ in report(tmp_path)] == [False, False]
    commit("src/solver.py", '"""The solver."""\n\nsteps = 1  # a step\n"""Number of steps."""\n')
    assert [is_stale for is_stale, _ in report(tmp_path)] == [False, False]
    commit("src/new.safetensors", "weights")
    assert [is_stale for is_stale, _ in report(tmp_path)] == [False, False]
    commit("src/solver.py", "def steps(count):\n    return count\n")
    (is_stale, line), (_, record) = report(tmp_path)
    assert is_stale
    assert "Others: a record" in record
    assert "Times: stale, 1 files of code changed since, such as src/solver.py" in line
    assert list(report(tmp_path, "nothing")) == []
    commit(str(SOURCES), entry_of(commit("src/solver.py", "def steps(count):\n    return count\n")))
    commit("src/solver.py", "def steps(number):\n    return number\n")
    assert [is_stale for is_stale, _ in report(tmp_path)] == [False, False]
    made = commit("src/new.safetensors", "weights")
    commit(str(SOURCES), entry_of(made))
    commit("src/new.safetensors", "other weights")
    assert [is_stale for is_stale, _ in report(tmp_path)] == [True, False]
    commit("src/new.safetensors", "weights")
    (tmp_path / "src/new.safetensors").unlink()
    commit("page.md", "Times of old.")
    assert [is_stale for is_stale, _ in report(tmp_path)] == [False, False]
    commit("page.md", "Times of old and new.")
    assert [is_stale for is_stale, _ in report(tmp_path)] == [True, False]
