"""Names that modules of higher layers register."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from pb4u.errors import InputError
from pb4u.registry import PROVIDERS, Registry

KIND: Registry[int] = Registry("test entry", {"own": 1})


@pytest.fixture
def provided(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file of a provider that registers "more" when it is imported, and whatever is added to it."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(PROVIDERS, "test entry", ("absent_package.part", "test_entry_provider"))
    monkeypatch.setitem(sys.modules, "test_entries", sys.modules[__name__])
    monkeypatch.delitem(sys.modules, "test_entry_provider", raising=False)
    monkeypatch.setattr(KIND, "_entries", {"own": 1})
    file = tmp_path / "test_entry_provider.py"
    file.write_text('from test_entries import KIND\nKIND["more"] = 2\n')
    return file


def test_a_provider_is_imported_when_a_name_is_missed_and_not_before(provided: Path) -> None:
    assert KIND["own"] == KIND.named("own") == 1
    assert "test_entry_provider" not in sys.modules
    assert KIND["more"] == 2
    assert KIND.get("other") is None


def test_all_names_are_those_of_absent_providers_left_out(provided: Path) -> None:
    assert dict(KIND) == {"own": 1, "more": 2}
    assert len(KIND) == 2
    with pytest.raises(InputError, match=r"no test entry 'mor'; did you mean more\?"):
        KIND.named("mor")


def test_what_a_provider_lacks_is_not_passed_over(provided: Path) -> None:
    provided.write_text("import absent_package_of_the_provider\n")
    with pytest.raises(ModuleNotFoundError, match="absent_package_of_the_provider"):
        list(KIND)
