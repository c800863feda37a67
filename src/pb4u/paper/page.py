"""What a run's report is made of, and the two forms it is written in: Markdown, and one HTML file with all in it."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Table:
    """A table of the report: rows of text under a head.

    Args:
        title: heading above the table.
        caption: sentence below it.
        head: heads of the columns.
        rows: as many texts each.
        their_columns: indices of the columns with the paper's own numbers; they are set apart.
        their_rows: indices of the rows with the paper's own numbers.
        words: number of columns, from the left, that hold words and not numbers.
    """

    title: str
    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    their_columns: frozenset[int] = frozenset()
    their_rows: frozenset[int] = frozenset()
    words: int = 1


@dataclass(frozen=True)
class Plot:
    """A plot or picture of the report.

    Args:
        name: file name without suffix.
        title: heading above the picture.
        caption: sentence below it.
        png: content of its PNG file.
    """

    name: str
    title: str
    caption: str
    png: bytes


def png(figure: Any, resolution: int) -> bytes:
    """Content of the PNG file of a figure.

    Args:
        figure: of matplotlib.
        resolution: pixels an inch.
    """
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=resolution)
    return stream.getvalue()


@dataclass(frozen=True)
class Remark:
    """A part of the report that is text alone.

    Args:
        title: heading above the text; "" for none.
        lines: sentences, each in a line of its own.
    """

    title: str
    lines: Sequence[str]


Block = Table | Plot | Remark

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #1c1c1e; background: #fff; max-width: 1180px; margin: 2.5rem auto;
  padding: 0 1.5rem; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.1rem; margin-top: 2.4rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: 13px; font-variant-numeric: tabular-nums; }
th, td { padding: .28rem .7rem; text-align: right; white-space: nowrap; border-bottom: 1px solid #e6e6ea; }
th { border-bottom: 1.5px solid #1c1c1e; font-weight: 600; white-space: normal; vertical-align: bottom; }
th.word, td.word { text-align: left; }
.theirs { color: #77777d; background: #f6f6f8; }
.caption { color: #55555a; font-size: 13px; max-width: 75ch; }
img { max-width: 100%; height: auto; }
"""


def as_html(title: str, blocks: Sequence[Block]) -> str:
    """The page as one HTML file that needs no other.

    Args:
        title: of the page.
        blocks: its parts from top to bottom.
    """
    parts = [_html_block(block) for block in blocks]
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}</title>'
        f"<style>{_STYLE}</style></head>\n<body><h1>{html.escape(title)}</h1>\n"
        + "\n".join(parts)
        + "\n</body></html>\n"
    )


def _html_block(block: Block) -> str:
    head = f"<h2>{html.escape(block.title)}</h2>" if block.title else ""
    if isinstance(block, Remark):
        return head + "".join(f"<p>{html.escape(line)}</p>" for line in block.lines)
    caption = f'<p class="caption">{html.escape(block.caption)}</p>' if block.caption else ""
    if isinstance(block, Plot):
        data = base64.b64encode(block.png).decode()
        return f'{head}<img alt="{html.escape(block.title)}" src="data:image/png;base64,{data}">{caption}'
    rows = [_html_row(block, "th", block.head, False)]
    rows += [_html_row(block, "td", row, index in block.their_rows) for index, row in enumerate(block.rows)]
    return f'{head}<div class="scroll"><table>{"".join(rows)}</table></div>{caption}'


def _html_row(table: Table, tag: str, cells: Sequence[str], theirs: bool) -> str:
    row = ""
    for index, cell in enumerate(cells):
        kinds = ["word"] * (index < table.words) + ["theirs"] * (theirs or index in table.their_columns)
        marked = f' class="{" ".join(kinds)}"' if kinds else ""
        row += f"<{tag}{marked}>{html.escape(cell)}</{tag}>"
    return f"<tr>{row}</tr>"


def as_markdown(title: str, blocks: Sequence[Block]) -> str:
    """The page in Markdown, with the plots as files of the folder `plots`.

    Args:
        title: of the page.
        blocks: its parts from top to bottom.
    """
    parts = [f"# {title}"]
    for block in blocks:
        if block.title:
            parts.append(f"## {block.title}")
        if isinstance(block, Remark):
            parts += list(block.lines)
            continue
        if isinstance(block, Plot):
            parts.append(f"![{block.title}](plots/{block.name}.png)")
        else:
            parts.append(_markdown_table(block))
        parts.append(block.caption)
    return "\n\n".join(part for part in parts if part) + "\n"


def _markdown_table(table: Table) -> str:
    def line(cells: Sequence[str]) -> str:
        return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"

    rule = "|" + "---|" * table.words + "---:|" * (len(table.head) - table.words)
    return "\n".join([line(table.head), rule, *(line(row) for row in table.rows)])
