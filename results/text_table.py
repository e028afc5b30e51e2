"""`TextTable`: rows of text, for the terminal and as Markdown."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from rich import box
from rich.console import Group
from rich.table import Table
from rich.text import Text

NOT_APPLICABLE = "–"
MARGIN = 2  # between columns, in characters

Cell = tuple[str, str]  # the main line, and one for its spread or reason
Section = tuple[str, Sequence[str], str]  # its title, its lines, and their style


@dataclass(frozen=True)
class TextTable:
    """A table of text; each cell has a main line and one for its spread.

    :param title: above it
    :param header: names of the columns
    :param rows: one cell a column each; the first column is the rows' names
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]

    def rich(self) -> Table:
        """Return it for the terminal; the spread stands below the main line."""
        table = Table(box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
        for index, name in enumerate(self.header):
            table.add_column(Text(name), justify="right" if index else "left", no_wrap=True)
        for row in self.rows:
            table.add_row(*(stacked(cell) for cell in row))
        return table

    def parts(self, width: int) -> list["TextTable"]:
        """Return tables that fit a terminal, each with some columns behind the rows' names.

        :param width: of the terminal, in characters
        """
        names, *others = (self._width(column) for column in range(len(self.header)))
        parts: list[list[int]] = [[]]
        used = names
        for column, needed in enumerate(others, start=1):
            if parts[-1] and used + needed > width:
                parts.append([])
                used = names
            parts[-1].append(column)
            used += needed
        return [self._columns([0, *columns]) for columns in parts]

    def _columns(self, columns: Sequence[int]) -> "TextTable":
        return TextTable(
            self.title,
            tuple(self.header[column] for column in columns),
            tuple(tuple(row[column] for column in columns) for row in self.rows),
        )

    def _width(self, column: int) -> int:
        """Return what a column needs, its margin included."""
        lines = [
            *self.header[column].splitlines(),
            *(line for row in self.rows for line in row[column]),
        ]
        return max(map(len, lines), default=0) + MARGIN

    def markdown(self) -> str:
        """Return it as Markdown; the spread stands behind the main line."""
        lines = [
            "| " + " | ".join(name.replace("\n", " ") for name in self.header) + " |",
            "|---" + "|--:" * (len(self.header) - 1) + "|",
        ]
        for row in self.rows:
            cells = [" ".join(part for part in cell if part) for cell in row]
            lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
        return "\n".join(lines)


def stacked(cell: Cell) -> Text:
    """Return a cell for the terminal, its spread dimmed below its main line.

    :param cell: both lines
    """
    main, spread = cell
    return Text.assemble(main, (f"\n{spread}", "dim")) if spread else Text(main)


def terminal_page(tables: Iterable[TextTable], sections: Iterable[Section], width: int) -> Group:
    """Return tables and notes for the terminal.

    :param tables: in their order
    :param sections: below them; those without lines are left out
    :param width: of the terminal, in characters; a wider table is cut into several
    """
    parts: list[Table | Text] = []
    for table in tables:
        parts.append(Text(table.title, style="bold"))
        parts += [part.rich() for part in table.parts(width)]
    for title, lines, style in sections:
        if lines:
            parts.append(Text("\n".join([title, *lines, ""]), style=style))
    return Group(*parts)


def markdown_page(tables: Iterable[TextTable], sections: Iterable[Section]) -> str:
    """Return tables and notes as Markdown.

    :param tables: in their order
    :param sections: below them; those without lines are left out
    """
    parts: list[str] = []
    for table in tables:
        parts += [f"## {table.title}", "", table.markdown(), ""]
    for title, lines, _ in sections:
        if lines:
            parts += [f"**{title}**", "", *(f"- {' '.join(line.split())}" for line in lines), ""]
    return "\n".join(parts)
