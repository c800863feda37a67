"""Tables and pages as text."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure
from tests.paper.test_protocol_plan import SMALL

from pb4u.paper.page import Plot, Remark, Table, as_markdown
from pb4u.paper.paper_layout import loss_and_latency, terms_by_level, total_by_arm
from pb4u.paper.plots import across_levels
from pb4u.paper.protocol_plan import plan
from pb4u.paper.summary import Row, Spread, Summary, spread, wilson
from pb4u.paper.tables import controls_tables, level_table, terms_tables, with_spread


def result(total: float | None, ms: float = 5.0, diverged: bool = False) -> dict[str, Any]:
    return {
        "triangles": 12_000,
        "ms_per_step": ms,
        "frames": 3,
        "diverged": diverged,
        "diverged_at": 1 if diverged else None,
        "failed_at": None,
        "metrics": {"penetration_percent": {"mean": 2.0}, "penetration_depth_max": {"max": 0.012}},
        "metrics_paper": {"total": {"mean": total}},
    }


def summary_of(results: dict[tuple[str, str], dict[str, Any] | None], **request: Any) -> Summary:
    """Rows of (level, motion) with their results."""
    planned = plan(replace(SMALL, **request))
    rows = [
        Row(case, results.get((case.level, case.motion)), None, 3.0 if case.motion == "walk" else None, "stored")
        for case in planned.cases
    ]
    return Summary(planned, tuple(rows), (), lambda job: Path("absent"))


def test_a_cell_without_spread_and_one_with() -> None:
    assert with_spread("total", spread([0.5])) == "5.00e-01"
    assert with_spread("total", spread([0.5, None, 1.5])) == "1.00e+00 ± 5.00e-01"
    assert with_spread("ms", Spread(12.34, 1.0, 2)) == "12.3 ± 1.0"
    assert with_spread("total", spread([None])) == "-"


def test_levels_and_the_papers_rows_stand_together() -> None:
    at = {("12K", "walk"): result(1.0, 5.0), ("12K", "jump"): result(3.0, 7.0, diverged=True)}
    summary = summary_of(at, protocol="efficiency", levels=("12K",), motions=("walk", "jump", "turn"))
    (table,) = level_table(summary, ("total", "ms"))
    assert isinstance(table, Table)
    assert table.head == [
        "level", "model", "total loss [J]", "time a step [ms]", "energy / reference", "frames before divergence [%]",
        "penetration [%]", "diverged", "scenes",
    ]  # fmt: skip
    ours, *theirs = table.rows
    assert ours[:5] == ["12K", "skinning", "2.00e+00 ± 1.00e+00", "6.0 ± 1.0", "3"]
    assert ours[5:] == ["67 ± 33", "2 ± 0", "1 of 2 (9 to 91 %)", "2, 1 missing"]
    assert theirs[0] == ["12K", "MGN (paper, other data)", "-4.22e-01", "46.4", "", "", "", "", ""]
    assert len(theirs) == 5


def test_terms_stand_in_rows_and_the_papers_models_in_columns_set_apart() -> None:
    summary = summary_of({("11K", "walk"): result(None)}, levels=("11K", "400"))
    known, unknown = terms_tables(summary)
    assert isinstance(known, Table)
    assert isinstance(unknown, Table)
    assert list(known.head[:3]) == ["", "skinning", "MGN (paper, other data)"]
    assert len(known.head) == 7
    assert unknown.head == ["", "skinning"]
    rows = {row[0]: row[1] for row in known.rows}
    assert rows["total loss [J]"] == "-"
    assert rows["deepest penetration [mm]"] == "12.0"
    assert (rows["diverged"], rows["scenes"]) == ("0 of 1 (0 to 79 %)", "1")


def test_the_papers_layout_has_its_rows_and_marks_best_and_second() -> None:
    summary = summary_of({("11K", "walk"): result(0.5, diverged=True)}, levels=("11K",))
    (table,) = terms_by_level(summary)
    assert isinstance(table, Table)
    assert [row[0] for row in table.rows] == [
        "**11K**", "Stretch", "Bending", "Collision", "Inertia", "Gravity", "Friction", "Total", "lost",
    ]  # fmt: skip
    assert table.head[:3] == ["metric", "skinning", "MGN (paper, other data)"]
    total = table.rows[7]
    assert total == ["Total", "**5.00E-01**", "4.70E-03", "9.45E-03", "**-2.56E-02**", "4.24E-02", "<u>-1.66E-02</u>"]
    assert table.rows[8][:2] == ["lost", "1 of 1"]


def test_the_papers_layout_of_latency_and_of_the_ablation() -> None:
    (table,) = loss_and_latency(summary_of({("12K", "walk"): result(1.0)}, protocol="efficiency", levels=("12K",)))
    assert isinstance(table, Table)
    assert table.rows[0] == ["12K", "skinning", "**1.00E+00**", "**5.0**", "0 of 1"]
    assert table.rows[1] == ["12K", "MGN (paper, other data)", "-4.22E-01", "**46.4**", ""]
    (table,) = total_by_arm(summary_of({("2730", "walk"): result(None)}, protocol="ablation", levels=("1200", "2730")))
    assert isinstance(table, Table)
    assert table.head == ["model", "1200", "2730"]
    assert table.rows[0] == ["skinning", "", ""]
    assert table.rows[1] == ["Pb4U-GNet (paper, other data)", "**-1.66E-02**", "**6.34E-02**"]


def test_controls_stand_in_rows_with_what_lies_below_the_reference() -> None:
    excess = {"excess_height": {"per_frame": [2e-4, -1e-4, 3e-4], "mean": 1.3e-4, "below_reference": 1}}
    with_excess = result(1.0)
    with_excess["metrics"] = with_excess["metrics"] | excess | {"distance_to_reference": {"mean": 0.0215}}
    summary = summary_of({("11K", "walk"): with_excess}, protocol="controls", levels=("11K",), motions=("walk",))
    whole, parts = controls_tables(summary)
    assert isinstance(whole, Table)
    assert isinstance(parts, Table)
    row = dict(zip(whole.head, whole.rows[0], strict=True))
    assert (row["excess height [mm]"], row["distance from the solver's [mm]"]) == ("0.2", "21.5")
    assert (row["states below the reference"], row["diverged"]) == ("1 of 3", "0 of 1 (0 to 79 %)")
    assert parts.rows[0][1:] == ["0.2"]
    assert "excess height [mm]" in [row[0] for table in terms_tables(summary) for row in table.rows]


def test_steps_that_are_not_finite_and_rollouts_that_broke_off_count() -> None:
    """A network's worst failures are infinite and told, or left out of a mean by their number, and never unseen."""

    def measured(heights: list[float | None], distance: float | None, frames: int = 3) -> dict[str, Any]:
        metrics: dict[str, Any] = {"excess_height": {"per_frame": heights, "below_reference": 0}} if heights else {}
        if distance is not None:
            metrics["distance_to_reference"] = {"mean": distance}
        return result(1.0, diverged=frames < 3) | {
            "metrics": metrics, "frames": frames, "failed_at": None if frames == 3 else frames,
        }  # fmt: skip

    def shown(**at: dict[str, Any]) -> tuple[dict[str, str], dict[str, str]]:
        results = {("11K", motion): each for motion, each in at.items()}
        summary = summary_of(results, protocol="controls", levels=("11K",), motions=tuple(at))
        whole, terms = controls_tables(summary)[0], terms_tables(summary)[0]
        assert isinstance(whole, Table)
        assert isinstance(terms, Table)
        return dict(zip(whole.head, whole.rows[0], strict=True)), {row[0]: row[1] for row in terms.rows}

    good = measured([2e-3, 2e-3, 2e-3], 0.005)
    excess, distance = "excess height [mm]", "distance from the solver's [mm]"
    whole, terms = shown(walk=good, jump=measured([None, None, 1e-3], 0.001, frames=2))
    assert whole[excess] == "2 (2 of 6 steps not finite)"
    assert terms[excess] == "infinite (2 of 6 steps not finite)"
    assert whole[distance] == terms[distance] == "5 (1 of 2 broke off)"
    whole, terms = shown(walk=good, jump=measured([1e-3, 1e-3, 1e-3], None, frames=0))
    assert terms[excess] == "1.5 ± 0.5 (1 of 2 rollouts lost in the lead-in)"
    assert whole[excess] == "1.5 (1 of 2 rollouts lost in the lead-in)"
    whole, terms = shown(walk=measured([], None, frames=0))
    assert whole[excess] == "infinite (1 of 1 steps not finite, 1 of 1 rollouts lost in the lead-in)"
    assert whole[distance] == terms[distance] == "- (1 of 1 broke off)"


def test_the_interval_of_a_share_is_wilsons() -> None:
    assert wilson(0, 10) == pytest.approx((0.0, 0.2775), abs=1e-4)
    assert wilson(5, 10) == pytest.approx((0.2366, 0.7634), abs=1e-4)
    assert wilson(10, 10) == pytest.approx((0.7225, 1.0), abs=1e-4)


def test_one_level_has_no_course_over_levels() -> None:
    assert across_levels(summary_of({("11K", "walk"): result(1.0)}, levels=("11K",))) == []


def test_names_cannot_break_a_table() -> None:
    page = as_markdown(
        "title", [Table("b", "a < b", ["", "m"], [["x|y", "1"]]), Remark("", ["i"]), Plot("p", "P", "c", Figure())]
    )
    assert "| x\\|y | 1 |" in page
    assert "![P](plots/p.png)" in page
