"""Begins a training or goes on with one."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, fields, replace
from pathlib import Path
from types import FrameType
from typing import Any

from pb4u.errors import InputError, warn
from pb4u.network.acceleration_model import NetworkConfiguration
from pb4u.network.propagation_control import FixedSteps
from pb4u.progress import announced
from pb4u.simulation.checkpoint import built_in_models, from_pretrained, training_record_from_json
from pb4u.training.averaged_weights import FREE_LICENCE
from pb4u.training.budget import Budget
from pb4u.training.configuration import (
    TRAININGS,
    TrainingConfiguration,
    training_from_json,
    training_to_json,
    with_settings,
)
from pb4u.training.distribution import Workers, workers
from pb4u.training.journal import Reporter, draw_curve, reporter
from pb4u.training.objective import PROGRESS
from pb4u.training.packed_data import TrainingData, load_training_data, save_training_data
from pb4u.training.request import TrainingRequest
from pb4u.training.run_folder import CURVE, RunFolder
from pb4u.training.trainer import Trainer

STOPPING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Signals that ask a training to save and end; Windows has no SIGHUP."""
WITHOUT_WEIGHTS = frozenset({"control", "scaling", "passes", "conjugate", "further_passes", "descent_size"})
"""Fields of a network that its weights do not hang on."""
BUILT_IN = "built in"
"""Origin of the data of a run whose configuration alone makes them again."""
UNKNOWN_LICENCE = "unknown: ask whoever trained it"
"""Licence of weights that were trained on data of the user's."""


def train(request: TrainingRequest) -> dict[str, Any]:
    """Train a network as the request says; returns a summary: how it ended, its steps, seconds, rollbacks and best
    validation.

    Args:
        request: preset, budget, folder and settings.

    Raises:
        InputError: something of the request cannot be done.
    """
    if (request.resume is None) == (request.out is None):
        raise InputError("Give --out FOLDER for a new training, or --resume FOLDER to continue one.")
    if request.resume is not None and (
        request.preset or request.set or request.pack or request.recordings or request.weights
    ):
        raise InputError(
            "A resumed training keeps its settings: leave out --preset, --set, --pack, --recordings and --weights."
        )
    begun = None if request.resume is not None else _configured(request)
    with workers(request.device) as mine:
        if begun is None:
            with RunFolder.open(str(request.resume)).held() if mine.leads else contextlib.nullcontext():
                folder, configuration, budget, data = _opened(request)
        else:
            folder, configuration, budget, data = _created(request, *begun, mine)
        with folder.held() if mine.leads else contextlib.nullcontext(), reporter() as log, stop_signals() as stopping:
            trainer = Trainer(configuration, budget, data, mine, folder, log if mine.leads else _Silent(), stopping)
            _restore(trainer, folder)
            if begun is None and (request.steps is not None or request.minutes is not None):
                # A new budget has a schedule of its own, on which the validation may improve again.
                trainer.counters.flat = 0
            ending = trainer.run()
        if mine.leads:
            with contextlib.suppress(OSError):
                draw_curve(folder.metrics(), folder.path / CURVE)
        return _summary(trainer, folder, ending)


def _refuse_other_data(request: TrainingRequest) -> None:
    """Refuse a choice of data beside a pack, which holds its own."""
    if request.recordings is not None:
        raise InputError(
            "A pack already contains its recordings: leave out --recordings, or give it to `pb4u assets pack`."
        )
    if chosen := [setting for setting in request.set if setting.startswith("data.")]:
        warn(f"The pack already contains its data: --set {chosen[0]} has no effect here, only with `pb4u assets pack`.")


def _configured(request: TrainingRequest) -> tuple[TrainingConfiguration, Budget]:
    if request.pack is not None:
        _refuse_other_data(request)
    configuration, usual_steps = TRAININGS.named(request.preset or "small")
    begun = None if request.weights is None else from_pretrained(request.weights).configuration
    if begun is not None:
        configuration = replace(configuration, network=begun)
    configuration = with_settings(configuration, request.set)
    if begun is not None:
        _refuse_another_network(begun, configuration.network)
    if configuration.loss_weight == PROGRESS and not configuration.network.conjugate:
        raise InputError(
            "loss_weight=progress needs the line search of conjugate passes: add --set network.conjugate=True (and "
            "--set network.descent_size=0.03, which it was designed for), or --set loss_weight=joule."
        )
    if configuration.most_propagation_steps and isinstance(getattr(configuration.network, "control", None), FixedSteps):
        raise InputError(
            "The network takes a fixed number of propagation steps, but most_propagation_steps draws a new number at "
            "every training step: add --set most_propagation_steps=0, or use a network with propagation control."
        )
    steps = request.steps
    if steps is None and request.minutes is None:
        steps = usual_steps
    return configuration, Budget(steps, request.minutes)


def _refuse_another_network(begun: NetworkConfiguration, config: NetworkConfiguration) -> None:
    """Refuse settings of a network that the weights of `begun` cannot take."""
    kind = type(begun)
    names = {field.name for field in fields(kind)}
    if type(config) is not kind or any(getattr(begun, n) != getattr(config, n) for n in names - WITHOUT_WEIGHTS):
        free = " and ".join(sorted(names & WITHOUT_WEIGHTS))
        raise InputError(f"--weights bring their own network: --set can change only its {free}.")


