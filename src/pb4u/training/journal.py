"""Reports of a training: progress, metrics and the plot of them."""

from __future__ import annotations

import math
import statistics
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pb4u.training.objective import LOSS_TERMS
from pb4u.training.run_folder import NotSavedError, RunFolder
from pb4u.training.validation import Score


class Reporter:
    """Prints sentences to standard error, and nothing else: for pipes and files."""

    def progressed(self, step: int, progress: float, seconds: float, means: Mapping[str, float]) -> None:
        """Report the progress of the training.

        Args:
            step: number of optimiser steps so far.
            progress: fraction of the budget spent.
            seconds: wall time spent [s].
            means: mean of each term since the last report [J], with their "total" and "median".
        """

    def validated(self, step: int, score: Score, best: bool) -> None:
        """Report a validation.

        Args:
            step: number of optimiser steps so far.
            score: result of the validation.
            best: whether it is the best so far.
        """
        self.said(
            f"step {step}: {100 * score.survived:.0f} % of frames kept, {1e3 * score.excess_height:.3g} mm of excess "
            f"height{', the best so far' if best else ''}."
        )

    def said(self, sentence: str) -> None:
        """Print a sentence on an incident.

        Args:
            sentence: what happened, as a sentence.
        """
        print(f"pb4u: {sentence}", file=sys.stderr)


class BarReporter(Reporter):
    """Shows a bar with the time left and the terms of the loss on a terminal.

    Args:
        bar: a `rich` progress bar.
        task: its task.
    """

    def __init__(self, bar: Any, task: Any) -> None:
        self.bar, self.task = bar, task
        self.score = ""

    def progressed(self, step: int, progress: float, seconds: float, means: Mapping[str, float]) -> None:
        terms = "  ".join(f"{name} {means[name]:.2e}" for name in LOSS_TERMS if name in means)
        text = f"step {step}  total {means['total']:.2e}, median {means['median']:.2e}  {terms}{self.score}"
        self.bar.update(self.task, completed=min(progress, 1.0), terms=text)

    def validated(self, step: int, score: Score, best: bool) -> None:
        self.score = f"  | validation {100 * score.survived:.0f}% {1e3 * score.excess_height:.3g} mm" + (
            " best" if best else ""
        )

    def said(self, sentence: str) -> None:
        self.bar.console.print(f"pb4u: {sentence}")


class Journal:
    """Log of a training: means of its losses every so many steps, validations and incidents.

    Args:
        reporter: shows every entry.
        folder: for the entries, one a line, or None.
        leads: whether this process writes them.
    """

    def __init__(self, reporter: Reporter, folder: RunFolder | None, leads: bool) -> None:
        self.reporter, self.folder, self.leads = reporter, folder, leads
        self._sums: dict[str, float] = {}
        self._totals: list[float] = []

    def add(self, values: Mapping[str, float], total: float) -> None:
        """Add the losses of one step to the means.

        Args:
            values: each loss [J] by name.
            total: comparable total [J], for the median.
        """
        self._totals.append(total)
        for name, value in {**values, "count": 1.0}.items():
            self._sums[name] = self._sums.get(name, 0.0) + value

    def forget(self) -> None:
        """Delete the losses of steps that are not noted yet."""
        self._sums, self._totals = {}, []

    def note_means(self, step: int, progress: float, seconds: float, window: int) -> None:
        """Note the mean of the steps since the last line.

        Args:
            step: number of optimiser steps so far.
            progress: fraction of the budget spent.
            seconds: wall time spent [s].
            window: length of the windows [steps].
        """
        count = self._sums.pop("count", 0.0)
        if not count:
            return
        means = {name: value / count for name, value in self._sums.items()}
        # Few deep penetrations outweigh everything else in a mean, and the weight of collisions rises over the budget.
        means["median"] = statistics.median(self._totals)
        self.forget()
        self.note({"step": step, "seconds": round(seconds, 2), "window": window, **means})
        self.reporter.progressed(step, progress, seconds, means)

    def note_score(self, step: int, score: Score, best: bool) -> None:
        """Note a validation.

        Args:
            step: number of optimiser steps so far.
            score: result of the validation.
            best: whether it is the best so far.
        """
        finite = {name: value if math.isfinite(value) else None for name, value in asdict(score).items()}
        self.note({"step": step, "validation": finite, "best": best})
        self.reporter.validated(step, score, best)

    def note(self, record: dict[str, Any]) -> None:
        """Add a line to the metrics; on a full disk the line is lost and the training continues.

        Args:
            record: plain JSON data.
        """
        if self.leads and self.folder:
            try:
                self.folder.append_metrics(record)
            except NotSavedError as error:
                self.say(f"{error} The training goes on.")

    def say(self, sentence: str) -> None:
        """Report a sentence on an incident.

        Args:
            sentence: what happened, as a sentence.
        """
        self.reporter.said(sentence)


@contextmanager
def reporter() -> Iterator[Reporter]:
    """Reporter with a bar if standard error is a terminal, otherwise with sentences."""
    if not sys.stderr.isatty():
        yield Reporter()
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    columns = (BarColumn(20), TaskProgressColumn(), TimeRemainingColumn(), TextColumn("{task.fields[terms]}"))
    with Progress(*columns, console=Console(stderr=True)) as bar:
        yield BarReporter(bar, bar.add_task("train", total=1.0, terms="gathering statistics"))


def draw_curve(lines: list[dict[str, Any]], path: Path) -> None:
    """Draw a run's metrics to a PNG, if there are any.

    Args:
        lines: metrics as `RunFolder.metrics` reads them.
        path: path of the picture.
    """
    steps = [line for line in lines if "total" in line]
    if not steps:
        return
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 7.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    x = [line["step"] for line in steps]
    for name in LOSS_TERMS:
        # Gravity energy has no lower bound and may be negative, which a logarithmic axis cannot show.
        if name != "gravity" and any(name in line for line in steps):
            upper.plot(x, [max(line.get(name, math.nan), 1e-9) for line in steps], label=name, linewidth=1)
    upper.set_yscale("log")
    upper.set_ylabel("energy of a step [J]")
    upper.legend(ncols=3, fontsize=8)
    lower.plot(x, [line["total"] for line in steps], label="mean total", color="grey", linewidth=0.7)
    lower.plot(
        x,
        [line["median"] for line in steps],
        label="median, collisions at their first weight",
        color="black",
        linewidth=1,
    )
    lower.set_yscale("symlog")
    # Lines of earlier versions have no excess.
    scores = [(line["step"], line["validation"].get("excess_height")) for line in lines if line.get("validation")]
    scores = [(step, height) for step, height in scores if height is not None]
    right = lower.twinx()
    right.plot([step for step, _ in scores], [1e3 * height for _, height in scores], "o-", color="tab:orange")
    right.set_ylabel("validation, excess height [mm]")
    for line in lines:
        if "rollback" in line:
            lower.axvline(line["step"], color="red", linestyle=":")
    lower.set_xlabel("optimiser step")
    lower.set_ylabel("total [J]")
    lower.legend(fontsize=8)
    figure.savefig(path, dpi=110)
