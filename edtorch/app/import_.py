"""``edtorch-import``: other people's recorded data into ``transitions.npz``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

from edtorch.app.compose import compose, read_yaml
from edtorch.app.domain import build_sim
from edtorch.app.errors import ConfigError, guarded, refusing, unknown_key
from edtorch.app.rundir import command_line, versions
from edtorch.run.recorded import last_rows
from edtorch.transitions import FileColumn, described_spec, parse_column, read, save_imported
from edtorch.transitions.reading import check_new
from sims.base import Spec

_LISTS = ("state", "action")
_KINDS = {"domain": str, "dt": float, "time": str, "episode": str, "gap": float}
"""What options and keys of the file of columns hold, besides lists of columns."""


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="edtorch-import",
        description="Recorded data of Minari (HDF5), D4RL (HDF5, npz) or CSV as transitions.",
        epilog="A COLUMN is NAME[UNIT]=COLUMN[UNIT], such as 'angle[rad]=theta[deg]'; NAME alone"
        " does where the file's column has that name (CSV) or place (arrays), and that unit.",
    )
    parser.add_argument("data", type=Path, help="a file, or the folder of a Minari data set")
    parser.add_argument("output", type=Path, help="the new file, such as transitions.npz")
    parser.add_argument(
        "overrides",
        metavar="KEY=VALUE",
        nargs="*",
        help="a configured domain, as for edtorch-train: domain=bicycle; instead of --domain, --dt",
    )
    for kind in _LISTS:
        parser.add_argument(
            f"--{kind}", metavar="COLUMN", action="append", help=f"a component of the {kind}"
        )
    parser.add_argument("--domain", metavar="NAME", help="name of a domain that is not configured")
    parser.add_argument("--dt", metavar="S", type=float, help="its time step, seconds")
    parser.add_argument("--time", metavar="COLUMN[UNIT]", help="CSV: time stamps, such as 't[ms]'")
    parser.add_argument("--episode", metavar="COLUMN", help="CSV: each line's episode")
    parser.add_argument(
        "--gap", metavar="S", type=float, help="CSV: a longer step is dropped (5 medians)"
    )
    parser.add_argument(
        "--columns", metavar="FILE", type=Path, help="YAML with these options, without dashes"
    )
    return parser


def _from_file(path: Path) -> dict[str, Any]:
    """The options in a YAML file.  Raises ConfigError."""
    try:
        content = dict(read_yaml(path))
    except ValueError as error:
        raise ConfigError(f"--columns={path}: expected YAML with options ({error})") from error
    for key, value in content.items():
        if key in _LISTS:
            right = isinstance(value, list) and all(isinstance(each, str) for each in value)
            expected = "a list of texts NAME[UNIT]=COLUMN[UNIT]"
        elif key in _KINDS:
            kinds = (int, float) if _KINDS[key] is float else (str,)
            right, expected = type(value) in kinds, "a number" if kinds[0] is int else "a text"
        else:
            raise ConfigError(f"{path}: {unknown_key(key, key, [*_LISTS, *_KINDS])}")
        if not right:
            raise ConfigError(f"{path}: {key}={value}: expected {expected}")
    return content


def _spec(
    options: dict[str, Any], overrides: list[str], columns: dict[str, list[FileColumn]]
) -> Spec:
    """The domain, configured or described."""
    described = [key for key in ("domain", "dt") if options[key] is not None]
    if overrides:
        if described:
            raise ConfigError(
                f"--{described[0]}={options[described[0]]}: expected none beside {overrides[0]}"
            )
        return build_sim(compose(overrides).domain).spec
    if len(described) < 2:
        raise ConfigError(
            "expected a domain: domain=..., as for edtorch-train, or --domain=NAME and --dt=S"
        )
    try:
        return described_spec(options["domain"], options["dt"], **columns)
    except ValueError as error:
        raise ConfigError(f"--{error}") from error


def _run() -> None:
    given = vars(_parser().parse_intermixed_args())
    with refusing():
        data, output = given["data"], given["output"]
        check_new(output)
        options = {key: given[key] for key in (*_LISTS, *_KINDS)}
        if given["columns"] is not None:
            listed = _from_file(given["columns"])
            options |= {key: v for key, v in listed.items() if options[key] is None}
        try:
            columns = {k: [parse_column(each) for each in options[k] or ()] for k in _LISTS}
            time = None if options["time"] is None else parse_column(options["time"])
        except ValueError as error:
            raise ConfigError(str(error)) from error
        spec = _spec(options, given["overrides"], columns)
        found = read(
            data, spec, **columns, time=time, episode=options["episode"], gap=options["gap"]
        )
        about = {"source": str(data), "command": command_line(), "versions": versions()}
        save_imported(output, found, spec, about)
        episodes = int(last_rows(found.recorded.episode).sum())
        print(f"{output}: {len(found.recorded)} transitions in {episodes} episodes")
        print(f"of {found.rows} rows in {data}; dropped: {sum(found.dropped.values())}")
        for reason, count in found.dropped.items():
            print(f"  {count}: {reason}")
        low, middle, high = np.quantile(found.recorded.dt, (0, 0.5, 1))
        print(f"time steps: {low:g} to {high:g} s, median {middle:g}; the domain's: {spec.dt:g}")
        if found.broken:
            print(f"{found.broken} rows do not end where the next row begins: episodes end there")


def main() -> None:
    """Entry point of ``edtorch-import``."""
    sys.exit(guarded("edtorch-import", _run))


if __name__ == "__main__":
    main()