def _created(
    request: TrainingRequest, configuration: TrainingConfiguration, budget: Budget, mine: Workers
) -> tuple[RunFolder, TrainingConfiguration, Budget, TrainingData]:
    """A new run. Other processes wait for the leading one's data."""
    mine.share(configuration.batch)
    assert request.out is not None
    record = {
        "preset": request.preset or "small",
        "budget": asdict(budget),
        "training": training_to_json(configuration),
        "data": BUILT_IN if request.pack is None and request.recordings is None else "given",
        "origin": _origin(request.weights),
    }
    data = None
    if mine.leads:
        RunFolder.require_free(request.out)
        data = _data(request, configuration)
        folder = RunFolder.create(request.out, record)
        try:
            save_training_data(data, folder.data)
        except InputError:
            folder.remove()
            raise
    mine.agreed(False)
    folder = RunFolder(request.out)
    return folder, configuration, budget, load_training_data(folder.data) if data is None else data


def _origin(name: str | None) -> dict[str, Any] | None:
    """Weights that a training begins with: built-in name or absolute path, licence and record."""
    if name is None:
        return None
    where = name if name in built_in_models() else str(Path(name).resolve())
    begun = from_pretrained(name)
    return {"weights": where, "licence": begun.licence, "record": asdict(begun.record)}


def _data(request: TrainingRequest, configuration: TrainingConfiguration) -> TrainingData:
    if request.pack is not None:
        return load_training_data(request.pack)
    return _collected(configuration, request.recordings)


def _collected(configuration: TrainingConfiguration, recordings: Path | None) -> TrainingData:
    from pb4u.training.collection import collect

    with announced("making garments and clips", "garment", Reporter().said, alike=False) as progress:
        return collect(configuration.data, recordings, configuration.seed, progress)


def _opened(request: TrainingRequest) -> tuple[RunFolder, TrainingConfiguration, Budget, TrainingData]:
    """A run to go on with; its budget may be a new one."""
    assert request.resume is not None
    folder = RunFolder.open(request.resume)
    record = folder.configuration()
    try:
        configuration = training_from_json(record["training"])
        budget = Budget(**record["budget"])
    except (KeyError, TypeError) as error:
        raise InputError(f"{folder.path} does not say how it was trained: {error}.") from error
    if request.steps is not None or request.minutes is not None:
        budget = Budget(request.steps, request.minutes)
        folder.configure({**record, "budget": asdict(budget)})
    if not folder.data.is_file():
        _make_again(folder, configuration, record)
    return folder, configuration, budget, load_training_data(folder.data)


def _make_again(folder: RunFolder, configuration: TrainingConfiguration, record: dict[str, Any]) -> None:
    """The data of a run that was left before it was written, or that travelled without it."""
    if record.get("data") != BUILT_IN:
        raise InputError(
            f"{folder.path} has lost its data, which came from a pack or recordings; start a new training from these "
            "in a new folder."
        )
    save_training_data(_collected(configuration, None), folder.data)


def _licence(record: dict[str, Any], configuration: TrainingConfiguration) -> str:
    """Licence of the weights: that of those they began with or of this package, unless they learn the user's data."""
    origin = record.get("origin")
    begun = FREE_LICENCE if origin is None else str(origin["licence"])
    own_garments = any(Path(name).suffix for name in configuration.data.garments)
    if (record.get("data") == BUILT_IN and not own_garments) or begun.startswith("unknown"):
        return begun
    return UNKNOWN_LICENCE if begun == FREE_LICENCE else f"{UNKNOWN_LICENCE}; it started from weights under {begun}"


def _restore(trainer: Trainer, folder: RunFolder) -> None:
    state, record = folder.load_state(), folder.configuration()
    trainer.averages.licence, origin = _licence(record, trainer.configuration), record.get("origin")
    if origin is not None:
        trainer.averages.origin = training_record_from_json(origin["record"])
    if state is not None:
        trainer.resume(*state)
    elif origin is not None:
        trainer.begin_with(from_pretrained(origin["weights"]))
    if trainer.workers.leads:
        folder.forget_leftovers()
        folder.forget_metrics_after(trainer.counters.step)
    trainer.workers.agreed(False)


def _summary(trainer: Trainer, folder: RunFolder, ending: str) -> dict[str, Any]:
    counters = trainer.counters
    sentences = {
        "finished": f"Trained {counters.step} steps.",
        "flat": f"Stopped at step {counters.step}: {counters.flat} validations in a row brought nothing better; "
        f"--resume {folder.path} with more --steps or --minutes goes on.",
        "stopped": f"Stopped at step {counters.step}; go on with --resume {folder.path}.",
    }
    return {
        "ending": ending,
        "sentence": sentences[ending],
        "steps": counters.step,
        "seconds": counters.seconds,
        "rollbacks": counters.rollbacks,
        "validation": None if counters.best is None else asdict(counters.best),
        "weights": str(folder.best) if folder.best.is_file() else None,
    }


class _Silent(Reporter):
    """Reporter of a process that does not lead."""

    def said(self, sentence: str) -> None:
        pass


@contextmanager
def stop_signals() -> Iterator[Callable[[], bool]]:
    """Function that tells whether an interrupt or SIGTERM has arrived; a second interrupt has its usual effect."""
    signals: list[int] = []

    def ask(number: int, _: FrameType | None) -> None:
        if signals and number == signal.SIGINT:
            raise KeyboardInterrupt
        signals.append(number)

    try:
        before = {number: signal.signal(number, ask) for number in STOPPING}
    except ValueError:
        # Not the main thread: nobody can send it signals.
        yield lambda: False
        return
    try:
        yield lambda: bool(signals)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
