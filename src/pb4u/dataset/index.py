"""The index of a dataset: a Parquet file with a row a clip, which every table reader takes column by column."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args, get_origin

from pb4u.dataset.dataset_folder import INDEX, DatasetFolder
from pb4u.errors import extra
from pb4u.garment.material import ISOTROPIC
from pb4u.measures.metrics import ENERGIES, OF_A_CLIP, STRAINS
from pb4u.measures.run_job import RunJob, entry_of
from pb4u.options import described
from pb4u.run import Run, WornGarment

if TYPE_CHECKING:
    import pyarrow

_MEASURED = ("mean", "max", "per_frame")


def require_parquet() -> None:
    """Refuse to begin where the index could not be written.

    Raises:
        MissingExtraError: pyarrow is not installed.
    """
    with extra("dataset", "The index of a dataset"):
        import pyarrow.parquet  # noqa: F401


def write_index(folder: DatasetFolder, jobs: Sequence[RunJob]) -> None:
    """Write the index, beside and moved into place.

    Clips of earlier jobs files keep their rows, after those of `jobs`, while their files exist.

    Args:
        folder: the dataset.
        jobs: clips of this jobs file, in the order of the rows.

    Raises:
        Pb4uError: the disk refuses.
    """
    import pyarrow
    import pyarrow.parquet

    titles = _titles(jobs)
    rows = [_row(folder, job, job.labelled(titles)) for job in jobs]
    rows += _earlier_rows(folder, {job.key for job in jobs})
    table = pyarrow.Table.from_pylist(rows, schema=_schema())
    content = io.BytesIO()
    pyarrow.parquet.write_table(table, content, compression="zstd")
    folder.write(INDEX, content.getvalue())


def _earlier_rows(folder: DatasetFolder, keys: Collection[str]) -> list[dict[str, Any]]:
    """Rows of the index of clips that are there and have none of these keys."""
    import pyarrow.parquet

    if not (folder.path / INDEX).is_file():
        return []
    rows = pyarrow.parquet.read_table(folder.path / INDEX).to_pylist()
    places = [(row, folder.place(row["key"])) for row in rows if row["key"] not in keys]
    return [{**row, "file": place.file, "member": place.member} for row, place in places if place is not None]


def _titles(jobs: Sequence[RunJob]) -> dict[str, str]:
    """What values are called whose files share a stem: by the shortest end of the path that tells the file apart."""
    files = {value: Path(file).absolute() for job in jobs for value, file, _ in reversed(job.contents)}
    entries = {value: entry_of(value, file) for job in jobs for value, file, _ in reversed(job.contents)}
    different = set(files.values())
    stems = Counter(path.stem for path in different)
    ends = Counter(end for path in different for end in _ends(path))
    return {
        value: next(end for end in _ends(path) if ends[end] == 1) + entries[value]
        for value, path in files.items()
        if stems[path.stem] > 1
    }


def _ends(path: Path) -> list[str]:
    """Ends of a path, the shortest first."""
    return ["/".join(path.parts[-count:]) for count in range(1, len(path.parts) + 1)]


def _row(folder: DatasetFolder, job: RunJob, labels: Mapping[str, Any]) -> dict[str, Any]:
    result, failure, place = folder.result(job), folder.failure(job), folder.place(job.key)
    row: dict[str, Any] = {"key": job.key, "status": "done" if result else "failed" if failure else "missing"}
    if result is None or place is None:
        return {**row, **labels, "failure": failure.sentence if failure else None}
    row |= {"file": place.file, "member": place.member, **result, **labels}
    row |= _measured(result["metrics"]) | _measured(result["metrics_paper"], "paper_")
    return {**row, "garments": [garment | _measured(garment["metrics"]) for garment in result["garments"]]}


def _measured(tables: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Values of the columns of measured quantities."""
    return {f"{prefix}{name}_{part}": table[part] for name, table in tables.items() for part in _MEASURED}


def _schema() -> pyarrow.Schema:
    """Name and type of every column; counts and numbers are SI, as in the report of `pb4u simulate`."""
    import pyarrow as pa

    text, integer, number, switch = pa.string(), pa.int64(), pa.float64(), pa.bool_()

    def measured(names: Sequence[str], prefix: str = "") -> dict[str, pa.DataType]:
        kinds = {"mean": number, "max": number, "per_frame": pa.list_(number)}
        return {f"{prefix}{name}_{part}": kinds[part] for name in names for part in _MEASURED}

    garment = {
        "name": text,
        "vertices": integer,
        "triangles": integer,
        **dict.fromkeys(ISOTROPIC, number),
        "diverged": switch,
        "diverged_at": integer,
        **measured((*ENERGIES, *STRAINS)),
    }
    entries = {entry.label: entry for entry in described(WornGarment).values()}
    columns = {
        **dict.fromkeys(("key", "status", "failure", "file", "member"), text),
        **{label: text if entry.kind == "name" else pa.list_(_column(entry.type)) for label, entry in entries.items()},
        **{entry.label: _column(entry.type) for entry in described(Run).values() if entry.label},
        **dict.fromkeys(("propagation_steps", "frames", "triangles", "vertices", "solver_iterations"), integer),
        **dict.fromkeys(("unsolved_steps", "retried_steps", "failed_at", "diverged_at", "bytes"), integer),
        **dict.fromkeys(("half", "diverged"), switch),
        **dict.fromkeys(("mean_edge_length", "ms_per_step", "seconds"), number),
        "notes": pa.list_(text),
        **measured(OF_A_CLIP),
        **measured(ENERGIES, "paper_"),
        "garments": pa.list_(pa.struct(list(garment.items()))),
    }
    return pa.schema(list(columns.items()))


def _column(kind: Any) -> pyarrow.DataType:
    """Type of the column that holds an entry of a run, by the type of its value."""
    import pyarrow as pa

    if get_origin(kind) is Mapping:
        return pa.map_(*map(_column, get_args(kind)))
    if get_origin(kind) in (tuple, Sequence):
        return pa.list_(_column(get_args(kind)[0]))
    return {bool: pa.bool_(), int: pa.int64(), float: pa.float64()}.get(kind, pa.string())
