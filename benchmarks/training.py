"""Where the time of a training step goes, in the trainer itself: every part is timed without the parts inside it.

    python benchmarks/training.py --pack pack.npz [--preset small] [--seconds 30] [--set KEY=VALUE ..] [--json FILE]

The pack is what `pb4u assets pack` writes. On an accelerator every part waits for it to finish.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

import pb4u.training.trainer as trainer_module
from pb4u.collision.nearest_surface import PosedSurface
from pb4u.network.acceleration_model import AccelerationModel
from pb4u.network.graph import world_edges
from pb4u.network.graph.builder import GraphBuilder
from pb4u.training.budget import Budget
from pb4u.training.configuration import TRAININGS, with_settings
from pb4u.training.distribution import workers
from pb4u.training.journal import Reporter
from pb4u.training.learner import MovingAverage
from pb4u.training.packed_data import load_training_data
from pb4u.training.trainer import Trainer
from pb4u.training.windows import Window, WindowLoader

PARTS: tuple[tuple[str, Any, str], ...] = (
    ("data", WindowLoader, "load"),
    ("data", Window, "start"),
    ("neighbours", world_edges, "nearest_within"),
    ("neighbours", PosedSurface, "nearest"),
    ("graph", AccelerationModel, "prepare"),
    ("graph", GraphBuilder, "build"),
    ("forward", AccelerationModel, "forward"),
    ("energies", trainer_module, "step_energies"),
    ("backward", torch.autograd, "backward"),
    ("optimiser", torch.nn.utils, "clip_grad_norm_"),
    ("optimiser", torch.optim.Adam, "step"),
    ("optimiser", MovingAverage, "update"),
)


class Stopwatch:
    """Times named parts, each without the parts called inside it."""

    def __init__(self, synchronise: Callable[[], None], clock: Callable[[], float] = time.perf_counter) -> None:
        self._clock = clock
        self.seconds: dict[str, float] = defaultdict(float)
        self._inside: list[float] = []
        self._synchronise = synchronise

    def watch(self, name: str, owner: Any, attribute: str) -> None:
        """Replace a function by itself, timed."""
        original = getattr(owner, attribute)

        def timed(*args: Any, **kwargs: Any) -> Any:
            self._synchronise()
            began = self._clock()
            self._inside.append(0.0)
            try:
                return original(*args, **kwargs)
            finally:
                self._synchronise()
                took = self._clock() - began
                self.seconds[name] += took - self._inside.pop()
                if self._inside:
                    self._inside[-1] += took

        setattr(owner, attribute, timed)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--pack", type=Path, required=True)
    parser.add_argument("--preset", default="small")
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--device", default="auto")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    configuration = with_settings(
        TRAININGS.named(given.preset).configuration,
        ["curriculum.window_steps=((0.0,5),)", "statistics_windows=5", *given.set],
    )
    with workers(given.device) as mine:
        budget = Budget(minutes=1e6)
        data = load_training_data(given.pack)
        ended = [float("inf")]
        trainer = Trainer(configuration, budget, data, mine, None, Reporter(), lambda: time.monotonic() > ended[0])
        ended[0] = time.monotonic() + 5.0
        trainer.run()
        synchronise = torch.cuda.synchronize if mine.device.type == "cuda" else lambda: None
        watch = Stopwatch(synchronise)
        for part in PARTS:
            watch.watch(*part)
        before, began = trainer.counters.step, time.perf_counter()
        ended[0] = time.monotonic() + given.seconds
        trainer.run()
        wall, steps = time.perf_counter() - began, trainer.counters.step - before
    ms = {name: 1e3 * seconds / steps for name, seconds in watch.seconds.items()}
    ms["rest"] = 1e3 * wall / steps - sum(ms.values())
    ms["step"] = 1e3 * wall / steps
    for name, value in ms.items():
        print(f"{name:12s} {value:8.1f} ms  {100 * value / ms['step']:5.1f} %")
    share = (ms["forward"] + ms["backward"]) / ms["step"]
    print(f"network forward + backward: {100 * share:.0f} % of a step, over {steps} steps")
    if given.json:
        given.json.write_text(json.dumps({"ms": ms, "steps": steps, "network_share": share}, indent=2))


if __name__ == "__main__":
    main()
