"""How much a pickle may make its reader take: instructions, texts and nested collections, counted before it is read."""

from __future__ import annotations

import pickletools
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from pb4u.errors import InputError
from pb4u.io.reading_limits import HEADROOM, megabytes

MOST_OPCODES = 1_000_000
"""Instructions of a pickle; each makes one object at most, of which the largest, an empty set, takes 216 bytes."""
MOST_UNFOLDED = 4_000_000
"""Entries of nested collections in a pickle where what is shared is counted each time it is used, as numpy would."""

_OPCODES = {opcode.code.encode("latin-1"): opcode for opcode in pickletools.opcodes}
_LENGTHS = {
    pickletools.TAKEN_FROM_ARGUMENT1: 1, pickletools.TAKEN_FROM_ARGUMENT4: 4,
    pickletools.TAKEN_FROM_ARGUMENT4U: 4, pickletools.TAKEN_FROM_ARGUMENT8U: 8,
}  # fmt: skip
"""Bytes that hold the length of an argument, by the kind of argument."""


def require_plain_pickle(stream: BinaryIO, path: Path) -> None:
    """Refuse a pickle that would make too many objects, or nest what it shares so that comparing it never ends.

    The instructions are followed without making what they make: on the stack stands the number of entries of each
    object, counted anew wherever a shared one is used.

    Args:
        stream: the pickle, read to its end mark.
        path: its file, for the message.

    Raises:
        InputError: it holds too much.
        ValueError: it is damaged.
    """
    memo: dict[int, int] = {}
    stack: list[int | None] = []
    texts = 0
    for count, (opcode, argument, size) in enumerate(_instructions(stream)):
        if count > MOST_OPCODES:
            raise InputError(f"{path}: a pickle of more than {MOST_OPCODES:,} instructions; store arrays, not lists.")
        name = opcode.name
        # A text is turned into bytes, and those into an array, before it is let go; bytes only into an array.
        texts += size if "UNICODE" in name else 0
        if texts > HEADROOM // 2 or size > HEADROOM:
            raise InputError(
                f"{path}: a pickle with {megabytes(max(texts, size))} in one piece, which takes over "
                f"{megabytes(HEADROOM)} more than the file to be read; save it with numpy.savez."
            )
        if "PUT" in name or name == "MEMOIZE":
            place = len(memo) if argument is None else int(str(argument))
            if place > MOST_OPCODES:
                raise InputError(f"{path}: a damaged pickle, it names its object {place:,}.")
            memo[place] = (stack[-1] if stack else None) or 0
            continue
        if "GET" in name:
            stack.append(memo.get(int(str(argument)), 0))
            continue
        entries = sum(_taken(opcode, stack))
        if entries > MOST_UNFOLDED:
            raise InputError(
                f"{path}: a pickle of collections nested in each other to over {MOST_UNFOLDED:,} entries, which no "
                "file of plain arrays has."
            )
        stack += [None if kind is pickletools.markobject else 1 + entries for kind in opcode.stack_after]


def _instructions(stream: BinaryIO) -> Iterator[tuple[pickletools.OpcodeInfo, object, int]]:
    """Each instruction with its argument and the bytes of that; texts and bytes with their length are passed over."""
    begin = stream.tell()
    stream.seek(0, 2)
    end = stream.tell()
    stream.seek(begin)
    while code := stream.read(1):
        opcode = _OPCODES.get(code)
        if opcode is None:
            raise ValueError(f"no pickle has an instruction {code!r}")
        if opcode.arg is None or opcode.arg.n not in _LENGTHS:
            start = stream.tell()
            argument = None if opcode.arg is None else opcode.arg.reader(stream)
            yield opcode, argument, stream.tell() - start
        else:
            length = int.from_bytes(stream.read(_LENGTHS[opcode.arg.n]), "little")
            here = stream.tell()
            if here + length > end:
                raise ValueError("it is cut short")
            stream.seek(here + length)
            yield opcode, None, length
        if opcode.name == "STOP":
            return
    raise ValueError("it has no end mark")


def _taken(opcode: pickletools.OpcodeInfo, stack: list[int | None]) -> Iterator[int]:
    """Numbers of entries of what an instruction takes from the stack."""
    before = list(opcode.stack_before)
    if pickletools.markobject in before:
        while stack and (entries := stack.pop()) is not None:
            yield entries
        before = before[: before.index(pickletools.markobject)]
    for _ in before:
        if stack:
            yield stack.pop() or 0
