"""A report as Markdown, with its charts as files beside it."""

from __future__ import annotations

from edtorch.report.document import Document
from edtorch.report.tables import as_markdown


def markdown(document: Document) -> str:
    """The whole page."""
    blocks = [f"# {document.title}"]
    for part in document.parts:
        blocks.append(f"## {part.heading}")
        blocks += part.paragraphs
        blocks += [f"![{chart.title}]({chart.name}.png)" for chart in part.charts]
        for table in (*part.tables, *part.folded):
            title = [] if table.title == part.heading else [f"### {table.title}"]
            blocks += [*title, as_markdown(table)]
    blocks.append(document.made)
    return "\n\n".join(blocks) + "\n"
