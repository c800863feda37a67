"""`pb4u evaluate`: the paper's tables and figures, as a run that can stop at any time."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from pb4u.cli.console import RayFlag, WorkersFlag, check_json_target, keep_inputs, pool_of, say, tell, verb
from pb4u.cli.record_flags import given_values, record_flags
from pb4u.cli.verbs import HelpAllFlag
from pb4u.errors import InputError, Pb4uError
from pb4u.export.registry import is_same_file
from pb4u.paper.evaluation_request import EvaluationRequest
from pb4u.progress import announced


@verb(request=record_flags(EvaluationRequest))
def evaluate(
    *,
    request: Mapping[str, Any],
    workers: WorkersFlag = 1,
    ray: RayFlag = None,
    retry: Annotated[bool, typer.Option("--retry")] = False,
    out: Annotated[Path | None, typer.Option(metavar="DIR")] = None,
    plots: Annotated[Path | None, typer.Option(metavar="DIR")] = None,
    json: Annotated[str | None, typer.Option(metavar="FILE|-")] = None,
    help_all: HelpAllFlag = False,
) -> None:
    """Run a protocol of the paper: tables and plots, beside the paper's own figures.

    A killed command continues where it stopped when it is given again. The same --out with other flags narrows or
    extends the run. The resolution protocol without flags is 512 rollouts, most of a day on two cores.\f

    Args:
        request: the fields of `EvaluationRequest`.
        workers: number of processes.
        ray: address of a Ray cluster.
        retry: Try rollouts again that failed before.
        out: Folder of the run. Default: evaluate_PROTOCOL.
        plots: Also put the plots into this folder.
        json: Also write results.json there; '-' is standard output.
        help_all: shows all options.

    Raises:
        InputError: a number is out of range, or something is unknown or unusable.
    """
    from pb4u.paper.evaluation import evaluate as run
    from pb4u.paper.report import PLOTS, TABLES

    check_json_target(json)
    spec = EvaluationRequest(**given_values(EvaluationRequest, request))
    read = [name for names in (spec.models, spec.garments, spec.motions, spec.bodies) for name in names or ()]
    keep_inputs(read, [("--json", json)])
    if plots is not None and plots.exists() and not plots.is_dir():
        raise InputError(f"--plots writes a folder; {plots} is a file.")
    pool = pool_of(workers, ray)

    folder = out or Path(f"evaluate_{spec.protocol}")
    progress = partial(announced, part="rollout", say=say, alike=False)
    results = run(spec, folder, pool, retry, say=say, progress=progress)
    tell(results, json, f"Report: {folder / TABLES}")
    if plots is not None and not is_same_file(plots, folder / PLOTS):
        plots.mkdir(parents=True, exist_ok=True)
        for picture in (folder / PLOTS).iterdir():
            shutil.copy2(picture, plots / picture.name)
    if failures := results["failures"]:
        raise Pb4uError(
            f"{len(failures)} of {len(failures) + _done(results)} rollouts failed; the first: {failures[0]['job']}: "
            f"{failures[0]['sentence']} The report lists them; --retry tries them again."
        )


def _done(results: dict) -> int:
    return sum(row["result"] is not None for row in results["rollouts"])
