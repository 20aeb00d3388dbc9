"""Reports of calibrations and rehearsals: printed tables, or an HTML page."""

import base64
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from html import escape
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from fss_arm_model.files import write_text
from fss_arm_ros.palette import css

if TYPE_CHECKING:  # not imported by nodes, which print no tables
    from rich.console import Console, ConsoleOptions, Group, RenderableType

CONSOLE_WIDTH = 80  # columns where the output is not a terminal
BORDER = 3  # columns that the frame of a cell takes

VERDICT_STYLES = {"pass": "bold green", "fail": "bold red", "not_evaluated": "bold yellow"}


@dataclass(frozen=True)
class Table:
    """Table of texts with a head; the first `words` columns are words, the others numbers.

    Printed with rich, it never breaks a word or a number: a table that is too wide is continued
    below, with the first column repeated.
    """

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: int = 1
    note: str = ""
    weak: Sequence[int] = ()  # indices of rows shown in amber
    detailed: Sequence[str] = ()  # columns that are printed with the details only

    @property
    def brief(self) -> "Table":
        """The table without its detailed columns."""
        kept = [k for k, name in enumerate(self.head) if name not in self.detailed]
        return self.columns(kept)

    def columns(self, which: Sequence[int]) -> "Table":
        """Return the table with some of its columns."""
        rows = [[row[k] for k in which] for row in self.rows]
        words = sum(k < self.words for k in which)
        return replace(self, head=[self.head[k] for k in which], rows=rows, words=words)

    def widths(self, width: int) -> list[int]:
        """Return the widths of the columns in a table of a width: each word and number fits.

        Numbers, and the names in front of them, stay in one line.
        """
        columns = list(zip(self.head, *self.rows, strict=True))
        natural = [max(map(len, cells)) for cells in columns]
        found = []
        for k, (name, *cells) in enumerate(columns):
            breakable = k < self.words and (k > 0 or self.words == len(self.head))
            words = " ".join(cells).split() if breakable else cells
            found.append(max(map(len, [*name.split(), *words]), default=0))
        for _ in range(width - sum(found) - BORDER * len(found) - 1):
            k = max(range(len(found)), key=lambda k: natural[k] / max(found[k], 1))
            found[k] += found[k] < natural[k]
        return found

    def parts(self, width: int) -> "list[Table]":
        """Return the table in parts that fit a width, each with the first column."""
        narrow = self.widths(0)
        found: list[list[int]] = [[0]]
        for k in range(1, len(self.head)):
            taken = sum(narrow[j] + BORDER for j in [*found[-1], k]) + 1
            if taken > width and len(found[-1]) > 1:
                found.append([0])
            found[-1].append(k)
        return [self.columns(some) for some in found]

    def __rich_console__(
        self, console: "Console", options: "ConsoleOptions"
    ) -> "Iterator[RenderableType]":
        from rich.table import Table as PrintedTable
        from rich.text import Text

        columns = enumerate(zip(self.head, *self.rows, strict=True))
        filled = self.columns([k for k, cells in columns if k == 0 or any(cells)])
        for number, part in enumerate(filled.parts(options.max_width)):
            if part.title:
                yield Text(part.title + ", continued" * (number > 0), style="italic")
            printed, widths = PrintedTable(), part.widths(options.max_width)
            for k, (name, width) in enumerate(zip(part.head, widths, strict=True)):
                side: Literal["left", "right"] = "left" if k < part.words else "right"
                style = "bold" if name == "estimate" else ""
                printed.add_column(
                    Text(name), justify=side, max_width=width, style=style, overflow="fold"
                )
            for row in part.rows:
                printed.add_row(*map(Text, row))
            yield printed


@dataclass(frozen=True)
class Figure:
    """Drawing that is made on demand."""

    name: str  # file name without extension
    title: str
    draw: Callable[[], Any]  # returns a matplotlib Figure

    def png(self) -> bytes:
        """Return the drawing as a PNG file."""
        stream = BytesIO()
        self.draw().savefig(stream, format="png", dpi=110)
        return stream.getvalue()


class StoredFigure(Figure):
    """Drawing that was made before; `draw` returns its PNG file."""

    def png(self) -> bytes:
        """Return the drawing as a PNG file."""
        return bytes(self.draw())


@dataclass(frozen=True)
class Report:
    """Report of a calibration or a rehearsal."""

    title: str
    verdict: str
    reason: str  # one line
    tables: Sequence[Table]  # the most important ones
    origin: str
    figures: Sequence[Figure] = ()
    details: Sequence[Table] = ()
    texts: Mapping[str, str] = field(default_factory=dict)  # by title, shown unchanged
    below: Sequence[str] = ()  # lines below the verdict: date of the data, next step
    html: str = ""  # shown unchanged above the figures


def console(width: int = CONSOLE_WIDTH) -> "Console":
    """Return the console for reports, of a fixed width if it is not a terminal."""
    from rich.console import Console

    terminal = Console()
    return terminal if terminal.is_terminal else Console(width=width)


def printable(report: Report, details: bool = False) -> "Group":
    """Return the verdict, the first table and the next step, or all tables, printable with rich."""
    from rich.console import Group
    from rich.text import Text

    style = VERDICT_STYLES[report.verdict]
    verdict = Text.assemble((_verdict_text(report.verdict), style), f": {report.reason}")
    tables = [*report.tables, *report.details] if details else [report.tables[0].brief]
    notes = [*report.below, *([report.origin] if details else [])]
    title, below = Text(report.title, style="bold"), (Text(line, style="dim") for line in notes)
    return Group(verdict, title, *tables, *below)


