"""What no run of the tests may leave out."""

from __future__ import annotations

from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]


def test_no_law_and_no_golden_value_is_slow() -> None:
    files = [file for folder in ("laws", "golden", "physics") for file in (TESTS / folder).glob("test_*.py")]
    assert files
    assert [file.name for file in files if "mark.slow" in file.read_text()] == []
