"""Base class of the panels of a window, and the boxes for their messages."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from enum import Enum
from html import escape
from typing import TYPE_CHECKING, Any

from pb4u.viewer.view_state import ViewState
from pb4u.viewer.worker import plain_sentence

if TYPE_CHECKING:
    from viser import GuiApi

    from pb4u.viewer.browser_window import BrowserWindow


class Panel(ABC):
    """A group of controls that forwards what the user does to its window.

    Args:
        gui: controls of one page.
        window: does what the user asks for, from any thread.
    """

    def __init__(self, gui: GuiApi, window: BrowserWindow) -> None:
        self._gui, self._window = gui, window
        self._add_controls()

    @abstractmethod
    def _add_controls(self) -> None:
        """Put the controls where the page is being filled."""

    def _answer(self, action: Callable[[], None]) -> Callable[[Any], None]:
        """`action` for an event of the page; what it raises is said there, and what the program set is not heard."""

        def answer(event: Any) -> None:
            if event.client is None or self._window.closed:
                return
            try:
                action()
            except Exception as error:
                self._window.say(plain_sentence(error))

        return answer

    def _sets(
        self, control: Any, apply: Callable[[ViewState, Any], None], then: Callable[[], None] | None = None
    ) -> None:
        """Let what a user fills into `control` be applied to the state, and something else be done after it."""

        def moved() -> None:
            value = control.value
            self._window.change(lambda state: apply(state, value))
            if then is not None:
                then()

        control.on_update(self._answer(moved))


class Tone(Enum):
    """Kinds of sentences, each with the colour of its letters and of its ground."""

    plain = ("#475467", "#f2f4f7")
    good = ("#027a48", "#ecfdf3")
    warning = ("#b54708", "#fffaeb")
    bad = ("#b42318", "#fef3f2")


def notice(sentence: str, tone: Tone = Tone.plain) -> str:
    """A sentence in a coloured box, as HTML; nothing where there is nothing to say.

    Args:
        sentence: plain text, escaped here.
        tone: colours of the box.
    """
    if not sentence:
        return ""
    colour, ground = tone.value
    return (
        f"<div data-notice='{tone.name}' style='margin:4px 12px 8px;padding:6px 10px;border-radius:4px;"
        f"font-size:0.85em;line-height:1.35;color:{colour};background:{ground}'>{escape(sentence)}</div>"
    )
