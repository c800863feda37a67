"""Sentences that users did not understand do not come back."""

from __future__ import annotations

from pathlib import Path

import pb4u

RETIRED = (
    "led over by slerp", "nothing: they are cut", "Left where it is", "is made anew", "leave torn",
    "There is no entry of", "nor a .json file of one", "is no whole archive of torch.save", "the flag is given",
    "was asked for a point", "does not tell its front", "Cannot tell what to write", "is no jobs file, which",
    "degrees of the way round",
)  # fmt: skip
SOURCES = [path.read_text(encoding="utf-8") for path in Path(pb4u.__file__).parent.rglob("*.py")]


def test_sentences_that_were_not_understood_are_gone() -> None:
    assert [phrase for phrase in RETIRED if any(phrase in source for source in SOURCES)] == []
