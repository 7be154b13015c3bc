"""The page in headless Chromium: on a screen and on a phone, light and dark, without a network.

``make test-browser`` runs these, and says what to install where there is no Chromium.
"""

from __future__ import annotations

import html as escapes
import json
import os
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from edtorch.report.comparison import compare_all
from edtorch.report.document import document
from edtorch.report.groups import sections
from edtorch.report.html import html
from edtorch.report.runs import LeftOut, load_all

pytestmark = pytest.mark.browser

REFERENCE = Path(__file__).parents[2] / "runs" / "reference"
PHONE, SCREEN = 360, 1280
CHROMIUM = ("chromium", "chromium-browser", "google-chrome")
QUIET = (
    "--headless",
    "--no-sandbox",  # continuous integration runs as root
    "--disable-gpu",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
    "--hide-scrollbars",
    "--allow-file-access-from-files",  # so that a page may look into its frames
    "--host-resolver-rules=MAP * ~NOTFOUND",  # no network
)
DARK = {"light": (), "dark": ("--blink-settings=preferredColorScheme=0",)}
# Chromium has no window as narrow as a phone, but a frame can be one.
FRAMES = f"""<!DOCTYPE html><meta charset="utf-8"><body>
<iframe id="phone" src="report.html" style="width:{PHONE}px;height:900px;border:0"></iframe>
<iframe id="screen" src="report.html" style="width:{SCREEN}px;height:900px;border:0"></iframe>
<pre id="found"></pre>
<script>
addEventListener("load", () => {{
  const look = name => {{
    const w = document.getElementById(name).contentWindow, d = w.document;
    const shown = e => e.getClientRects().length > 0;
    const style = s => w.getComputedStyle(d.querySelector(s));
    const charts = [...d.querySelectorAll("figure svg")].filter(shown);
    const text = [...d.querySelectorAll("figure svg text")].filter(shown);
    return {{
      inner: w.innerWidth, scroll: d.documentElement.scrollWidth,
      outside: [...d.querySelectorAll("section *")].filter(shown)
        .filter(e => !e.closest(".scroll, svg"))
        .filter(e => e.getBoundingClientRect().right > w.innerWidth + 1)
        .map(e => e.tagName),
      paper: style("body").backgroundColor, ink: style("body").color,
      quiet: style("figcaption").color, heads: shown(d.querySelector("thead")),
      charts: charts.length, figures: d.querySelectorAll("figure").length,
      chart_ink: [...new Set(text.map(e => w.getComputedStyle(e).fill))],
      smallest: Math.min(...text.map(e => e.getBoundingClientRect().height)),
      label: w.getComputedStyle(d.querySelector("td"), "::before").content,
      fetched: w.performance.getEntriesByType("resource").map(e => e.name),
    }};
  }};
  document.getElementById("found").textContent =
    JSON.stringify({{phone: look("phone"), screen: look("screen")}});
}});
</script></body>"""


@pytest.fixture(scope="module")
def browser() -> str:
    named = os.environ.get("CHROMIUM")
    found = named or next((path for name in CHROMIUM if (path := shutil.which(name))), None)
    if found is None:
        pytest.fail("no Chromium: make browser installs it, CHROMIUM=PATH names one")
    return found


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With a page of committed results: long labels, censored learners, an arm, searches."""
    folder = tmp_path_factory.mktemp("page")
    cells = [f"transforms_bicycle/first_{name}" for name in ("residual", "start_belief_bayesian")]
    names = ["bicycle", "bicycle_paper", *cells, "cardea/learned", "cardea/none", "footnote1"]
    runs, _ = load_all([REFERENCE / name for name in names])
    found, _ = sections(runs, lambda _: {}, baseline=None, by_folder=False)
    left_out = [LeftOut(Path("runs/" + "long" * 30), "unfinished: it has no summary.json")]
    page = document(compare_all(found), left_out, "Reference", "Made by a test")
    (folder / "report.html").write_text(html(page), encoding="utf-8")
    (folder / "frames.html").write_text(FRAMES, encoding="utf-8")
    return folder


def _chromium(browser: str, folder: Path, scheme: str, *arguments: str) -> str:
    profile = folder / f"profile_{scheme}"
    command = [browser, *QUIET, *DARK[scheme], f"--user-data-dir={profile}", *arguments]
    result = subprocess.run(command, capture_output=True, text=True, timeout=240)
    assert result.returncode == 0, result.stderr
    return result.stdout


@pytest.fixture(scope="module", params=list(DARK))
def scheme(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(scope="module")
def seen(browser: str, folder: Path, scheme: str) -> dict[str, Any]:
    """What a phone and a screen make of the page."""
    address = (folder / "frames.html").as_uri()
    content = _chromium(browser, folder, scheme, "--dump-dom", address)
    found = re.search(r'<pre id="found">(.+?)</pre>', content, re.DOTALL)
    assert found is not None, content[-2000:]
    return json.loads(escapes.unescape(found[1]))


def _luminance(colour: str) -> float:
    """Relative, of ``rgb(r, g, b)``: WCAG 2."""
    parts = [int(v) / 255 for v in re.findall(r"\d+", colour)[:3]]
    linear = [v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def _contrast(one: str, other: str) -> float:
    low, high = sorted((_luminance(one), _luminance(other)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("device", ["phone", "screen"])
class TestPage:
    def test_nothing_sticks_out(self, seen: dict[str, Any], device: str) -> None:
        """A page is never wider than the screen, though a table on it may scroll."""
        width = {"phone": PHONE, "screen": SCREEN}[device]
        assert seen[device]["inner"] == width
        assert seen[device]["scroll"] <= width
        assert seen[device]["outside"] == []

    def test_is_light_or_dark_as_the_reader_wants(
        self, seen: dict[str, Any], scheme: str, device: str
    ) -> None:
        paper = _luminance(seen[device]["paper"])
        assert paper < 0.02 if scheme == "dark" else paper > 0.95

    def test_can_be_read(self, seen: dict[str, Any], device: str) -> None:
        """Contrast 4.5 to 1 at least, as WCAG 2 wants it of text; in the charts too."""
        colours = [seen[device]["ink"], seen[device]["quiet"], *seen[device]["chart_ink"]]
        assert len(colours) > 2
        for colour in colours:
            assert _contrast(colour, seen[device]["paper"]) >= 4.5, colour
        assert seen[device]["smallest"] >= 7

    def test_every_figure_shows_the_chart_of_its_width(
        self, seen: dict[str, Any], device: str
    ) -> None:
        assert seen[device]["charts"] == seen[device]["figures"] > 0

    def test_tables_become_cards_on_a_phone(self, seen: dict[str, Any], device: str) -> None:
        assert seen[device]["heads"] == (device == "screen")
        assert (seen[device]["label"] == '"seeds"') == (device == "phone")

    def test_fetches_nothing(self, seen: dict[str, Any], device: str) -> None:
        assert seen[device]["fetched"] == []


def test_screenshot(browser: str, folder: Path, scheme: str) -> None:
    """There is something to see: paper for the most part, and enough that is not."""
    shot = folder / f"{scheme}.png"
    size = f"--window-size={SCREEN},1600"
    address = (folder / "report.html").as_uri()
    _chromium(browser, folder, scheme, size, f"--screenshot={shot}", address)
    with Image.open(shot) as picture:
        pixels = np.asarray(picture.convert("L"), dtype=float) / 255
    paper = 0.09 if scheme == "dark" else 1.0
    written = np.abs(pixels - paper) > 0.2
    assert 0.01 < written.mean() < 0.3
