"""Shows that a change left results equal to the bit: records them, and compares two records.

`record FOLDER` runs scenes, trainings and a protocol through the command line and writes `FOLDER/results.json`: a
digest of every array, and every number that does not depend on the clock. `compare BEFORE AFTER` names each difference;
what only AFTER has is new, not different. Record both on one machine with the same number of threads.
"""

from __future__ import annotations

import argparse
import hashlib
import itertools
import json
import os
import shlex
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import load_file

SCENES = (("tshirt", "walk"), ("dress", "jump"), ("tshirt", "dance"))
CONTACT_SCENES = (("longsleeve", "arms"), ("dress", "dance"))
"""Scenes in which cloth meets cloth: sleeves at a raised arm, and a swinging hem."""
CONTACT_MODELS = {"quick-contact": "--model quick-solver", "default-contact": ""}
MODELS = {
    "solver": "--model solver --self-contact off",
    "network": "--model pb4u-small --refine 0 --contact off --self-contact off",
    "refined": "--model pb4u-small --self-contact off",
    "skinning": "--model skinning",
}
TRAININGS = {
    "comparison": "--preset comparison --set data.clips=4 --set data.shapes=1 --set data.triangles=[700]",
    "small": "--preset small --set data.clips=4 --set data.shapes=2 --set data.triangles=[500,900] "
    """--set 'data.garments=["tshirt","skirt"]' --set validate_every=80 --set validation_frames=10""",
}
PROTOCOL = (
    "--models skinning,solver,pb4u-small,comparison-hood,comparison-contourcraft,comparison-eslr,comparison-mgn "
    "--levels 700,1200 --garments tshirt --motions walk,dance --frames 5 --floors stored"
)
_PROGRAM = "from pb4u.cli.main import main; main()"
TIMES = ("second", "hours", "ms", "latency", "time", "version", "memory", "device", "date", "path", "machine", "at")


def record(folder: Path, triangles: int, frames: int, steps: int) -> None:
    """Run everything that is not in `folder` yet, and write the digests."""
    size = f"--triangles {triangles} --frames {frames}"
    results = record_scenes(folder, size) | record_scenes(folder, size, CONTACT_SCENES, CONTACT_MODELS)
    for name, flags in TRAININGS.items():
        run = folder / f"train_{name}"
        _once(run / "final.safetensors", f"train {flags} --steps {steps} --out {run}")
        weights = load_file(run / "final.safetensors")
        results[f"train_{name}"] = {key: _digest(value) for key, value in weights.items()}
    out = folder / "protocol"
    _once(out / "results.json", f"evaluate {PROTOCOL} --out {out}")
    results["protocol"] = dict(_numbers(json.loads((out / "results.json").read_text())))
    (folder / "results.json").write_text(json.dumps(results, indent=1))


def record_scenes(
    folder: Path,
    size: str,
    scenes: Sequence[tuple[str, str]] = SCENES,
    models: Mapping[str, str] = MODELS,
) -> dict[str, Any]:
    """Digests and numbers of each scene with each model, run where it is not in `folder` yet.

    Args:
        folder: of the trajectories; made where it is absent.
        size: flags that say how large the scenes are.
        scenes: garments and motions.
        models: name -> flags.
    """
    folder.mkdir(parents=True, exist_ok=True)
    results: dict[str, Any] = {}
    for (garment, motion), (model, flags) in itertools.product(scenes, models.items()):
        name = f"{garment}_{motion}_{model}"
        file = folder / f"{name}.npz"
        command = f"simulate --garment {garment} --motion {motion} {size} {flags}"
        _once(file, f"{command} --out {file} --json {folder / name}.json")
        with np.load(file) as arrays:
            results[name] = {key: _digest(arrays[key]) for key in arrays.files if key != "metadata"}
        results[name] |= dict(_numbers(json.loads((folder / f"{name}.json").read_text())))
    return results


def differences(before: dict[str, Any], after: dict[str, Any]) -> list[str]:
    """What of `before` is missing or other in `after`."""
    found = []
    for name, values in before.items():
        other = after.get(name, {})
        found += [f"{name}: {key}" for key, value in values.items() if other.get(key) != value]
    return found


def _once(result: Path, command: str) -> None:
    if result.exists():
        return
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    subprocess.run([sys.executable, "-c", _PROGRAM, *shlex.split(command)], check=True, env=environment)


def _digest(array: np.ndarray) -> str:
    content = np.ascontiguousarray(array)
    return f"{content.dtype} {content.shape} {hashlib.blake2b(content.tobytes(), digest_size=12).hexdigest()}"


def _numbers(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Every leaf of JSON data by its path, but for those that depend on the clock or the machine."""
    if isinstance(value, dict):
        for key, inner in value.items():
            if not any(word in str(key).lower().replace("_", " ").split() or word in str(key) for word in TIMES[:-1]):
                yield from _numbers(inner, f"{path}/{key}")
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from _numbers(inner, f"{path}/{index}")
    else:
        yield path, value


def main() -> None:
    """Record or compare, as the command line says."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = parser.add_subparsers(required=True, dest="verb")
    recording = verbs.add_parser("record")
    recording.add_argument("folder", type=Path)
    recording.add_argument("--triangles", type=int, default=2500)
    recording.add_argument("--frames", type=int, default=12)
    recording.add_argument("--steps", type=int, default=200)
    comparing = verbs.add_parser("compare")
    comparing.add_argument("before", type=Path)
    comparing.add_argument("after", type=Path)
    given = parser.parse_args()
    if given.verb == "record":
        record(given.folder, given.triangles, given.frames, given.steps)
        return
    before, after = (json.loads((folder / "results.json").read_text()) for folder in (given.before, given.after))
    found = differences(before, after)
    print("\n".join(found) or f"{sum(map(len, before.values()))} results of {len(before)} runs are equal to the bit")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
