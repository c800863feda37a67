"""The help of every verb: on one screen, with all that has to be known in the whole one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import typer

from pb4u.cli.application import app


@pytest.mark.parametrize(
    ("verb", "says"),
    [
        (
            ("simulate", "--help-all"),
            ("beta0=1.5", "GLB is within 1 mm", "garment alone", "Blender", "solver always runs on the"),
        ),
        (("convert", "--help-all"), ("GLB is within 1 mm", "garment alone", "Blender")),
        (("check",), ("beta0=1.5",)),
        (("assets", "write"), ("beta0=1.5", "takes as --body")),
    ],
)
def test_help_says_what_has_to_be_known(pb4u: Callable, verb: tuple[str, ...], says: tuple[str, ...]) -> None:
    text = " ".join(pb4u(*verb, *([] if "--help-all" in verb else ["--help"])).out.replace("│", " ").split())
    assert [phrase for phrase in says if phrase not in text] == []


VERBS = (
    "", "simulate", "view", "check", "dress", "measure-body", "convert", "convert-weights", "train", "evaluate",
    "batch", "info", "assets", "assets write", "assets swatches", "assets pack",
)  # fmt: skip


def test_every_verb_is_among_those_whose_help_is_read() -> None:
    group: Any = typer.main.get_command(app)
    inner = {f"assets {name}" for name in group.commands["assets"].commands}
    assert {*VERBS} == {"", *group.commands} | inner


@pytest.mark.parametrize("verb", VERBS)
def test_help_fits_a_screen(pb4u: Callable, monkeypatch: pytest.MonkeyPatch, verb: str) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert len(pb4u(*verb.split(), "--help").out.strip().splitlines()) <= 44


@pytest.mark.parametrize(
    ("verb", "left_out"),
    [("simulate", "--lead-in"), ("convert", "--turntable"), ("evaluate", "--floors"), ("batch", "--clips-per-shard")],
)
def test_a_brief_help_names_the_flag_of_the_whole_one(
    pb4u: Callable, monkeypatch: pytest.MonkeyPatch, verb: str, left_out: str
) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    brief, whole = pb4u(verb, "--help").out, pb4u(verb, "--help-all").out
    assert "--help-all" in brief
    assert left_out not in brief
    command = typer.main.get_command(app).commands[verb]  # type: ignore[attr-defined]
    assert [option for each in command.params for option in each.opts if option not in whole] == []
    assert pb4u(verb, "--help").out == brief  # the whole help left nothing behind


def test_a_brief_help_has_the_first_sentence_and_the_default(pb4u: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    text = " ".join(pb4u("simulate", "--help").out.replace("│", " ").split())
    assert (
        "--triangles N Triangles to simulate. Default: the file's own, or 2,500 of a built-in garment. --body" in text
    )
    assert "--motion NAME|FILE Built-in motion, or .amc," in text


@pytest.mark.parametrize("verb", ["", "simulate", "convert", "train", "evaluate", "batch", "view", "assets write"])
def test_help_cuts_no_name_and_names_no_type_of_a_switch(
    pb4u: Callable, monkeypatch: pytest.MonkeyPatch, verb: str
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    told = pb4u(*verb.split(), "--help").out
    assert "--help" in told
    assert [line for line in told.splitlines() if "bool" in line or "…" in line] == []
