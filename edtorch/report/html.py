"""A report as one HTML file that needs no other file and no network.

Charts are inline SVG, each drawn twice: for a page and for a phone, where a shrunken page could not
be read.  Ink and background are the reader's, light or dark.
"""

from __future__ import annotations

import re
from html import escape
from io import StringIO

import matplotlib

from edtorch.report.canvas import INK, NARROW, PAPER, WIDE, Chart
from edtorch.report.document import Document, Part
from edtorch.report.tables import Table

STYLE = """
:root { color-scheme: light dark; --ink: #222222; --paper: #ffffff; --soft: #f3f4f6;
  --line: #d5d8dc; --quiet: #5c6370; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e6e6e6; --paper: #15181c; --soft: #1f2329; --line: #3a4049; --quiet: #a0a7b2; } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1rem clamp(.75rem, 3vw, 2rem) 3rem; max-width: 76rem;
  color: var(--ink); background: var(--paper);
  font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif;
  overflow-wrap: anywhere; }
h1 { font-size: 1.5rem; line-height: 1.25; } h2 { font-size: 1.2rem; margin-top: 2.2rem; }
h3 { font-size: 1rem; margin: 1.6rem 0 .4rem; }
nav a { margin-right: 1rem; } a { color: inherit; }
figure { margin: 1rem 0; } figcaption, .note, footer { color: var(--quiet); font-size: .875rem; }
figure svg { width: 100%; height: auto; display: block; }
.narrow { display: none; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: .875rem; font-variant-numeric: tabular-nums; }
th, td { padding: .35rem .7rem; text-align: left; vertical-align: top;
  border-bottom: 1px solid var(--line); overflow-wrap: normal; }
thead th { background: var(--soft); } tbody th { font-weight: 600; min-width: 8rem; }
small { display: block; white-space: nowrap; color: var(--quiet); }
details { margin: .8rem 0; } summary { cursor: pointer; }
@media (max-width: 640px) {
  .wide { display: none; } .narrow { display: block; }
  .scroll { overflow-x: visible; }
  table, tbody, tr, th, td { display: block; width: 100%; }
  thead { display: none; }
  tbody tr { border: 1px solid var(--line); border-radius: .4rem; margin: 0 0 .8rem; }
  tbody th { background: var(--soft); }
  td, th { overflow-wrap: anywhere; } small { white-space: normal; }
  td { display: grid; grid-template-columns: 9rem 1fr; gap: .6rem; }
  td::before { content: attr(data-label); color: var(--quiet); }
  tr > :last-child { border-bottom: 0; } }
"""


def html(document: Document) -> str:
    """The whole page."""
    names = [f"part{k}" for k in range(len(document.parts))]
    links = "".join(
        f'<a href="#{name}">{escape(part.heading)}</a> '
        for name, part in zip(names, document.parts, strict=True)
    )
    parts = "\n".join(_part(p, n) for p, n in zip(document.parts, names, strict=True))
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        # Without this line a browser asks the network for an icon.
        '<link rel="icon" href="data:,">\n'
        f"<title>{escape(document.title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n"
        f"<h1>{escape(document.title)}</h1>\n<nav>{links}</nav>\n{parts}\n"
        f"<footer>{escape(document.made)}</footer>\n</body>\n</html>\n"
    )


def _part(part: Part, name: str) -> str:
    blocks = [f'<section id="{name}">\n<h2>{escape(part.heading)}</h2>']
    blocks += [f"<p>{escape(text)}</p>" for text in part.paragraphs]
    blocks += [_figure(chart) for chart in part.charts]
    for table in part.tables:
        title = "" if table.title == part.heading else f"<h3>{escape(table.title)}</h3>\n"
        blocks.append(title + _table(table))
    for table in part.folded:
        blocks.append(
            f"<details><summary>{escape(table.title)}</summary>\n{_table(table)}</details>"
        )
    return "\n".join([*blocks, "</section>"])


def _table(table: Table) -> str:
    head = "".join(f'<th scope="col">{escape(cell)}</th>' for cell in table.header)
    rows: list[str] = []
    for row in table.rows:
        cells = [f'<th scope="row">{escape(row[0])}</th>']
        cells += [
            f'<td data-label="{escape(label)}"><span>{_cell(cell)}</span></td>'
            for label, cell in zip(table.header[1:], row[1:], strict=True)
        ]
        rows.append(f"<tr>{''.join(cells)}</tr>")
    note = f'<p class="note">{escape(table.note)}</p>\n' if table.note else ""
    body = "\n".join(rows)
    return (
        f'<div class="scroll"><table>\n<thead><tr>{head}</tr></thead>\n'
        f"<tbody>\n{body}\n</tbody>\n</table></div>\n{note}"
    )


def _cell(text: str) -> str:
    """The estimate, and on a line of its own its interval."""
    estimate, bracket, rest = text.partition(" [")
    interval = f" <small>[{escape(rest)}</small>" if bracket else ""
    return f"{escape(estimate)}{interval}"


def _figure(chart: Chart) -> str:
    drawn = [
        f'<div class="{kind}">{inline_svg(chart, width, kind)}</div>'
        for kind, width in (("wide", WIDE), ("narrow", NARROW))
    ]
    return f"<figure>{''.join(drawn)}\n<figcaption>{escape(chart.title)}</figcaption></figure>"


def inline_svg(chart: Chart, width: float, kind: str) -> str:
    """The chart as an element of a page, in the page's ink, on its background.

    Names inside it are its own: a page has several, and a hidden one must not lend its parts.
    """
    buffer = StringIO()
    prefix = f"{chart.name}_{kind}_"
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": prefix}):
        chart.draw(width).savefig(
            buffer, format="svg", transparent=True, metadata={"Date": None, "Creator": None}
        )
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'\bid="', f'id="{prefix}', text)
    text = re.sub(r'(href="|url\()#', rf"\1#{prefix}", text)
    text = text.replace(INK, "var(--ink)").replace(PAPER, "var(--paper)")
    label = f'role="img" aria-label="{escape(chart.title)}" '
    return text.replace("<svg ", f"<svg {label}", 1).strip()
