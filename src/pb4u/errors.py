"""What the program refuses, and what it only warns about."""

from __future__ import annotations


class Pb4uError(Exception):
    """The request failed or was refused; the message is one plain sentence saying what, where and how to mend."""


class InputError(Pb4uError, ValueError):
    """An input (file, name or number) cannot be used as it is."""


class MissingExtraError(Pb4uError, ImportError):
    """An optional part of the package is not installed."""

    def __init__(self, extra: str, purpose: str) -> None:
        super().__init__(f'{purpose} needs the "{extra}" extra: pip install "pb4u[{extra}]".')
        self.extra = extra


class InputWarning(UserWarning):
    """An input is unusual but usable; the message is one plain sentence."""
