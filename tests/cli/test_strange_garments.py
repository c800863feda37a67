"""Twenty-four garment files and what is found in each: `pb4u check` and `pb4u simulate` say the same of them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.cli.strange_garments import MAKERS, written

# Findings by their codes; the first of a file that is refused is what a simulation says.
EXPECTED: dict[str, list[str]] = {
    "sound": [],
    "in centimetres": ["units!", "misplaced!", "front"],
    "in inches": ["units!", "misplaced!", "front"],
    "with Z up": ["misplaced!", "axes", "front"],
    "two metres away": ["misplaced!", "place", "front"],
    "inside out": ["inside-out"],
    "some faces turned over": ["orientation"],
    "open seams": ["unwelded", "pieces", "unsupported"],
    "halves with a gap": ["pieces", "unsupported"],
    "sewn by threads": ["threads"],
    "threads too long": ["pieces", "unsewn", "unsupported"],
    "a pocket sewn on": ["non-manifold!", "duplicate", "orientation"],
    "two layers": ["pieces", "double-layer", "unsupported"],
    "a face twice": ["duplicate"],
    "a face without area": ["degenerate", "isolated"],
    "vertices of no face": ["isolated"],
    "meshed unevenly": ["graded"],
    "partly unwrapped": ["no-uvs"],
    "through itself": ["graded", "self-crossing"],
    "too narrow": ["penetration"],
    "held by nothing": ["unsupported"],
    "too coarse": ["coarse"],
    "a body among it": ["body!", "pieces", "graded", "self-crossing", "penetration"],
    "a body": ["body!", "graded", "self-crossing", "penetration"],
}


@pytest.mark.parametrize("case", MAKERS)
def test_check_and_simulate_find_the_same(pb4u: Callable, tmp_path: Path, case: str) -> None:
    path = written(tmp_path, case)
    checked = pb4u("check", path, "--json", tmp_path / "check.json")
    found = json.loads((tmp_path / "check.json").read_text())["garment"]
    codes = [each["code"] + ("!" if each["severity"] == "refused" else "") for each in found["findings"]]
    assert codes == EXPECTED[case]
    out = tmp_path / "out.npz", "--json", tmp_path / "out.json"
    simulated = pb4u("simulate", "--garment", path, "--model", "skinning", "--frames", 1, "--out", *out)
    refused = any(code.endswith("!") for code in codes)
    assert (checked.code, simulated.code) == (refused, refused)
    sentences = [each["sentence"][:-1].partition(", the first faces")[0] for each in found["findings"]]
    if refused:
        assert sentences[0] in simulated.err
        return
    notes = json.loads((tmp_path / "out.json").read_text())["notes"]
    for sentence in sentences:
        # A collar that holds it is told by what was done with it.
        told = "its collar" if "Nothing but its collar" in sentence else sentence
        assert any(told in note for note in notes)
