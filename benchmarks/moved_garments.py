"""Garments of others that are moved, turned and scaled: does the doctor put them back?

    python benchmarks/moved_garments.py GARMENT.obj .. --body woman --out fits.jsonl

Each file is Z up and faces -Y, in metres, as it is worn. It is moved by 3, 7 and 12 cm both ways along each axis, given
every way of axes and every unit with a shift drawn by seed, and mended as `check --fix` mends it. A line is added for
each case: put back within 2 cm and the right way round, refused, or wrong in silence; cases that the file holds
already are left out.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from pb4u.body.library import load_body
from pb4u.errors import InputError
from pb4u.garment.fit import AXES, UNITS
from pb4u.garment.garment_file import read_source
from pb4u.garment.repair import repair

MADE = "Z up, facing -Y"
NEAR = 0.02
"""Mean displacement [m] from where it is worn up to which a garment is put back: mending also moves it off the skin."""


def cases(worn: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """Names and vertices (vertices, 3) of what is handed in."""
    draw = np.random.default_rng(20)
    for axis, name in enumerate("xyz"):
        for shift in (-0.12, -0.07, -0.03, 0.03, 0.07, 0.12):
            yield f"{name} {100 * shift:+.0f} cm", worn + shift * np.eye(3)[axis]
    for axes in AXES:
        yield axes, (worn + draw.uniform(-0.08, 0.08, 3)) @ AXES[axes]
    for unit in UNITS:
        yield unit, (worn + draw.uniform(-0.06, 0.06, 3)) @ AXES[MADE] / UNITS[unit]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("garments", nargs="+", type=Path)
    parser.add_argument("--body", default="woman")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    body = load_body(options.body)
    done = {}
    if options.out.is_file():
        done = {(row["file"], row["case"]): row for row in map(json.loads, options.out.read_text().splitlines())}
    for path in options.garments:
        source = read_source(path)
        worn = source.vertices @ AXES[MADE].T + np.array([0.0, body.lift, 0.0])
        for name, vertices in cases(worn):
            if (path.name, name) in done:
                continue
            try:
                mended, said = repair(replace(source, vertices=vertices), body)
                off = np.linalg.norm(mended.vertices - worn, axis=1)
                told = any(sentence.startswith("Left where it is") for sentence in said)
                verdict = "put back" if off.mean() <= NEAR else "left and told" if told else "wrong in silence"
                row = {"verdict": verdict, "mean_off": float(off.mean()), "most_off": float(off.max()), "said": said}
            except InputError as error:
                row = {"verdict": "refused", "said": [str(error)]}
            done[path.name, name] = {"file": path.name, "case": name, **row}
            with options.out.open("a") as file:
                file.write(json.dumps(done[path.name, name]) + "\n")
        print(
            path.name, dict(Counter(row["verdict"] for (file, _), row in done.items() if file == path.name)), flush=True
        )


if __name__ == "__main__":
    main()
