"""The names of `import pb4u`, after everything behind them was imported as well."""

from __future__ import annotations

from types import ModuleType

import pytest

import pb4u


@pytest.mark.parametrize("name", pb4u.__all__)
def test_a_public_name_is_not_hidden_by_a_package_of_that_name(name: str) -> None:
    for _ in range(2):
        assert not isinstance(getattr(pb4u, name), ModuleType)
