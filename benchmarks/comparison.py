"""Compares a checkout with this one on the comparison scenes: milliseconds a step, interleaved, with their ratio.

`python benchmarks/comparison.py --against FOLDER` runs every scene of `comparison_scenes` in turn in the checkout
FOLDER (such as a worktree of an earlier commit) and in this one, `--times` each, and prints the median of each and the
ratio of this one to the other with a 95 % interval of resampled medians. Let nothing else run meanwhile.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parents[1]
SCENES = Path(__file__).resolve().parent / "comparison_scenes"
LATER = ("rest_shape", "friction_law", "time_integration", "air")
"""Entries of the scenes that say what earlier versions did without asking."""


def milliseconds(checkout: Path, scene: Path, flags: list[str]) -> tuple[float, float]:
    """Wall-clock time of a step, and processor time of the whole run over its steps, of one run on one thread [ms].

    Args:
        checkout: whose program runs.
        scene: scene file.
        flags: further flags of `pb4u simulate`.
    """
    with tempfile.TemporaryDirectory() as folder:
        text = scene.read_text()
        if not (checkout / "src/pb4u/environment.py").exists():
            text = re.sub(rf"^({'|'.join(LATER)}) = .*\n", "", text, flags=re.MULTILINE)
        copy = Path(folder) / scene.name
        copy.write_text(text)
        before = os.times()
        program = [sys.executable, "-c", "from pb4u.cli.main import main; main()", "simulate", str(copy)]
        done = subprocess.run(
            [*program, *flags, "--out", f"{folder}/out.npz", "--json", "-"],
            env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(checkout / "src")},
            check=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        after = os.times()
        report = json.loads(done.stdout)
    spent = after.children_user + after.children_system - before.children_user - before.children_system
    return report["ms_per_step"], 1e3 * spent / report["frames"]


def ratio(ours: list[float], others: list[float]) -> tuple[float, float, float]:
    """Ratio of the medians of `ours` and `others`, and the bounds of its 95 % interval.

    Args:
        ours: times of one side [ms].
        others: times of the other [ms].
    """
    rng = np.random.default_rng(0)
    draws = [np.median(rng.choice(ours, len(ours))) / np.median(rng.choice(others, len(others))) for _ in range(2000)]
    low, high = np.percentile(draws, [2.5, 97.5])
    return float(np.median(ours) / np.median(others)), float(low), float(high)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--against", type=Path, required=True, help="checkout to compare with")
    parser.add_argument("--scenes", nargs="*", default=sorted(path.stem for path in SCENES.glob("*.toml")))
    parser.add_argument("--times", type=int, default=10)
    parser.add_argument("--flags", default="", help="further flags of `pb4u simulate`, such as '--triangles 11000'")
    given = parser.parse_args()
    print("scene | theirs [ms] | ours [ms] | ratio (95 %) | processor time: ratio (95 %)")
    for name in given.scenes:
        times: dict[Path, list[tuple[float, float]]] = {given.against.resolve(): [], HERE: []}
        for _ in range(given.times):
            for checkout, found in times.items():
                found.append(milliseconds(checkout, SCENES / f"{name}.toml", given.flags.split()))
        theirs, ours = (list(zip(*found, strict=True)) for found in times.values())
        of_steps, of_processor = (
            "{:.3f} ({:.3f} to {:.3f})".format(*ratio(mine, other)) for mine, other in zip(ours, theirs, strict=True)
        )
        print(
            f"{name} | {np.median(theirs[0]):.1f} | {np.median(ours[0]):.1f} | {of_steps} | {of_processor}", flush=True
        )


if __name__ == "__main__":
    main()
