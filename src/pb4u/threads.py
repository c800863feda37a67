"""Parts of a step on several threads: searches and rows of networks, which do not hold the interpreter's lock.

Torch's own threads share out every operation of a step, which are small, and wait for one another after each; while
they wait they keep the processors busy. So a step is taken with one of them, and in parts.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from itertools import count
from threading import Lock, local
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    import torch
    from threadpoolctl import ThreadpoolController

Part = TypeVar("Part")
Item = TypeVar("Item")
Result = TypeVar("Result")


def thread_count() -> int:
    """Number of threads that searches may use: the processors of this process, or OMP_NUM_THREADS where it is less."""
    setting = os.environ.get("OMP_NUM_THREADS", "").split(",")[0]
    return min(_processors(), int(setting)) if setting.isdecimal() and int(setting) > 0 else _processors()


@cache
def _processors() -> int:
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        # Only Linux knows which processors a process may use.
        return os.cpu_count() or 1


def to_device(values: torch.Tensor, device: torch.device) -> torch.Tensor:
    """Copy of `values` (...), from the processor, on `device`, without waiting for an accelerator.

    Args:
        values: of any shape and unit.
        device: of the copy.
    """
    return (values.pin_memory() if device.type == "cuda" else values).to(device, non_blocking=True)


_alone = local()
"""Whether operations are kept on a thread already: to do so takes as long as a small part of a step."""


@contextmanager
def without_library_threads() -> Iterator[None]:
    """Keep operations of torch, and products of numpy and scipy, on the thread that asks for them.

    For torch this applies to this thread only, for numpy and scipy to the whole process. Torch's own setting would be
    that of every thread begun meanwhile, for good.
    """
    if getattr(_alone, "kept", False):
        yield
        return
    with _controller("openmp").limit(limits=1), _products_limited:
        _alone.kept = True
        try:
            yield
        finally:
            _alone.kept = False


class _ProductsLimited:
    """One thread for products while any thread is inside: the first limits them, the last restores what there was.

    What each found on its own would be the limit of the other, where one leaves before the other does.
    """

    def __init__(self) -> None:
        self._lock, self._inside, self._before = Lock(), 0, list[int]()

    def __enter__(self) -> None:
        with self._lock:
            libraries = _controller("blas").lib_controllers
            if not self._inside:
                self._before = [library.num_threads for library in libraries]
                self._set([1] * len(libraries))
            self._inside += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._inside -= 1
            if not self._inside:
                self._set(self._before)

    @staticmethod
    def _set(counts: list[int]) -> None:
        for library, threads in zip(_controller("blas").lib_controllers, counts, strict=True):
            # Newer versions of threadpoolctl let only the thread restore that limited, which may be gone.
            getattr(library, "_real_set_num_threads", library.set_num_threads)(threads)


_products_limited = _ProductsLimited()


@cache
def _controller(kind: str) -> ThreadpoolController:
    """Finds the libraries of a kind, "blas" or "openmp", that have threads, which takes 3 ms."""
    import scipy.linalg  # noqa: F401  # has the library of compiled products
    import torch  # noqa: F401  # both are loaded first, so that their libraries are found
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api=kind)


def parallel_map(function: Callable[[Part], Result], parts: Sequence[Part]) -> list[Result]:
    """`function` of each of the `parts`, in their order, whatever thread took which.

    Threads are reused between calls, which saves 0.1 of 0.2 ms. The calling thread does not wait for parts that no
    other thread has begun when it finishes: threads do not exist in a forked process, and may themselves be callers.

    Args:
        function: mostly compiled code, otherwise threads would wait for one another.
        parts: of similar size and more than threads, so that no thread waits.
    """
    helpers = min(len(parts), thread_count()) - 1 if len(parts) > 1 else 0
    if helpers < 1:
        return [function(part) for part in parts]
    results: dict[int, Result] = {}
    failures: list[BaseException] = []
    numbers = count()

    def work() -> None:
        try:
            while not failures and (number := next(numbers)) < len(parts):
                results[number] = function(parts[number])
        except BaseException as failure:  # raised again below, by the thread that asked
            failures.append(failure)

    with without_library_threads():
        begun = [_helpers().submit(work) for _ in range(helpers)]
        work()
        for helper in begun:
            if not helper.cancel():
                helper.result()
    if failures:
        raise failures[0]
    return [results[number] for number in range(len(parts))]


def begun(function: Callable[[], Result]) -> Callable[[], Result]:
    """Start `function` on another thread, if there is one; calling the returned object waits for its result.

    If no other thread has begun it by then, the calling thread runs it.

    Args:
        function: mostly compiled code; must not use data that change meanwhile.
    """
    if thread_count() < 2:
        return function
    future = _helpers().submit(_on_one_thread, lambda _: function(), None)
    return lambda: function() if future.cancel() else future.result()


@cache
def _helpers() -> ThreadPoolExecutor:
    def keep_operations() -> None:
        # For good: the threads are ours. Who gives them parts limits products meanwhile.
        _controller("openmp").limit(limits=1)

    return ThreadPoolExecutor(max(1, thread_count() - 1), initializer=keep_operations)


def prefetch(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """`function` of each of the `items`, in their order, each on another thread while the next item is made.

    With a single thread each is computed before the next item. If making an item ends in an error or an interrupt, the
    results of earlier items come first.

    Args:
        function: must not use data that are changed while an item is made.
        items: made one after another.
    """
    if thread_count() < 2:
        yield from map(function, items)
        return
    behind: deque[Future[Result]] = deque()
    with ThreadPoolExecutor(1) as thread:
        try:
            for item in items:
                behind.append(thread.submit(_on_one_thread, function, item))
                if len(behind) > 1:
                    result = behind[0].result()
                    behind.popleft()
                    yield result
        except GeneratorExit:
            raise
        except BaseException:
            while behind:
                yield behind.popleft().result()
            raise
        while behind:
            yield behind.popleft().result()


def _on_one_thread(function: Callable[[Item], Result], item: Item) -> Result:
    with without_library_threads():
        return function(item)
