"""What the documentation site makes of the repository when it is built: pages that would otherwise say things twice.

Pages are made of the list of examples, the newest release in the changelog, CONTRIBUTING and the flags of every verb.
A link that leaves `docs` leads to the repository.
"""

from __future__ import annotations

import html
import inspect
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

import latex2mathml.converter
import typer
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[1]
REPOSITORY = "https://github.com/pb4u/pb4u/blob/main"
_LEAVES = re.compile(r"\]\((\.\./)+(?P<target>[A-Za-z][^)#]*)\)")
"""A link to what lies above `docs`."""
_RELEASE = re.compile(r"^## \[\d.*?(?=^## |\Z)", re.MULTILINE | re.DOTALL)
"""The section of a released version in the changelog."""
_VERBS, _ENTRIES = "<!-- verbs -->", "<!-- entries -->"
"""What is replaced in a page: by the flags of every verb, by the entries of a scene file."""


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Draw fences of formulas, and list the design pages in the navigation, in the order of their index."""
    config.mdx_configs["pymdownx.superfences"] = {
        "custom_fences": [{"name": "math", "class": "math", "format": formula}]
    }
    folder = ROOT / "docs" / "design"
    names = ["index.md", *re.findall(r"^\| \[.+?\]\((\w+\.md)\)", (folder / "index.md").read_text(), re.MULTILINE)]
    listed = [{(folder / name).read_text().splitlines()[0].lstrip("# "): f"design/{name}"} for name in names]
    for section in config.nav or []:
        if isinstance(section, dict) and "Design" in section:
            section["Design"] = listed
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made."""
    files.append(File.generated(config, "examples.md", content=_examples()))
    for name, text in (
        ("changelog.md", _newest_release()),
        ("contributing.md", (ROOT / "CONTRIBUTING.md").read_text()),
    ):
        files.append(File.generated(config, name, content=text.replace("](docs/", "](")))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Point links that leave `docs` at the repository, and fill in flags of verbs and entries of scene files."""
    depth = page.file.src_uri.count("/")
    if page.file.src_uri == "api/commands.md":
        markdown = markdown.replace(_VERBS, "\n".join(_verbs()))
    if page.file.src_uri == "guides/scene_files.md":
        markdown = markdown.replace(_ENTRIES, "\n".join(_entries()))

    def inside(link: re.Match[str]) -> str:
        leaves = link[0].count("../") > depth
        return f"]({REPOSITORY}/{link['target']})" if leaves else link[0]

    return _LEAVES.sub(inside, markdown)


def formula(source: str, *_: Any, **__: Any) -> str:
    """A formula in LaTeX as MathML, which browsers draw without a script.

    Args:
        source: the formula.
    """
    lines = "\n".join(latex2mathml.converter.convert(line, display="block") for line in source.split("\n\n"))
    return f'<div class="math">{lines}</div>'


def _examples() -> str:
    lines = ["# Examples", "", "Short programs in `examples/`. Each runs as it is, and the tests run all of them.", ""]
    lines += ["| program | what it shows |", "|---|---|"]
    for file in sorted((ROOT / "examples").glob("[0-9]*.py")):
        title = file.read_text().split('"""', 2)[1].strip().splitlines()[0].rstrip(".")
        lines.append(f"| [`{file.name}`]({REPOSITORY}/examples/{file.name}) | {_cell(title)} |")
    return "\n".join(lines)


def _newest_release() -> str:
    """Page of the release that the changelog dates last; the changelog of the repository has the others."""
    newest = _RELEASE.search((ROOT / "CHANGELOG.md").read_text())
    return f"# Changelog\n\n[All versions]({REPOSITORY}/CHANGELOG.md).\n\n{newest[0] if newest else ''}"


def _verbs() -> Iterator[str]:
    """Every verb with its flags, as `--help` has them."""
    from pb4u.cli.application import app

    yield from _section("pb4u", app)


def _entries() -> Iterator[str]:
    """The entries of each section of a scene file, with what they are."""
    from pb4u.cli.record_flags import option
    from pb4u.options import described
    from pb4u.run import SECTIONS, Run, WornGarment, entries

    for section in ("garments", *SECTIONS):
        found, title = described(Run), f"[{section}]"
        if section == "garments":
            found, title = described(WornGarment), f"[{title}]"
        yield from (f"| `{title}` | |", "|---|---|")
        yield from (f"| `{name}` | {_cell(option(found[name]).help)} |" for name in entries(section))
        yield ""


def _section(path: str, group: typer.Typer) -> Iterator[str]:
    for member in group.registered_commands:
        name = member.name or member.callback.__name__.replace("_", "-")
        yield from _verb(f"{path} {name}", member.callback)
    for inner in group.registered_groups:
        if inner.typer_instance.registered_callback:
            yield from _verb(f"{path} {inner.name}", inner.typer_instance.registered_callback.callback)
        yield from _section(f"{path} {inner.name}", inner.typer_instance)


def _verb(path: str, function: Callable[..., Any]) -> Iterator[str]:
    yield f"## {path}\n"
    for paragraph in (function.__doc__ or "").partition("\f")[0].strip().split("\n\n"):
        yield " ".join(paragraph.split()) + "\n"
    hints = get_type_hints(function, include_extras=True)
    defaults = {name: each.default for name, each in inspect.signature(function).parameters.items()}
    rows = [
        _row(name, hints[name], default) for name, default in defaults.items() if hasattr(hints[name], "__metadata__")
    ]
    if rows:
        yield from ("| | |", "|---|---|", *rows, "")


def _row(name: str, hint: Any, default: Any) -> str:
    told = next(each for each in hint.__metadata__ if hasattr(each, "param_decls"))
    kind = hint.__origin__
    switch = bool in (kind, *get_args(kind))
    choices = [text for each in (kind, *get_args(kind)) if get_origin(each) is Literal for text in get_args(each)]
    named = [text for text in told.param_decls or () if text.startswith("-")] or [f"--{name.replace('_', '-')}"]
    value = told.metavar or "|".join(choices) or ("" if switch else getattr(kind, "__name__", "N").upper())
    shown = value if isinstance(told, typer.models.ArgumentInfo) else " ".join([*named, value]).strip()
    text = told.help or ""
    if isinstance(default, int | float | str) and not switch and "Default" not in text:
        text = f"{text} Default: {default}."
    return f"| <code>{_cell(shown)}</code> | {_cell(text)} |"


def _cell(text: str) -> str:
    return html.escape(text, quote=False).replace("|", "&#124;").replace("*", "&#42;").replace("_", "&#95;")
