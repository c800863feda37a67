"""A sentence in a coloured box."""

from __future__ import annotations

from enum import Enum
from html import escape


class Tone(Enum):
    """How a sentence is meant: colour of the letters, colour of the ground."""

    plain = ("#475467", "#f2f4f7")
    good = ("#027a48", "#ecfdf3")
    warning = ("#b54708", "#fffaeb")
    bad = ("#b42318", "#fef3f2")


def notice(sentence: str, tone: Tone = Tone.plain) -> str:
    """HTML of the box; nothing where there is nothing to say."""
    if not sentence:
        return ""
    colour, ground = tone.value
    return (
        f"<div data-notice='{tone.name}' style='margin:4px 12px 8px;padding:6px 10px;border-radius:4px;"
        f"font-size:0.85em;line-height:1.35;color:{colour};background:{ground}'>{escape(sentence)}</div>"
    )
