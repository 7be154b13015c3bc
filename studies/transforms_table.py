"""The table of docs/theory.md from the results of studies/transforms.py.

    python studies/transforms_table.py [--json runs/reference/transforms.json] [--docs PATH]

Without --docs it only prints the table.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from edtorch.report.tables import Table, as_markdown

MARK = "<!-- transforms table -->"


def markdown(results: dict[str, Any]) -> str:
    """A row per dimension and transform."""
    header = "n|transform|mean|covariance|reward|value|value, ratio of medians|cost".split("|")
    rows: list[tuple[str, ...]] = []
    for n, result in results.items():
        for name, row in result["transforms"].items():
            if name == "first":
                continue
            gains = (f"{row['gain'][q]:.3g}" for q in ("mean", "cov", "reward", "value"))
            ratio, cost = row["ratio_of_medians"]["value"], row["cost"]
            rows.append((n, f"`{name}`", *gains, f"{ratio:.3g}", f"{cost:.2f}"))
    ratios = ", ".join(
        f"{result['indicator_ratio']['median']:.2f} (n = {n})" for n, result in results.items()
    )
    note = f"Value error estimate over true value error of `first`, median: {ratios}."
    return as_markdown(Table("", tuple(header), tuple(rows), note))


def main() -> None:
    parser = argparse.ArgumentParser(description="The table of docs/theory.md.")
    parser.add_argument("--json", type=Path, default=Path("runs/reference/transforms.json"))
    parser.add_argument("--docs", type=Path)
    options = parser.parse_args()
    content = json.loads(options.json.read_text(encoding="utf-8"))
    made = f"Made by `{content['command']}`, torch {content['torch']}."
    table = f"{markdown(content['results'])}\n\n{made}"
    print(table)
    if options.docs is not None:
        before, _, after = options.docs.read_text(encoding="utf-8").split(MARK)
        text = f"{before}{MARK}\n{table}\n{MARK}{after}"
        options.docs.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
