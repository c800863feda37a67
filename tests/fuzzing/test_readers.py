"""Damaged files are read, or refused in a sentence: a few of the many that `python -m tests.fuzzing` reads."""

from __future__ import annotations

import gc
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from tests.fuzzing.confined import SLACK, ending
from tests.fuzzing.samples import NotFiniteError, case, samples

from pb4u.errors import InputError
from pb4u.io.reading_limits import HEADROOM

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the memory that is taken is read from /proc")


def test_sound_files_are_read(tmp_path: Path) -> None:
    for number, sample in enumerate(samples()):
        for read in sample.readers:
            read(sample.written(tmp_path / str(number)))


@pytest.mark.parametrize("block", [0, *(pytest.param(block, marks=pytest.mark.slow) for block in (1, 2))])
def test_damaged_files_are_read_or_refused(block: int, tmp_path: Path) -> None:
    gc.freeze()  # what other tests left need not be looked through before each file
    for number in range(30 * block, 30 * block + 30):
        chosen = case(str(number))
        if chosen.read in chosen.sample.slow:
            continue
        path = chosen.sample.written(tmp_path / str(number))
        size = sum(len(content) for content in chosen.sample.files.values())
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            ended = ending(chosen.read, path, size)
        assert ended.is_sound, f"{number}: {chosen.name}: {ended.kind}: {ended.told}"


def _takes(path: Path) -> None:
    np.ones((HEADROOM + 2 * SLACK) // 8)


def _breaks(path: Path) -> None:
    raise KeyError("poses")


def _is_none(path: Path) -> None:
    raise NotFiniteError


def _refuses(path: Path) -> None:
    raise InputError("it is not a file")


@pytest.mark.parametrize(
    ("read", "kind"), [(_takes, "memory"), (_breaks, "traceback"), (_is_none, "not finite"), (_refuses, "refused")]
)
def test_what_is_wrong_is_told(read, kind: str, tmp_path: Path) -> None:
    assert ending(read, tmp_path, 0).kind == kind
