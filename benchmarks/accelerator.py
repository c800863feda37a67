"""A network alone on an accelerator: measured where there is one, counted and estimated where there is none.

`python benchmarks/accelerator.py measure` takes five minutes on a card and writes accelerator.md: milliseconds a step
beside the paper's, memory, and how far the card's steps are from the processor's. `... count` runs a step on a card
that is not there, torch's fake tensors on "cuda:0", and writes what it launches, moves and computes, with the time that
this means: estimates. Reading a value back, a shape that waits for data, tensors of two devices in one operation are
errors of such a step; copies from the processor, each of which makes a card wait, are counted.
"""

from __future__ import annotations

import argparse
import copy
import ctypes
import dataclasses
import time
import traceback
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from itertools import islice
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils.flop_counter import flop_registry

from pb4u.collision.capacities import Capacities
from pb4u.network.acceleration_model import AccelerationModel
from pb4u.network.registry import NETWORKS
from pb4u.physics.incremental_potential import IncrementalPotential
from pb4u.scene.assembly import make_scene
from pb4u.scene.scene import Scene
from pb4u.simulation.checkpoint import built_in_models, from_pretrained
from pb4u.simulation.device_steps import states_after
from pb4u.simulation.network_pass import NetworkPass, StepFeatures
from pb4u.simulation.pass_search import search_of
from pb4u.simulation.step import StepMethod, Taken, predictions
from pb4u.simulation.step_start import start_of
from pb4u.simulation.timeline import Timeline

PAPER = {12_000: 50.0, 25_000: 105.0, 48_000: 196.0}
"""Milliseconds a step of Pb4U-GNet in the paper, by triangles."""

CARDS = {
    "H100 SXM": (3.35e12, 67e12, 34e12),
    "A100 80 GB": (2.04e12, 19.5e12, 9.7e12),
    "RTX 4090": (1.01e12, 83e12, 1.3e12),
}
"""Bytes a second, and operations a second in single and double precision, from data sheets, tensor cores unused."""

LAUNCH = 4e-6
"""Seconds that a processor takes to launch a kernel from torch."""


CARD = torch.device("cuda:0")
_CUDA, _META = 1, 14
_NO_KERNEL = {
    "view", "_unsafe_view", "expand", "select", "slice", "unsqueeze", "squeeze", "t", "transpose", "permute", "detach",
    "alias", "as_strided", "unbind", "split", "split_with_sizes", "diagonal", "unfold", "empty", "empty_strided",
    "new_empty", "empty_like", "lift_fresh", "_reshape_alias", "reshape", "unsafe_split", "narrow", "chunk",
    "new_empty_strided", "set_", "device", "is_same_size", "_local_scalar_dense",
}  # fmt: skip
_COPIES = {"copy", "_to_copy", "_copy_from"}
_SEVERAL = {"sort": 8, "argsort": 8, "topk": 4, "cumsum": 2, "nonzero_static": 4, "_embedding_bag": 2, "index_put": 3}
"""Kernels that the library launches for one operation, from its sources and roughly; the others launch one."""


class Counted(TorchDispatchMode):
    """Counts what runs under it.

    Attributes:
        launches: kernels by name of the operation.
        read_and_written: bytes.
        operations: floating point, of products of matrices, and of the rest one for each number written, by data type.
        transfers: copies between the processor and the card, by the line that asked for them.
    """

    def __init__(self) -> None:
        super().__init__()
        self.launches: Counter[str] = Counter()
        self.operations: Counter[str] = Counter()
        self.transfers: Counter[str] = Counter()
        self.read_and_written = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        out = func(*args, **kwargs)
        name = func._schema.name.split("::")[1].removesuffix("_") or func._schema.name
        inputs, outputs = list(_tensors((args, kwargs))), list(_tensors(out))
        places = {t.device.type for t in inputs if t.dim() or t.device.type != "cpu"}
        if len(places) > 1 and name not in _COPIES:
            raise RuntimeError(f"{name} of tensors on {' and '.join(sorted(places))} at {_place()}")
        if len(places) > 1 or (places and {t.device.type for t in outputs} - places):
            self.transfers[_place()] += 1
        elif places - {"cpu"} and name not in _NO_KERNEL and not (name == "to" and out is args[0]):
            outputs = outputs or inputs
            self.launches[name] += _SEVERAL.get(name, 1)
            self.read_and_written += sum(_bytes(t) for t in (*inputs, *outputs))
            kind = str(outputs[0].dtype).removeprefix("torch.")
            formula = flop_registry.get(func._overloadpacket)
            done = formula(*args, **kwargs, out_val=out) if formula else sum(t.numel() for t in outputs)
            if name == "linear":
                done = 2 * outputs[0].numel() * args[0].shape[-1]
            self.operations[kind if outputs[0].is_floating_point() else "integers"] += int(done)
        return out


