"""What a page is answered with: its events, guarded so that an error becomes a sentence."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from pb4u.viewer.plain_sentence import plain_sentence

if TYPE_CHECKING:
    from pb4u.viewer.session import Session


def guarded(session: Session, action: Callable[[], None]) -> Callable[[Any], None]:
    """`action` for an event of the page: what it raises becomes a sentence there; what the program set is not heard."""

    @functools.wraps(action)
    def answer(event: Any) -> None:
        if event.client is None or session.closed:
            return
        try:
            action()
        except Exception as error:
            session.say(plain_sentence(error))

    return answer
