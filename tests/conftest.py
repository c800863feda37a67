"""Fixtures shared by all tests."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

# What tests start finds modules that are compiled already: importing torch from its sources takes three seconds.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

if "PYTEST_XDIST_WORKER" in os.environ:
    # Workers share the processors; each and what it starts gets one thread, so that none waits for another's.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    torch.set_num_threads(int(os.environ["OMP_NUM_THREADS"].split(",")[0]))


LONGEST_FIRST = (
    "house/test_static_checks.py", "cli/test_simulate.py", "viewer/test_page.py", "examples/test_examples.py",
    "docs/test_documented_commands.py", "release/test_wheel.py", "dataset/test_dataset_run.py",
    "golden/test_equal_results.py", "cli/test_evaluate.py", "training/test_never_lost.py",
    "training/test_device_training.py", "training/test_distribution.py", "fuzzing/test_readers.py",
    "export/test_bones_in_a_browser.py", "training/test_trainer.py",
)  # fmt: skip
"""Files that a worker begins with, so that none waits for another's at the end. The first compiles no kernels: while it
is checked, the other worker compiles those that both need."""


def pytest_addoption(parser: pytest.Parser, pluginmanager: pytest.PytestPluginManager) -> None:
    # Those of pytest-xdist in `addopts`, for a run without it.
    if not pluginmanager.hasplugin("xdist"):
        parser.addoption("--dist")
        parser.addoption("--no-loadscope-reorder", action="store_true")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    order = {Path(__file__).parent / name: number for number, name in enumerate(LONGEST_FIRST)}
    items.sort(key=lambda item: order.get(item.path, len(order)))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    slow = [item for item in terminalreporter.stats.get("deselected", []) if item.get_closest_marker("slow")]
    if slow:
        terminalreporter.write_line(f"Slow tests left out, which -m slow runs: {len(slow)}.")


def pytest_collection_finish() -> None:
    # Modules stay: each collection of garbage would look through them again.
    gc.freeze()


@pytest.fixture(scope="session")
def test_data() -> Path:
    """Folder of recordings and garments made by others; they are not part of the repository."""
    folder = Path(os.environ.get("PB4U_TEST_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip("the folder of recordings is absent; set PB4U_TEST_DATA to run this test")
    return folder


@pytest.fixture(scope="session")
def compat() -> Path:
    """Folder of what the released research code computes and writes; it is not part of the repository."""
    folder = Path(os.environ.get("PB4U_TEST_COMPAT", Path(__file__).resolve().parents[2] / "shared" / "compat"))
    if not folder.is_dir():
        pytest.skip("the golden data of the released code is absent; set PB4U_TEST_COMPAT to run this test")
    return folder


@pytest.fixture
def one_thread() -> Iterator[None]:
    """Small tensor operations on one thread, as trainings on a processor run."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)
