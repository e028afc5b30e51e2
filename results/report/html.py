"""Tables, notes and figures as one HTML page that needs nothing besides itself."""

import base64
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING

from results.report.text_table import Cell, Page, Section, TextTable

if TYPE_CHECKING:  # drawing is imported where it is asked for
    from matplotlib.figure import Figure

#: nothing may be fetched, whatever a record says
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
STYLE = """
:root { color-scheme: light dark; --line: #8884; --dim: #6b6b6b; }
body { font: 16px/1.5 system-ui, sans-serif; margin: 0 auto; max-width: 76rem; padding: 1rem; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.2rem; margin-top: 2.2rem; }
.wide { overflow-x: auto; } table { border-collapse: collapse; font-size: .9rem; }
th, td { padding: .35rem .7rem; text-align: right; vertical-align: top; white-space: nowrap; }
th { border-bottom: 2px solid var(--line); } td { border-bottom: 1px solid var(--line); }
th:first-child, td:first-child { text-align: left; position: sticky; left: 0; background: Canvas; }
th button { all: unset; cursor: pointer; white-space: pre-line; }
th button:focus-visible { outline: 2px solid; }
th[aria-sort=ascending] button::after { content: " \\25B2"; }
th[aria-sort=descending] button::after { content: " \\25BC"; }
td small { color: var(--dim); display: block; }
figure { margin: 1.5rem 0; } img { background: #fff; height: auto; min-width: 40rem; width: 100%; }
figcaption, details, li { color: var(--dim); font-size: .9rem; overflow-wrap: anywhere; }
"""
SCRIPT = """
const value = cell => {
  const text = cell.firstChild ? cell.firstChild.textContent.trim() : "";
  if (/^[>\\u221E]/.test(text)) return Infinity;
  const number = parseFloat(text.replace("\\u2212", "-"));
  return Number.isNaN(number) ? null : number;
};
const compare = (a, b, by) => {
  const [x, y] = [value(a.cells[by]), value(b.cells[by])];
  if (by === 0 || (x === null && y === null))
    return a.cells[by].textContent.localeCompare(b.cells[by].textContent);
  if (x === null || y === null) return x === null ? 1 : -1;
  return x === y ? 0 : x - y;
};
for (const button of document.querySelectorAll("th button")) {
  button.addEventListener("click", () => {
    const head = button.parentElement, body = head.closest("table").tBodies[0];
    const down = head.getAttribute("aria-sort") === "ascending";
    for (const other of head.parentElement.children) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", down ? "descending" : "ascending");
    const rows = [...body.rows].sort((a, b) => compare(a, b, head.cellIndex));
    body.append(...(down ? rows.reverse() : rows));
  });
}
"""


@dataclass(frozen=True)
class Picture:
    """A figure on the page.

    :param caption: what it shows
    :param made: how, for whoever wants to make it again
    :param content: of the file
    :param kind: of the file, such as ``"image/png"``
    """

    caption: str
    made: str
    content: bytes
    kind: str


def svg_picture(figure: "Figure", caption: str, made: str) -> Picture:
    """Return a drawn figure as a picture; equal figures give equal bytes.

    :param figure: drawn
    :param caption: what it shows
    :param made: how
    """
    from matplotlib import rc_context

    buffer = io.BytesIO()
    with rc_context({"svg.hashsalt": "nmp-bench"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return Picture(caption, made, buffer.getvalue(), "image/svg+xml")


def html_page(title: str, page: Page, pictures: Sequence[Picture], facts: Mapping[str, str]) -> str:
    """Return the whole page as text.

    :param title: above it
    :param page: tables and what is said below them
    :param pictures: in their order
    :param facts: about the runs, by what they tell
    """
    told = "".join(f"<li>{escape(name)}: {escape(text)}</li>" for name, text in facts.items())
    parts = [
        f"<h1>{escape(title)}</h1><ul>{told}</ul>",
        *(_table(table) for table in page.tables),
        *(_figure(picture) for picture in pictures),
        *(_section(section) for section in page.sections if section.lines),
    ]
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}</style></head>\n<body>"
        + "\n".join(parts)
        + f"\n<script>{SCRIPT}</script></body></html>\n"
    )


def _table(table: TextTable) -> str:
    head = "".join(
        f'<th scope="col"><button type="button">{escape(name)}</button></th>'
        for name in table.header
    )
    rows = "".join(f"<tr>{''.join(map(_cell, row))}</tr>\n" for row in table.rows)
    return (
        f'<h2>{escape(table.title)}</h2>\n<div class="wide" tabindex="0"><table>'
        f"<thead><tr>{head}</tr></thead>\n<tbody>{rows}</tbody></table></div>"
    )


def _cell(cell: Cell) -> str:
    main, spread = cell
    below = f"<small>{escape(spread)}</small>" if spread else ""
    return f"<td><span>{escape(main)}</span>{below}</td>"


def _figure(picture: Picture) -> str:
    data = base64.b64encode(picture.content).decode()
    caption = escape(picture.caption)
    return (
        f'<figure><div class="wide" tabindex="0"><img alt="{caption}" '
        f'src="data:{picture.kind};base64,{data}"></div>'
        f"<figcaption>{caption}</figcaption><details><summary>how it was made</summary>"
        f"{escape(picture.made)}</details></figure>"
    )


def _section(section: Section) -> str:
    lines = "".join(f"<li>{escape(line)}</li>" for line in section.lines)
    return f"<h2>{escape(section.title)}</h2><ul>{lines}</ul>"