def write(folder: str | Path, *reports: Report) -> Path:
    """Write the drawings as PNG, and one self-contained HTML page; return its path."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    parts = []
    for report in reports:
        pictures = {figure.name: figure.png() for figure in report.figures}
        for name, png in pictures.items():
            (folder / f"{name}.png").write_bytes(png)
        parts.append(_section(report, pictures))
    page = folder / "index.html"
    title = ", ".join(report.title for report in reports)
    write_text(page, PAGE.format(title=escape(title), colors=css(), body="\n".join(parts)))
    return page


def _section(report: Report, pictures: Mapping[str, bytes]) -> str:
    parts = [
        f"<h1>{escape(report.title)}</h1>",
        f'<p class="verdict"><span class="{report.verdict}">{_verdict_text(report.verdict)}</span> '
        f"{escape(report.reason)}</p>",
        *(f'<p class="below">{escape(words)}</p>' for words in report.below),
        *map(_table, report.tables),
        report.html,
    ]
    for figure in report.figures:
        data = base64.b64encode(pictures[figure.name]).decode()
        parts.append(
            f"<figure><figcaption>{escape(figure.title)}</figcaption>"
            f'<img alt="{escape(figure.title)}" src="data:image/png;base64,{data}"></figure>'
        )
    parts += map(_table, report.details)
    for title, text in report.texts.items():
        parts.append(
            f"<details><summary>{escape(title)}</summary><pre>{escape(text)}</pre></details>"
        )
    parts.append(f'<p class="origin">{escape(report.origin)}</p>')
    return "<section>\n" + "\n".join(parts) + "\n</section>"


def _table(table: Table) -> str:
    def row(cells: Sequence[str], tag: str, mark: str = "") -> str:
        inner = ""
        for k, cell in enumerate(cells):
            kind = "word" if k < table.words else "number"
            kind = f"{kind} {CELL_CLASSES.get(cell, '')}".strip()
            inner += f'<{tag} class="{kind}">{_symbols(escape(cell))}</{tag}>'
        return f"<tr{mark}>{inner}</tr>"

    rows = "\n".join(
        row(cells, "td", ' class="weak"' * (k in table.weak)) for k, cells in enumerate(table.rows)
    )
    note = f"<p>{escape(table.note)}</p>" if table.note else ""
    return (
        f"<h2>{escape(table.title)}</h2>{note}\n"
        f"<div><table><thead>{row(table.head, 'th')}</thead>\n"
        f"<tbody>{rows}</tbody></table></div>"
    )


#: Symbol with an index, e.g. theta_0_2, theta_E, b_2 or x_BJ1; or a power, e.g. in kg m^2.
SYMBOL = re.compile(r"\b(theta|[a-zA-Z])_(BJ1|0_\d+|\d+|[ijkE])\b|(?<=[a-z])\^(-?\d)\b")


def _symbols(text: str) -> str:
    """Format the symbols in HTML with italics, subscripts and powers."""

    def format_symbol(found: re.Match[str]) -> str:
        letter, index, power = found.groups()
        if power:
            return f"<sup>{power}</sup>"
        letter = "&theta;" if letter == "theta" else letter
        return f"<i>{letter}</i><sub>{index.replace('_', ',')}</sub>"

    return SYMBOL.sub(format_symbol, text)


#: CSS classes of table cells that show a problem: red, or amber if it is weak.
CELL_CLASSES = {"fail": "bad", "NO": "bad", "not evaluated": "weak"}


def _verdict_text(verdict: str) -> str:
    return verdict.replace("_", " ")


PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>{title}</title>
<style>
{colors}body {{ font: 15px/1.5 system-ui, sans-serif; color: var(--text); max-width: 70rem;
       margin: 2rem auto; padding: 0 1rem; }}
h1 {{ font-size: 1.6rem; margin: 0; }}
h2 {{ font-size: 1.1rem; margin: 2rem 0 0.5rem; }}
div {{ overflow-x: auto; }}
table {{ font-size: 0.9rem; border-collapse: collapse; font-variant-numeric: tabular-nums; }}
th, td {{ padding: 0.15rem 0.8rem 0.15rem 0; border-bottom: 1px solid var(--grid);
       text-align: left; }}
th {{ font-weight: 600; border-bottom-color: var(--rule); }}
.number {{ text-align: right; white-space: nowrap; }}
th.number {{ white-space: normal; vertical-align: bottom; }}
.word {{ vertical-align: top; }}
.verdict {{ font-size: 1.15rem; margin: 0.8rem 0 0.3rem; }}
.verdict span {{ padding: 0.2rem 0.8rem; border-radius: 0.2rem; color: white; font-weight: 600;
       font-size: 1.6rem; text-transform: uppercase; }}
.below {{ margin: 0.2rem 0; font-weight: 600; }}
.bad {{ color: var(--danger); font-weight: 600; }}
.weak {{ color: var(--attention); font-weight: 600; }}
.pass {{ background: var(--good); }}
.fail {{ background: var(--danger); }}
.not_evaluated {{ background: var(--attention); }}
sub, sup {{ line-height: 0; }}
figure {{ margin: 2rem 0 0; break-inside: avoid; }}
figcaption {{ font-weight: 600; font-size: 1.1rem; }}
img {{ max-width: 100%; }}
pre {{ background: #f5f5f5; padding: 0.8rem; overflow-x: auto; font-size: 13px; }}
.origin {{ color: var(--muted); overflow-wrap: anywhere; }}
section + section {{ margin-top: 4rem; }}
</style>
</head>
<body>
{body}
</body>
</html>
"""
