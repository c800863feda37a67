"""What every panel of a window stands on: where its requests go, and the boxes in which it says something."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from enum import Enum
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from pb4u.run import Run
from pb4u.viewer.view_state import ViewState
from pb4u.viewer.worker import plain_sentence

if TYPE_CHECKING:
    from viser import GuiApi


class Requests(Protocol):
    """Requests of a user to a window: the one way from the panels back to it. Each is called from any thread."""

    @property
    def closed(self) -> bool:
        """Whether the window is gone."""

    def say(self, sentence: str) -> None:
        """Tell the user what went wrong.

        Args:
            sentence: what went wrong.
        """

    def change(self, action: Callable[[ViewState], None]) -> None:
        """Do something to the state, and show it.

        Args:
            action: changes the state.
        """

    def reset_camera(self) -> None:
        """Point the camera at all clips again."""

    def simulate(self, run: Run) -> None:
        """Begin a simulation.

        Args:
            run: what is simulated, and how.

        Raises:
            InputError: another one runs, or the page does not offer what is requested.
        """

    def cancel(self) -> None:
        """End the simulation before its next step."""

    def keep(self, kind: str, name: str, content: bytes) -> str:
        """Keep a file of the user's own; its name from now on.

        Args:
            kind: one of `pb4u.viewer.uploads.KINDS`.
            name: of the file.
            content: all of its bytes.

        Raises:
            InputError: it cannot be used.
        """

    def find(self, kind: str, name: str) -> Path | None:
        """The file of that kind and name that the user handed over; None where there is none.

        Args:
            kind: "garment", "body" or "motion".
            name: its name.
        """

    def save_scene(self, run: Run) -> str:
        """Hand the user a scene file, packed with the files it names; returns a sentence that says so.

        Args:
            run: what it describes.
        """

    def film(self, suffix: str) -> None:
        """Begin to take pictures of the view as it is.

        Args:
            suffix: ".png" for the frame that is shown, ".gif" or ".mp4" for all of them.

        Raises:
            InputError: there is nothing to see, or pictures are being taken.
            MissingExtraError: the format needs an extra.
        """

    def stop_filming(self) -> None:
        """Take no more pictures, and throw away what is there."""

    def export(self, suffix: str, which: int) -> str:
        """Hand the user a clip as a file; returns a sentence that says so.

        Args:
            suffix: one of `pb4u.export.registry.WRITERS`.
            which: number of the clip, from 0.

        Raises:
            InputError: the clip cannot be written.
            MissingExtraError: the format needs an extra.
        """


class Panel(ABC):
    """Some controls of one window, which turn what a user does into requests.

    Args:
        gui: controls of one page.
        requests: where the requests go.
    """

    def __init__(self, gui: GuiApi, requests: Requests) -> None:
        self._gui, self._requests = gui, requests
        self._add_controls()

    @abstractmethod
    def _add_controls(self) -> None:
        """Put the controls where the page is being filled."""

    def _answer(self, action: Callable[[], None]) -> Callable[[Any], None]:
        """`action` for an event of the page; what it raises is said there, and what the program set is not heard."""

        def answer(event: Any) -> None:
            if event.client is None or self._requests.closed:
                return
            try:
                action()
            except Exception as error:
                self._requests.say(plain_sentence(error))

        return answer

    def _sets(
        self, control: Any, apply: Callable[[ViewState, Any], None], then: Callable[[], None] | None = None
    ) -> None:
        """Let what a user fills into `control` be applied to the state, and something else be done after it."""

        def moved() -> None:
            value = control.value
            self._requests.change(lambda state: apply(state, value))
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