def _place() -> str:
    """The innermost line of the package that is being executed."""
    frames = [frame for frame in traceback.extract_stack() if "/pb4u/" in frame.filename]
    return f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "outside"


def _tensors(value: Any) -> Iterator[Tensor]:
    if isinstance(value, Tensor):
        yield value
    elif isinstance(value, (tuple, list)):
        for part in value:
            yield from _tensors(part)
    elif isinstance(value, dict):
        yield from _tensors(list(value.values()))


def _bytes(values: Tensor) -> int:
    """Memory that `values` span: an expanded axis is read from cache."""
    spanned = 1
    for size, stride in zip(values.shape, values.stride(), strict=True):
        spanned *= size if stride else 1
    return spanned * values.element_size()


@contextmanager
def fake_card() -> Iterator[None]:
    """Tensors made within are fake; operations on `CARD` need no CUDA."""
    library = ctypes.CDLL(str(next((Path(torch.__file__).parent / "lib").glob("libc10.*"))))
    guards = (ctypes.c_void_p * 24).in_dll(library, "_ZN3c104impl26device_guard_impl_registryE")
    if not torch.cuda.is_available():
        # The guard of meta tensors switches to no device, which is all that fake ones need.
        guards[_CUDA] = guards[_META]
        torch.cuda._lazy_init = lambda: None  # type: ignore[assignment]
    with FakeTensorMode(allow_non_fake_inputs=True):
        yield


def faked(value: Any, card: torch.device = CARD, known: dict[int, Any] | None = None) -> Any:
    """A copy of records, modules and other objects in which every tensor is one without values on `card`."""
    known = {} if known is None else known
    if id(value) in known:
        return known[id(value)]
    made: Any = value
    if isinstance(value, nn.Parameter):
        made = nn.Parameter(_on_card(value, card), requires_grad=value.requires_grad)
    elif isinstance(value, Tensor):
        made = _on_card(value, card)
    elif isinstance(value, torch.device):
        made = card
    elif isinstance(value, (tuple, list)) and not hasattr(value, "_fields"):
        made = type(value)(faked(part, card, known) for part in value)
    elif isinstance(value, dict):
        made = {faked(key, card, known): faked(part, card, known) for key, part in value.items()}
    elif dataclasses.is_dataclass(value) or type(value).__module__.startswith(("pb4u", "torch.nn", "torch.optim")):
        if isinstance(value, type):
            return value
        made = copy.copy(value)
        known[id(value)] = made
        vars(made).update({name: faked(part, card, known) for name, part in vars(value).items()})
    known[id(value)] = made
    # What an address stands for must live as long as it is known.
    known.setdefault(-id(value), value)
    return made


def _on_card(values: Tensor, card: torch.device) -> Tensor:
    return torch.empty_strided(values.shape, values.stride(), dtype=values.dtype, device=card)


def model_of(name: str) -> AccelerationModel:
    """A shipped network, or one of a preset with fresh weights, which cost as much."""
    return from_pretrained(name).model if name in built_in_models() else AccelerationModel(NETWORKS[name].network())


def method_of(model: AccelerationModel, timeline: Timeline) -> StepMethod:
    """The network alone."""
    network = model.network
    prepared = model.prepare(timeline.garments.to(timeline.garments.device, torch.float32))
    c = network.configuration
    potential = IncrementalPotential()
    features = StepFeatures(prepared, potential)
    passes = NetworkPass(model, prepared, features, c.passes, further=c.further_passes)
    return StepMethod(start_of(network, potential), passes, search=search_of(network, potential))


