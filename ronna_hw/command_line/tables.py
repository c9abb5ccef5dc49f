"""Tables on standard output: framed on a wide enough terminal, tab-separated lines elsewhere."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Sequence

from ronna_hw.command_line.messages import on_terminal
from ronna_hw.text.printable import printable, printable_lines

FRAME_WIDTH = 3  # of a table's frame, per column


def print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a table on standard output: framed if it fits on a terminal, tab-separated lines otherwise.

    Cells and headings wrap only between words. If the frame would split a word or a number, lines
    are printed instead.
    """
    table_rows = [list(columns), *([printable_lines(str(cell)) for cell in row] for row in rows)]
    widths = _column_widths(table_rows, _terminal_width()) if on_terminal(sys.stdout) else None
    if widths is None:
        for row in table_rows:
            sys.stdout.write("\t".join(row) + "\n")
        return
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table()
    for column, width in zip(columns, widths, strict=True):
        table.add_column(Text(column), width=width, overflow="fold")
    for row in table_rows[1:]:
        table.add_row(*(Text(cell) for cell in row))
    sys.stdout.write(f"{printable(title)}\n")  # a table's own title would wrap at the table's width
    sys.stdout.flush()
    Console().print(table)


def _column_widths(rows: Sequence[Sequence[str]], terminal_width: int) -> list[int] | None:
    """Widths that fill the terminal without splitting a word; None if there are none."""
    by_column = list(zip(*rows, strict=True))
    widths = [_least_width(cells) for cells in by_column]
    wanted = [max(len(line) for cell in cells for line in cell.split("\n")) for cells in by_column]
    spare = terminal_width - 1 - FRAME_WIDTH * len(widths) - sum(widths)
    if spare < 0:
        return None
    for _ in range(spare):  # to the column that needs it most
        lacking = [want - width for want, width in zip(wanted, widths, strict=True)]
        if max(lacking, default=0) <= 0:
            break
        widths[lacking.index(max(lacking))] += 1
    return widths


def _least_width(cells: Sequence[str]) -> int:
    """Smallest width of a column without splitting a word."""
    return max((len(word) for cell in cells for word in cell.split()), default=0)


def _terminal_width() -> int:
    return shutil.get_terminal_size().columns
