"""Fixtures shared by all tests."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

if "PYTEST_XDIST_WORKER" in os.environ:
    # Workers share the processors; each and what it starts gets one thread, so that none waits for another's.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    torch.set_num_threads(int(os.environ["OMP_NUM_THREADS"].split(",")[0]))


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
