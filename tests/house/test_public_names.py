"""The names of `import pb4u`, after everything behind them was imported as well."""

from __future__ import annotations

import subprocess
import sys
from types import ModuleType

import pb4u


def test_no_public_name_is_hidden_by_a_package_of_that_name() -> None:
    for _ in range(2):
        assert [name for name in pb4u.__all__ if isinstance(getattr(pb4u, name), ModuleType)] == []


def test_what_takes_long_to_import_waits_until_it_is_used() -> None:
    slow = "{'scipy.signal', 'scipy.stats'} & set(sys.modules)"
    program = f"import sys, pb4u; pb4u.make_scene, pb4u.load_simulator; assert not {slow}"
    subprocess.run([sys.executable, "-c", program], check=True)


def test_help_is_told_without_what_computes() -> None:
    slow = "{'filelock', 'numpy', 'pydantic', 'scipy', 'torch'} & set(sys.modules)"
    program = (
        "import sys; from pb4u.cli.main import main; sys.argv = ['pb4u', 'simulate', '--help']\n"
        f"try: main()\nfinally: assert not {slow}"
    )
    told = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True).stdout
    assert "--garment" in told
