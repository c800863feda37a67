"""Tables by name that modules of higher layers add to, so that no layer needs the name of one above it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, MutableMapping
from importlib import import_module
from typing import TypeVar

from pb4u.errors import refuse_unknown

Entry = TypeVar("Entry")

PROVIDERS: dict[str, tuple[str, ...]] = {}
"""Kind of entries -> modules that register some when they are imported; `pb4u` fills it, which stands above all."""


class Registry(MutableMapping[str, Entry]):
    """Entries of one kind by name: a layer's own, and entries that modules of higher layers register.

    The providers of the kind are imported when a name is not found without them, or when all names are listed. A
    provider that is not installed is skipped.

    Args:
        kind: what an entry is, as messages and `PROVIDERS` call it.
        entries: the layer's own entries.
    """

    def __init__(self, kind: str, entries: Mapping[str, Entry] | None = None) -> None:
        self.kind = kind
        self._entries = dict(entries or {})

    def named(self, name: str) -> Entry:
        """Entry that a user named.

        Args:
            name: the name that was given.

        Raises:
            InputError: there is none; similar names are listed.
        """
        refuse_unknown(self.kind, [name], self)
        return self[name]

    def __getitem__(self, name: str) -> Entry:
        if name not in self._entries:
            self._import_providers()
        return self._entries[name]

    def __setitem__(self, name: str, entry: Entry) -> None:
        self._entries[name] = entry

    def __delitem__(self, name: str) -> None:
        del self._entries[name]

    def __iter__(self) -> Iterator[str]:
        self._import_providers()
        return iter(self._entries)

    def __len__(self) -> int:
        self._import_providers()
        return len(self._entries)

    def _import_providers(self) -> None:
        for module in PROVIDERS.get(self.kind, ()):
            try:
                import_module(module)
            except ModuleNotFoundError as error:
                # A provider may be absent, but not a part that a provider needs.
                if not f"{module}.".startswith(f"{error.name}."):
                    raise
