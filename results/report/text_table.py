"""`Page`: tables of text and notes, for the terminal and as Markdown."""

from collections.abc import Sequence
from dataclasses import dataclass

from rich import box
from rich.console import Group
from rich.table import Table
from rich.text import Text

NOT_APPLICABLE = "–"
MARGIN = 2  # between columns, in characters

Cell = tuple[str, str]  # the main line, and one for its spread or reason


@dataclass(frozen=True)
class Section:
    """Lines below the tables; without lines it is not shown.

    :param title: above them
    :param lines: of text
    :param style: on a terminal
    """

    title: str
    lines: Sequence[str]
    style: str = ""


@dataclass(frozen=True)
class TextTable:
    """A table of text; each cell has a main line and one for its spread.

    >>> table = TextTable("Runs", ("who", "solved"), ((("GA", ""), ("3/3", "44–100 %")),))
    >>> print(table.markdown())
    | who | solved |
    |---|--:|
    | GA | 3/3 44–100 % |

    :param title: above it
    :param header: names of the columns
    :param rows: one cell per column; the first column is the rows' names
    :param breaks: columns before which a table that is too wide is cut first
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    breaks: tuple[int, ...] = ()

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
        widths = [self._width(column) for column in range(len(self.header))]
        if self.breaks and sum(widths) > width:
            ends = [*self.breaks, len(self.header)]
            starts = [1, *self.breaks]
            blocks = [
                self._columns([0, *range(*ends_)]) for ends_ in zip(starts, ends, strict=True)
            ]
            return [part for block in blocks for part in block.parts(width)]
        parts: list[list[int]] = [[]]
        used = widths[0]
        for column, needed in enumerate(widths[1:], start=1):
            if parts[-1] and used + needed > width:
                parts.append([])
                used = widths[0]
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


def row_cells(label: str, count: str, failed: int) -> tuple[Cell, Cell]:
    """Return the first two cells of a row: the algorithm, and how many of its runs finished.

    :param label: the algorithm's
    :param count: of the finished runs
    :param failed: how many failed
    """
    return (label, ""), (count, f"{failed} failed" if failed else "")


@dataclass(frozen=True)
class Page:
    """Tables, and what is said below them.

    >>> page = Page([TextTable("Runs", ("who",), ((("GA", ""),),))], [Section("Notes", ["None."])])
    >>> page.markdown().splitlines()[-2:]
    ['', '- None.']

    :param tables: in their order
    :param sections: in their order
    """

    tables: Sequence[TextTable]
    sections: Sequence[Section]

    def terminal(self, width: int) -> Group:
        """Return the page for a terminal.

        :param width: in characters; a wider table is cut into several
        """
        parts: list[Table | Text] = []
        for table in self.tables:
            parts.append(Text(table.title, style="bold"))
            parts += [part.rich() for part in table.parts(width)]
        for section in self.sections:
            if section.lines:
                text = "\n".join([section.title, *section.lines, ""])
                parts.append(Text(text, style=section.style))
        return Group(*parts)

    def markdown(self) -> str:
        """Return the page as Markdown."""
        parts: list[str] = []
        for table in self.tables:
            parts += [f"## {table.title}", "", table.markdown(), ""]
        for section in self.sections:
            if section.lines:
                lines = (f"- {' '.join(line.split())}" for line in section.lines)
                parts += [f"**{section.title}**", "", *lines, ""]
        return "\n".join(parts)
