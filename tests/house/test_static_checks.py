"""The house rules that a machine can hold: lint, format, types, layers."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SOURCES = [name for name in ("src", "tests", "benchmarks", "examples", "tools") if any((ROOT / name).rglob("*.py"))]


@pytest.mark.parametrize(
    "command",
    [
        ["ruff", "check", "--no-cache", *SOURCES],
        ["ruff", "format", "--check", "--no-cache", *SOURCES],
        ["mypy"],
        ["importlinter.cli", "lint"],
    ],
    ids=["lint", "format", "types", "layers"],
)
def test_static_check(command: list[str]) -> None:
    if command[0] == "importlinter.cli":
        call = [sys.executable, "-c", "from importlinter.cli import lint_imports_command; lint_imports_command()"]
    else:
        call = [sys.executable, "-m", *command]
    # Kept from clone to clone: what mypy knows of the dependencies takes it most of its time.
    kept = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "pb4u" / "mypy"
    environment = {"MYPY_CACHE_DIR": str(kept)} | os.environ
    done = subprocess.run(call, cwd=ROOT, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-2000:]
