"""What a report says, as text, Markdown and HTML."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure

from edtorch.report.canvas import INK, NARROW, WIDE, Chart
from edtorch.report.charts import charts, steps
from edtorch.report.comparison import compare_all
from edtorch.report.document import Document, document, number, percent, ranges
from edtorch.report.domain import domain_of
from edtorch.report.groups import sections
from edtorch.report.html import html, inline_svg
from edtorch.report.markdown import markdown
from edtorch.report.runs import LeftOut, load_all
from edtorch.report.samples import Sample
from edtorch.report.tables import Table, as_markdown, as_text
from sims.bicycle import Bicycle
from tests.report.folders import learners, search, spread

LEFT_OUT = [LeftOut(Path("odd <run>"), "unfinished")]


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Document:
    """With a bit of everything: censored learners, a family of tasks, searches."""
    folder = tmp_path_factory.mktemp("runs")
    learners(folder / "paper", [30, 20, 25, 31])
    learners(folder / "ours", [0, 0, 1, 0], train={"belief": True})
    learners(folder / "lost", [9, 9, 2, 1], never=[0, 1], train={"belief": False})
    figures = [
        {"minutes": m, "crash_rate": spread([1 / m] * 3), "success_rate": spread([1 - 1 / m] * 3)}
        for m in (1.0, 2.0, 4.0)
    ]
    more = {"evaluations": figures, "final": figures[-1]}
    learners(folder / "x_arm", [3, 2, 1], domain="sims.cardea.Cardea", more=more)
    search(folder / "y_search", 3, 1000)
    search(folder / "z_wider", 9, 1000, rival={"high": 3})
    bicycle = domain_of(Bicycle().spec)
    runs, _ = load_all([folder], lambda s: bicycle if "bicycle" in s["domain._target_"] else None)
    found, _ = sections(runs, lambda _: {}, baseline="paper", by_folder=False)
    return document(compare_all(found), LEFT_OUT, "A & B", "made by hand")


def _tables(page: Document) -> list[Table]:
    return [table for part in page.parts for table in (*part.tables, *part.folded)]


def _charts(page: Document) -> list[Chart]:
    return [chart for part in page.parts for chart in part.charts]


def _texts(figure: Figure) -> str:
    words = [text.get_text() for axes in figure.axes for text in axes.texts]
    for axes in figure.axes:
        words += [axes.get_xlabel(), axes.get_title()]
        words += [label.get_text() for label in axes.get_yticklabels()]
        if (legend := axes.get_legend()) is not None:
            words += [text.get_text() for text in legend.get_texts()]
    return "\n".join(words)


class TestContent:
    def test_overview(self, page: Document) -> None:
        table = _tables(page)[0]
        cells = dict(zip(table.header, table.rows[0], strict=True))
        assert (cells["seeds"], cells["rode"]) == ("4", "4")
        assert cells["share that reaches the goal"].startswith("1 [1, 1]")
        text = as_text(table)
        assert text.startswith("Bicycle: learners, overview\ngroup ")
        paper, lost, ours = text.splitlines()[3:6]
        assert "27.5 [20, 31]" in paper
        assert "train.belief=true" in ours
        assert "75.0 % [30.1, 95.4]" in ours
        assert "KM > 5.5 (2 of 4 censored)" in lost

    def test_what_was_left_out_is_in_it(self, page: Document) -> None:
        assert page.parts[-1].tables[0].rows == (("odd <run>", "unfinished"),)

    def test_every_section_shows_its_figures(self, page: Document) -> None:
        names = [chart.name for chart in _charts(page)]
        assert names == [
            "bicycle_learners_intervals",
            "bicycle_learners_seeds",
            "cardea_learners_intervals",
            "cardea_learners_seeds",
            "cardea_learners_progress",
            "bicycle_searches_intervals",
        ]

    @pytest.mark.parametrize("width", [WIDE, NARROW])
    def test_groups_are_named_in_the_figures(self, page: Document, width: float) -> None:
        for chart in _charts(page)[:2]:
            text = _texts(chart.draw(width))
            assert all(word in text for word in ("paper", "train.belief=true", "falls before"))
        assert "(2 of 4 censored)" in _texts(_charts(page)[1].draw(width))

    def test_a_page_of_one_run(self, tmp_path: Path) -> None:
        learners(tmp_path / "only", [0])
        found, _ = sections(load_all([tmp_path])[0], lambda _: {}, baseline=None, by_folder=False)
        alone = document(compare_all(found), [], "One", "made")
        assert [part.heading for part in alone.parts] == ["Bicycle: learners", "How to read this"]
        for chart in charts(compare_all(found)[0]):
            chart.draw(NARROW)


def test_steps_are_the_empirical_distribution() -> None:
    values, shares = steps(Sample.of([3.0, 1.0, 2.0, 2.0]))
    assert values.tolist() == [1, 1, 2, 2, 3]
    assert shares == pytest.approx(np.array([0, 0.25, 0.5, 0.75, 1]))


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [(5.0, 1, "5"), (5.25, 1, "5.2"), (1007, 1, "1,007"), (0.00012, 3, "0.00012"), (0, 2, "0")],
)
def test_number(value: float, digits: int, text: str) -> None:
    assert number(value, digits) == text


def test_a_share_has_the_digits_of_its_size() -> None:
    assert percent(0.999, 1000) == "99.90"
    assert percent(0.00285, 100_000) == "0.2850"
    assert percent(0.5, 20) == "50.0"


def test_ranges() -> None:
    assert ranges([3, 0, 1, 2, 7, 9, 8]) == "0-3, 7-9"


class TestTables:
    TABLE = Table("t", ("a", "b"), (("x|y", "1"), ("long name", "22")), "a note")

    def test_text(self) -> None:
        assert as_text(self.TABLE).splitlines() == [
            "t",
            "a           b",
            "-------------",
            "x|y         1",
            "long name  22",
            "a note",
        ]

    def test_markdown(self) -> None:
        assert as_markdown(self.TABLE).splitlines() == [
            "| a | b |",
            "|---|---|",
            "| x\\|y | 1 |",
            "| long name | 22 |",
            "",
            "a note",
        ]

    def test_refuses_a_ragged_one(self) -> None:
        with pytest.raises(ValueError, match="expected 2 cells"):
            Table("t", ("a", "b"), (("x",),))


def test_markdown_has_every_table_and_picture(page: Document) -> None:
    text = markdown(page)
    for table in _tables(page):
        assert as_markdown(table) in text
    for chart in _charts(page):
        assert f"]({chart.name}.png)" in text


class _Elements(HTMLParser):
    """Tags with their attributes, and whether they are closed in order."""

    VOID = ("meta", "link", "br")

    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def text(page: Document) -> str:
    return html(page)


@pytest.fixture(scope="module")
def elements(text: str) -> _Elements:
    parser = _Elements()
    parser.feed(text)
    parser.close()
    return parser


@pytest.mark.oracle
class TestHtml:
    def test_is_well_formed(self, elements: _Elements) -> None:
        assert elements.open == []

    def test_needs_nothing_else(self, text: str, elements: _Elements) -> None:
        """No script, and nothing that is fetched from anywhere."""
        assert "script" not in {tag for tag, _ in elements.found}
        assert "@import" not in text
        for _, attributes in elements.found:
            for name in ("src", "href", "xlink:href", "data", "srcset"):
                value = attributes.get(name)
                assert value is None or value.startswith("#") or value == "data:,"
        assert set(re.findall(r"url\((.)", text)) <= {"#"}

    def test_names_are_of_one_thing_each(self, elements: _Elements) -> None:
        names = [a["id"] for _, a in elements.found if "id" in a]
        assert len(names) == len(set(names))
        wanted = {str(a["xlink:href"])[1:] for _, a in elements.found if "xlink:href" in a}
        assert wanted <= set(names)

    def test_says_what_was_given_and_no_more(self, text: str) -> None:
        assert "A &amp; B" in text
        assert "odd &lt;run&gt;" in text
        assert "<run>" not in text

    def test_charts_are_in_the_ink_of_the_page(self, page: Document) -> None:
        svg = inline_svg(_charts(page)[0], WIDE, "wide")
        root = ElementTree.fromstring(svg)
        assert root.get("aria-label") == "Bicycle: learners: estimates with 95 % intervals"
        assert "var(--ink)" in svg
        assert INK not in svg
        assert "<text" in svg
