"""`pb4u batch`: many clips into one dataset, as a run that can stop at any time."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Literal

import typer

from pb4u.cli.console import (
    JsonFlag,
    RayFlag,
    WorkersFlag,
    check_json_target,
    keep_inputs,
    pool_of,
    say,
    tell,
    verb,
    write_json,
)
from pb4u.cli.verbs import HelpAllFlag
from pb4u.errors import Pb4uError
from pb4u.progress import progress_bar

_FAILURES_TOLD = 10
"""Failures that are printed one by one; the index has all."""
_NOTES_TOLD = 5
"""Notes of the clips that are printed, the most frequent first; the index has all."""


@verb()
def batch(
    jobs: Annotated[Path, typer.Argument(metavar="JOBS.toml")],
    out: Annotated[Path, typer.Option(metavar="FOLDER")],
    workers: WorkersFlag = 1,
    ray: RayFlag = None,
    format: Literal["folder", "webdataset"] = "folder",
    clips_per_shard: Annotated[int, typer.Option(metavar="N")] = 500,
    half: Annotated[bool, typer.Option("--half")] = False,
    most_clips: Annotated[int | None, typer.Option(metavar="N")] = None,
    plan: Annotated[bool, typer.Option("--plan")] = False,
    retry: Annotated[bool, typer.Option("--retry")] = False,
    json: JsonFlag = None,
    help_all: HelpAllFlag = False,
) -> None:
    """Make a dataset: many clips with an index of every label and metric.

    A killed command continues where it stopped when it is given again. A longer jobs file with
    the same --out adds to it.\f

    Args:
        jobs: What to make: [fixed] entries of scene files, lists in [product] of which every combination is a clip, and
            [[clips]] one by one.
        out: Folder of the dataset.
        workers: number of processes.
        ray: address of a Ray cluster.
        format: A folder of trajectories, or tar files of many as WebDataset reads them.
        clips_per_shard: Clips in one tar file.
        half: Store trajectories in half precision: half the size, exact to 0.25 mm.
        most_clips: Clips that one file may describe. Default: 100,000.
        plan: Only say how much disk space it takes.
        retry: Try clips again that failed before.
        json: file for the result.
        help_all: shows all options.

    Raises:
        InputError: a number is out of range, or something is unknown or unusable.
    """
    from pb4u.dataset.dataset_run import make_dataset, size_text
    from pb4u.dataset.jobs_file import MOST_CLIPS, read_jobs

    check_json_target(json)
    keep_inputs([jobs], [("--json", json), ("--out", out)])
    pool = pool_of(workers, ray)
    runs = read_jobs(jobs, MOST_CLIPS if most_clips is None else most_clips)

    result = make_dataset(
        runs, out, pool, clips_per_shard if format == "webdataset" else None, half=half, jobs_file=jobs.name,
        retry=retry, plan_only=plan, say=say, progress=progress_bar,
    )  # fmt: skip
    if plan:
        write_json(result, json)
        return
    tell(result, json, f"{result['done']} of {result['clips']} clips, {size_text(result['bytes'])}: {result['index']}")
    for count, what in (
        (result["diverged"], "diverged (the index has them in its column `diverged`)"),
        (result["limbs_through_cloth"], "have limbs that went through the cloth (column `limbs_through_cloth_max`)"),
    ):
        if count:
            say(f"warning: {count} of {result['done']} clips {what}.")
    for note in result["notes"][:_NOTES_TOLD]:
        say(f"in {note['clips']} clips: {note['sentence']}")
    failures = result["failures"]
    for failure in failures[:_FAILURES_TOLD]:
        print(f"pb4u: failed: {failure['job']}: {failure['sentence']}", file=sys.stderr)
    if failures:
        raise Pb4uError(
            f"{len(failures)} of {result['clips']} clips failed; the index lists them, and --retry tries them again."
        )
