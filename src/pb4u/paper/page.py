"""What a run's report is made of, its Markdown, and its tables as CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure


@dataclass(frozen=True)
class Table:
    """A table of the report: rows of text under a head.

    Args:
        title: heading above the table.
        caption: sentence below it.
        head: heads of the columns.
        rows: as many texts each.
        words: number of columns, from the left, with words instead of numbers.
    """

    title: str
    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: int = 1


@dataclass(frozen=True)
class Plot:
    """A plot or picture of the report.

    Args:
        name: file name without suffix.
        title: heading above the picture.
        caption: sentence below it.
        figure: the drawing.
    """

    name: str
    title: str
    caption: str
    figure: Figure

    @property
    def png(self) -> bytes:
        """Content of its PNG file."""
        stream = io.BytesIO()
        self.figure.savefig(stream, format="png", dpi=130)
        return stream.getvalue()


@dataclass(frozen=True)
class Remark:
    """A part of the report that is only text.

    Args:
        title: heading above the text; "" for none.
        lines: sentences, each in a line of its own.
    """

    title: str
    lines: Sequence[str]


Block = Table | Plot | Remark


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
            parts += block.lines
        elif isinstance(block, Plot):
            parts += [f"![{block.title}](plots/{block.name}.png)", block.caption]
        else:
            parts += [_markdown_table(block), block.caption]
    return "\n\n".join(part for part in parts if part) + "\n"


def as_csv(blocks: Sequence[Block]) -> str:
    """Values of all tables as CSV, a line each: table, row, column, value; the words of a row are joined by commas.

    Args:
        blocks: the parts of the page.
    """
    stream = io.StringIO()
    lines = csv.writer(stream, lineterminator="\n")
    lines.writerow(("table", "row", "column", "value"))
    for table in (block for block in blocks if isinstance(block, Table)):
        for cells in table.rows:
            row = ", ".join(cells[: table.words])
            values = zip(table.head[table.words :], cells[table.words :], strict=True)
            lines.writerows((table.title, row, column, value) for column, value in values if value)
    return stream.getvalue()


def _markdown_table(table: Table) -> str:
    def line(cells: Sequence[str]) -> str:
        return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"

    rule = "|" + "---|" * table.words + "---:|" * (len(table.head) - table.words)
    return "\n".join([line(table.head), rule, *(line(row) for row in table.rows)])
