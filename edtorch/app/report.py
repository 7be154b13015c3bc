"""``edtorch-report``: tables, figures and pages of finished runs."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from edtorch.app.domain import build_sim
from edtorch.app.errors import ConfigError
from edtorch.app.rundir import command_line, git_commit, json_text, versions
from edtorch.app.schema import defaults
from edtorch.app.settings import Settings
from edtorch.report import samples
from edtorch.report.canvas import WIDE
from edtorch.report.comparison import Comparison, as_json, compare_all
from edtorch.report.document import Document, document, overview
from edtorch.report.domain import Domain, domain_of
from edtorch.report.figures import save_figure
from edtorch.report.groups import BaselineUnknown, sections
from edtorch.report.html import html
from edtorch.report.markdown import markdown
from edtorch.report.runs import LeftOut, load_all
from edtorch.report.sweep import SweepTable, sweeps_in
from edtorch.report.sweep_document import sweep_json, sweep_part
from edtorch.report.tables import as_text
from edtorch.run.files import write_text

NUMBERS, PAGE, TEXT = "report.json", "report.html", "report.md"
KINDS = (".png", ".svg")


class Refusal(Exception):
    """The one line for the user."""


def known_domain(settings: Mapping[str, Any]) -> Domain | None:
    """That of a run whose summary does not describe it, as its sim declares it today; only of the
    sims that edtorch comes with, since a report runs no foreign code."""
    if not str(settings["domain._target_"]).startswith("sims."):
        return None
    config: dict[str, Any] = {}
    for key, value in settings.items():
        if key.startswith("domain."):
            *above, name = key.removeprefix("domain.").split(".")
            node = config
            for group in above:
                node = node.setdefault(group, {})
            node[name] = value
    try:
        return domain_of(build_sim(Settings(config)).spec)
    except ConfigError:
        return None


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="edtorch-report",
        description="Tables, figures and a page of finished runs: statistics over their seeds.",
    )
    parser.add_argument(
        "folders",
        metavar="FOLDER",
        nargs="+",
        type=Path,
        help="a run, or a folder with runs at any depth, such as a sweep",
    )
    parser.add_argument(
        "--output",
        metavar="DIR",
        type=Path,
        default=Path("report"),
        help="where the report goes (default: report); a former report is replaced",
    )
    parser.add_argument(
        "--baseline",
        metavar="NAME",
        help="label or folder of the runs that the others are compared with (default: the first)",
    )
    parser.add_argument(
        "--labels",
        choices=("settings", "folders"),
        default="settings",
        help="call runs by the settings in which they differ, or by their folders",
    )
    parser.add_argument("--title", default="Learning to control", help="heading of the report")
    return parser


def _check_output(output: Path) -> None:
    """Refuse a place that holds anything but a former report."""
    if not output.exists():
        return
    if not output.is_dir():
        raise Refusal(f"--output={output}: expected a folder, but it is a file")
    names = {path.name for path in output.iterdir()}
    if not names:
        return
    try:
        former = json.loads((output / NUMBERS).read_text(encoding="utf-8"))["files"]
    except (OSError, ValueError, KeyError, TypeError):
        former = []
    foreign = sorted(names.difference(map(str, former)))
    if foreign:
        raise Refusal(
            f"--output={output}: expected a new folder or a former report, but it holds"
            f" {foreign[0]}, which is not of a report"
        )


def _write(output: Path, page: Document, numbers: dict[str, Any]) -> None:
    """All of it or nothing: made beside its place, then moved there."""
    output.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{output.name}.", dir=output.parent) as name:
        fresh, former = Path(name) / "new", Path(name) / "former"
        fresh.mkdir()
        for part in page.parts:
            for chart in part.charts:
                save_figure(chart.draw(WIDE), fresh, chart.name)
        write_text(fresh / TEXT, markdown(page))
        write_text(fresh / PAGE, html(page))
        files = sorted([NUMBERS, *(path.name for path in fresh.iterdir())])
        write_text(fresh / NUMBERS, json_text({**numbers, "files": files}))
        if output.exists():
            output.rename(former)
        try:
            fresh.rename(output)
        except OSError:
            if former.exists():
                former.rename(output)
            raise


def _numbers(
    comparisons: Sequence[Comparison], left_out: Sequence[LeftOut], sweeps: Sequence[SweepTable]
) -> dict[str, Any]:
    """The content of ``report.json``, but for the names of its files."""
    return {
        "command": command_line(),
        "versions": versions(),
        "git": git_commit(),
        "bootstrap": {"resamples": samples.RESAMPLES, "seed": samples.SEED, "confidence": 0.95},
        "sections": [as_json(comparison) for comparison in comparisons],
        "sweeps": [sweep_json(sweep, comparisons) for sweep in sweeps],
        "left_out": [{"folder": str(item.path), "why": item.why} for item in left_out],
    }


def _run(options: argparse.Namespace) -> None:
    for folder in options.folders:
        if not folder.is_dir():
            state = "is a file" if folder.exists() else "does not exist"
            raise Refusal(f"{folder}: expected a folder with runs, but it {state}")
    _check_output(options.output)
    runs, left_out = load_all(options.folders, known_domain)
    sweeps, unreadable = sweeps_in(options.folders)
    left_out += unreadable
    for item in left_out:
        print(f"edtorch-report: left out {item.path}: {item.why}", file=sys.stderr)
    if not runs:
        given = ", ".join(map(str, options.folders))
        raise Refusal(f"{given}: expected at least one finished run, found none")
    try:
        found, repeated = sections(
            runs, defaults, baseline=options.baseline, by_folder=options.labels == "folders"
        )
    except BaselineUnknown as error:
        raise Refusal(f"--{error}") from error
    for item in repeated:
        print(f"edtorch-report: {item.path}: {item.why}", file=sys.stderr)
    left_out += repeated
    comparisons = compare_all(found)
    made = f"Made by edtorch {versions()['edtorch']}: {command_line()}"
    parts = [sweep_part(sweep, comparisons) for sweep in sweeps]
    page = document(comparisons, left_out, options.title, made, parts)
    _write(options.output, page, _numbers(comparisons, left_out, sweeps))
    for table in (table for part in parts for table in part.tables):
        print(as_text(table), end="\n\n")
    for comparison in comparisons:
        print(as_text(overview(comparison)), end="\n\n")
    print(f"report: {options.output / PAGE}")


def main() -> None:
    """Entry point of ``edtorch-report``."""
    options = _parser().parse_args()
    try:
        _run(options)
    except Refusal as error:
        print(f"edtorch-report: {error}", file=sys.stderr)
        sys.exit(1)
    except OSError as error:
        print(f"edtorch-report: {error.filename}: {error.strerror}", file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt:
        print("edtorch-report: interrupted", file=sys.stderr)
        sys.exit(130)
    sys.exit(0)


if __name__ == "__main__":
    main()