def count(name: str, *scenes: Scene, card: torch.device = CARD) -> tuple[Counted, str]:
    """What a step does, its first pose left out, and how many passes it took.

    Args:
        name: of the network.
        scenes: of at least four frames, each a world of one pack.
        card: fake CUDA device, or "meta", which is quicker and needs no process of its own.
    """
    timeline, model = Timeline.of_worlds(scenes).to(torch.device("cpu"), Capacities()), model_of(name)
    method, capacities = method_of(model, timeline), timeline.colliders.capacities
    assert capacities is not None
    with torch.no_grad():
        *_, after = predictions(timeline.step_from(timeline.skinned_state(1)), method, capacities=capacities)
    capacities.grow(*capacities.taken())
    passes = capacities.sizes.get("passes", method.network.passes)
    step = timeline.step_from(after.state)
    with fake_card() if card.type == "cuda" else nullcontext(), torch.no_grad():
        for _ in range(2):
            # What is made once is made by the first of the two.
            known, taken, last_move = faked((step, method, after.last_move), card)
            with Counted() as counted:
                *_, made = predictions(known, taken, last_move, known.collider.colliders.capacities)
            assert made.state.positions.device.type == card.type
    return counted, f"{passes} passes" if method.network.further else f"{passes} pass"


def estimates(counted: Counted) -> Iterator[float]:
    """Milliseconds on each card: what is longer, to launch the kernels or to run them one after the other."""
    for bandwidth, single, double in CARDS.values():
        runs = counted.read_and_written / bandwidth
        runs += counted.operations["float32"] / single + counted.operations["float64"] / double
        yield 1e3 * max(LAUNCH * sum(counted.launches.values()), runs)


def counted_page(models: list[str], triangles: list[int]) -> Iterator[str]:
    yield "| network | triangles | launches | GB moved | GFLOP single, double | host waits | "
    yield from (f"{card} [ms] | " for card in CARDS)
    yield f"paper [ms] |\n{'|---' * (7 + len(CARDS))}|\n"
    for name in models:
        for number in triangles:
            counted, passes = count(name, make_scene("dress", motion="walk", frames=4, triangles=number))
            done = (counted.operations[kind] / 1e9 for kind in ("float32", "float64"))
            times = " | ".join(f"{ms:.0f}" for ms in estimates(counted))
            yield (
                f"| {name}, {passes} | {number:,} | {sum(counted.launches.values()):,} | "
                f"{counted.read_and_written / 1e9:.1f} | {', '.join(f'{d:.1f}' for d in done)} | "
                f"{sum(counted.transfers.values())} | {times} | {PAPER.get(number, float('nan')):.0f} |\n"
            )


def measured_page(models: list[str], triangles: list[int], steps: int) -> Iterator[str]:
    card = torch.device("cuda")
    yield f"{torch.cuda.get_device_name()}, torch {torch.__version__}\n\n"
    yield "| network | triangles | ms a step | as one graph [ms] | memory [GB] "
    yield f"| from the processor after 3 steps [m] | paper [ms] |\n{'|---' * 7}|\n"
    for name in models:
        for number in triangles:
            scene = make_scene("dress", motion="walk", frames=steps, triangles=number)
            host, model = Timeline.of(scene), model_of(name)
            torch.cuda.reset_peak_memory_stats()
            timeline = host.to(card, Capacities())
            method = method_of(model.to(card), timeline)
            each = []
            for replays in (False, True):
                states = states_after(timeline, method, Taken(timeline.skinned_state(1)), steps, replays)
                near = [next(states) for _ in range(3)]
                # Graphs are captured meanwhile.
                sum(1 for _ in islice(states, steps // 3))
                began = time.perf_counter()
                taken = sum(1 for _ in states)
                each.append(f"{1e3 * (time.perf_counter() - began) / taken:.1f}")
            slow = method_of(model.to("cpu"), host)
            made = Taken(host.skinned_state(1))
            for _ in range(3):
                with torch.no_grad():
                    *_, made = predictions(host.step_from(made.state), slow, made.last_move)
            apart = float((near[-1].positions - made.state.positions).abs().max())
            memory = torch.cuda.max_memory_allocated() / 1e9
            yield f"| {name} | {number:,} | {' | '.join(each)} | {memory:.1f} | {apart:.1e} | {PAPER[number]:.0f} |\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("measure", "count"))
    parser.add_argument("--models", nargs="+", default=["pb4u-wide", "literal_small", "literal"])
    parser.add_argument("--triangles", nargs="+", type=int, default=list(PAPER))
    parser.add_argument("--steps", type=int, default=60)
    parser.add_argument("--out", type=Path, default=Path("accelerator.md"))
    given = parser.parse_args()
    if given.what == "measure" and not torch.cuda.is_available():
        raise SystemExit("There is no CUDA device here; `count` needs none.")
    page = (
        counted_page(given.models, given.triangles)
        if given.what == "count"
        else measured_page(given.models, given.triangles, given.steps)
    )
    with given.out.open("w") as out:
        for part in page:
            print(part, end="", flush=True)
            out.write(part)


if __name__ == "__main__":
    main()
