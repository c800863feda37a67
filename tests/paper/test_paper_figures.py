"""The paper's figures as they were typed in."""

from __future__ import annotations

import pytest

from pb4u.paper.paper_figures import PAPER, TERMS, paper_figures
from pb4u.paper.protocols import PROTOCOLS


@pytest.mark.parametrize("protocol", ["resolution", "unseen"])
def test_totals_are_the_sums_of_their_terms(protocol: str) -> None:
    for level, models in PAPER[protocol].items():
        for model, figures in models.items():
            parts = [figures[term] for term in TERMS[:-1]]
            # Each figure has three digits, and the total its own; the printed sum of HOOD at 38K is off by 0.01.
            tolerance = 0.006 * max(abs(part) for part in parts) + 0.005 * abs(figures["total"])
            assert figures["total"] == pytest.approx(sum(parts), abs=tolerance), (level, model)


def test_tables_of_the_paper_agree_where_they_overlap() -> None:
    for models, level in zip(PAPER["ablation"].values(), ("11K", "25K", "38K"), strict=True):
        whole = PAPER["resolution"][level]
        assert models["Pb4U-GNet"]["total"] == whole["Pb4U-GNet"]["total"]
        assert models["w/o both"]["total"] == whole["MGN"]["total"]


def test_every_level_with_figures_is_a_level_of_its_protocol() -> None:
    for name, levels in PAPER.items():
        assert set(levels) <= set(PROTOCOLS[name].levels)
    assert paper_figures("resolution", "1200") == {}
    assert paper_figures("depth", "12K") == {}
