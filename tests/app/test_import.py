"""edtorch-import from end to end, and what a user can get wrong."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

Command = Callable[..., Any]

DESCRIBED = (
    "--domain=pendulum",
    "--dt=0.01",
    "--state=angle[rad]=theta[deg]",
    "--action=torque[N m]=u",
    "--time=t[ms]",
)


@pytest.fixture
def log(workplace: Path) -> Path:
    path = workplace / "log.csv"
    path.write_text("t,theta,u\n0,180,1\n10,90,2\n20,0,3\n30,,4\n")
    return path


def test_a_described_domain(command: Command, log: Path) -> None:
    found = command("edtorch-import", "log.csv", "out.npz", *DESCRIBED)
    assert found.status == 0, found.err
    assert found.out.splitlines() == [
        "out.npz: 2 transitions in 1 episodes",
        "of 4 rows in log.csv; dropped: 2",
        "  1: the last line of an episode: no next state",
        "  1: a number that is not finite",
        "time steps: 0.01 to 0.01 s, median 0.01; the domain's: 0.01",
    ]
    with np.load("out.npz") as file:
        meta = json.loads(str(file["meta"]))
        np.testing.assert_allclose(file["state"], [[np.pi], [np.pi / 2]])
    assert (meta["domain"], meta["source"]) == ("pendulum", "log.csv")
    assert meta["state"] == [{"name": "angle", "unit": "rad"}]
    assert sum(meta["dropped"].values()) == 2
    again = command("edtorch-import", "log.csv", "out.npz", *DESCRIBED)
    assert again.status == 1
    assert again.line.startswith("edtorch-import: out.npz: exists already")


def test_columns_from_a_file_and_a_configured_domain(command: Command, log: Path) -> None:
    """The command line comes before the file."""
    Path("columns.yaml").write_text(
        "state: ['state_0=theta', 'state_1=t']\naction: ['action_0=u']\ntime: t[ms]\ngap: 100\n"
    )
    found = command(
        "edtorch-import", "log.csv", "out.npz", "domain=linear", "--columns=columns.yaml",
        "domain.state_matrix=[[1,0],[0,1]]", "domain.action_matrix=[[0],[1]]", "domain.dt=5",
        "--time=t[s]",
    )  # fmt: skip
    assert found.status == 0, found.err
    with np.load("out.npz") as file:
        assert file["dt"].tolist() == [10.0, 10.0]
        assert file["state"].tolist() == [[180, 0], [90, 10]]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--dt=0.01"], "expected a domain: domain=..., as for edtorch-train, or --domain=NAME"),
        (["--domain=a", "--dt=0", "--state=x", "--action=u"], "--dt=0.0: expected a finite number"),
        (["--domain=a", "--dt=1", "--state=x[", "--action=u"], "'x[': expected NAME[UNIT]=COLUMN"),
        (["--domain=a", "--dt=1", "--state=x"], "--action=[]: expected one name or more"),
        (["domain=bicycle", "--dt=1"], "--dt=1.0: expected none beside domain=bicycle"),
        (["domain=bicycl"], "domain=bicycl: expected one of"),
        (["--columns=odd.yaml"], "odd.yaml: tiem: unknown key; did you mean time?"),
        (["--columns=kind.yaml"], "kind.yaml: dt=fast: expected a number"),
        (["--columns=none.yaml"], "--columns=none.yaml: expected YAML"),
        ([*DESCRIBED, "--episode=run"], "log.csv: column 'run' is not in the header"),
    ],
)
def test_what_is_wrong_is_one_line(
    command: Command, log: Path, arguments: list[str], message: str
) -> None:
    Path("odd.yaml").write_text("tiem: t\n")
    Path("kind.yaml").write_text("dt: fast\n")
    before = set(log.parent.iterdir())
    found = command("edtorch-import", "log.csv", "out.npz", *arguments)
    assert found.status == 1
    assert found.line.startswith(f"edtorch-import: {message}"), found.line
    assert set(log.parent.iterdir()) == before


def test_a_place_that_cannot_be_written_to(command: Command, log: Path) -> None:
    found = command("edtorch-import", "log.csv", "none/out.npz", *DESCRIBED)
    assert found.line == "edtorch-import: none/out.npz: expected a folder none to write to"
    found = command("edtorch-import", "log.txt", "out.npz", *DESCRIBED)
    assert found.line.startswith("edtorch-import: log.txt: expected a name that ends in one of")
    found = command("edtorch-import", "log2.csv", "out.npz", *DESCRIBED)
    assert found.line == "edtorch-import: log2.csv: no such file"
