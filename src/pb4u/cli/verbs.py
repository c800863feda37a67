"""Verbs as typer calls them: their help, whole and brief, and what is said of one that does not exist."""

from __future__ import annotations

import re
from copy import copy
from difflib import get_close_matches
from typing import Annotated, Any, TypeAlias

import typer
from typer.core import TyperCommand, TyperGroup


class _Switches:
    """Names no type beside a switch, which takes no value: `--plan`, not `--plan <bool>`.

    A `--help` that is not given is no value to convert either: for that typer would load pydantic, a third of a second.
    """

    def get_params(self, ctx: Any) -> list[Any]:
        """Arguments and options of a verb, help included."""
        params: list[Any] = super().get_params(ctx)  # type: ignore[misc]
        for parameter in params:
            if getattr(parameter, "is_flag", False):
                parameter.metavar = ""
            if parameter.name == "help":
                parameter.default = False
        return params


_WHOLE = "pb4u.whole_help"
"""Key of what the help of a call shows: all options, or those that most calls have."""
_ALSO = ("Default:", "Repeatable")
"""How the sentences begin that a brief help has beside the first of an option."""


def _show_all(context: typer.Context, is_given: bool) -> None:
    if is_given:
        context.meta[_WHOLE] = True
        print(context.get_help())
        raise typer.Exit


HelpAllFlag: TypeAlias = Annotated[
    bool, typer.Option("--help-all", is_eager=True, callback=_show_all, help="Show all options and exit.")
]
"""Flag of a verb whose help is brief."""


class Verb(_Switches, TyperCommand):
    """A verb.

    Attributes:
        brief: names of the options that its help shows, where `--help-all` shows all; empty where it shows all.
    """

    brief: tuple[str, ...] = ()

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help; a brief one has few options, in their order in `brief`, and of their texts the beginning."""
        if not self.brief or ctx.meta.get(_WHOLE):
            super().format_help(ctx, formatter)
            return
        short = copy(self)
        short.brief = ()
        by_name = {parameter.name: parameter for parameter in self.params}
        short.params = [_shortened(by_name[name]) for name in (*self.brief, "help_all")]
        short.format_help(ctx, formatter)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Values of a verb; for an unknown option only the nearest one is suggested."""
        try:
            return super().parse_args(ctx, args)
        except Exception as error:
            if similar := getattr(error, "possibilities", None):
                error.possibilities = get_close_matches(error.option_name, similar, 1, 0.0)  # type: ignore[attr-defined]
            raise


def brief_verb(*options: str) -> type[Verb]:
    """A verb whose help fits a screen.

    Args:
        options: names of those that its help shows, where it takes a `HelpAllFlag`; none where it shows all.
    """
    return type("BriefVerb", (Verb,), {"brief": options})


_ASIDE = re.compile(r" \([^)]*\)|; .*(?=\.$)")
"""What a brief help leaves out of a sentence: what stands in brackets, and what follows a semicolon."""


def _shortened(parameter: Any) -> Any:
    """An option under no heading, with the first sentence of its text, its default, and whether it is repeatable."""
    short = copy(parameter)
    first, *others = re.split(r"(?<=[.]) (?=[A-Z])", parameter.help or "")
    sentences = [first, *(sentence for sentence in others if sentence.startswith(_ALSO))]
    short.help = " ".join(_ASIDE.sub("", sentence) for sentence in sentences)
    if parameter.metavar and parameter.param_type_name == "option":
        short.metavar = re.sub(r"\[.*\]", "", parameter.metavar)  # the name of a part before the value
    short.rich_help_panel = None
    return short


_ELSEWHERE = {
    "export": "convert", "render": "convert", "play": "view", "show": "view", "studio": "view", "run": "simulate",
    "dataset": "batch",
}  # fmt: skip
"""What other programs call a verb -> its name here."""


class Verbs(_Switches, TyperGroup):
    """A group of verbs."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The verb that is called; of an unknown one the nearest is named."""
        name = args[0]
        begun = [verb for verb in self.commands if verb.startswith(name)]
        near = [_ELSEWHERE.get(name, ""), *begun, *get_close_matches(name, self.commands)]
        if name not in self.commands and (verbs := [verb for verb in near if verb in self.commands]):
            ctx.fail(f"There is no command '{name}'; did you mean '{verbs[0]}'?")
        return super().resolve_command(ctx, args)
