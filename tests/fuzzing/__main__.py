"""Reads damaged files of every kind, for as long as is asked: `python -m tests.fuzzing --minutes 60 --out FOLDER`.

What goes wrong (a traceback, a hang, a crash, memory over the bound, numbers that are none) is told with its seed and
kept in the folder; `--seed S` reads one case again, in this process, and lets its error through.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.fuzzing.confined import Confinement
from tests.fuzzing.samples import case


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0, help="how long")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--only", default="", help="part of the names of the kinds of files to read")
    parser.add_argument("--out", type=Path, help="folder that takes the files that something goes wrong with")
    parser.add_argument("--seed", help="read the case of this seed alone")
    asked = parser.parse_args()
    if asked.seed is not None:
        _read_again(asked.seed, asked.only, asked.out)
        return
    number = asked.first
    endings: Counter[str] = Counter()
    found: Counter[str] = Counter()
    process = Confinement(asked.only)
    end = time.monotonic() + 60.0 * asked.minutes
    while time.monotonic() < end:
        seed = str(number)
        ended = process.ending(seed)
        endings[ended.kind] += 1
        if not ended.is_sound:
            found[ended.place] += 1
            if found[ended.place] == 1:
                print(
                    f"--only '{asked.only}' --seed {seed}: {case(seed, asked.only).name}: {ended.kind}: {ended.told}",
                    flush=True,
                )
                if asked.out is not None:
                    case(seed, asked.only).sample.written(asked.out / seed)
        number += 1
        if not number % 500:
            print(f"{number - asked.first} cases, {dict(endings)}, {len(found)} findings", flush=True)
            process.restart()
    process.close()
    print(f"{number - asked.first} cases: {dict(endings)}")
    for place, count in found.most_common():
        print(f"{count:6d} {place}")


def _read_again(seed: str, only: str, out: Path | None) -> None:
    chosen = case(seed, only)
    with TemporaryDirectory() as folder:
        path = chosen.sample.written(out or Path(folder))
        print(f"{chosen.name}: {path}")
        chosen.read(path)
        print("it was read")


if __name__ == "__main__":
    main()
