"""A sweep from its first job to its last: what is checked before, and what is told in the end.

Hydra calls ``SweepCallback`` (named in ``conf/train.yaml``) before the first job.  The end is not
left to a callback: Hydra calls none where the launcher itself fails.
"""

from __future__ import annotations

import re
import sys
import textwrap
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.utils import env_override
from hydra.experimental.callback import Callback
from omegaconf import DictConfig, OmegaConf

from edtorch.app.errors import ConfigError, debugging, refusing
from edtorch.app.folders import SWEEP_RECORD
from edtorch.app.groups import ComputeGroup, SweepGroup
from edtorch.app.launchers import is_of_launcher, left_behind, problem, share_cores
from edtorch.app.schema import checked_fields
from edtorch.app.sweep_names import key_of, significant
from edtorch.app.sweep_record import RECORD, Record, check_folder

if TYPE_CHECKING:
    from edtorch.app.sweep_table import Outcome

_NAME = re.compile(r"\w[\w.-]*")


@dataclass(frozen=True)
class Sweep:
    """What this command sweeps.  folder: absolute; jobs: overrides of those that are known
    beforehand; new: whether the record is of this command; limits: of the threads of jobs."""

    folder: Path
    jobs: tuple[tuple[str, ...], ...]
    new: bool
    limits: ExitStack

    def withdraw(self) -> bool:
        """Take the record back if nothing came of it; whether it is so."""
        names = {path.name for path in self.folder.iterdir()} if self.folder.is_dir() else set()
        if names <= {RECORD, SWEEP_RECORD} and self.new:
            (self.folder / RECORD).unlink(missing_ok=True)
            return True
        return False


class SweepCallback(Callback):
    """Checks a sweep before anything is made, and remembers it."""

    sweep: Sweep | None = None

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Before the folder of a sweep is made.  Raises Refused."""
        with refusing():
            SweepCallback.sweep = _begun(config)


def _begun(config: DictConfig) -> Sweep:
    node: Any = OmegaConf.to_container(config.sweep)
    name = checked_fields(SweepGroup, node, "sweep").name
    threads = checked_fields(ComputeGroup, config.compute, "compute").threads
    folder, overrides = Path(config.hydra.sweep.dir).absolute(), list(config.hydra.overrides.task)
    launcher = config.hydra.launcher
    if found := problem(config.hydra.runtime.choices["hydra/launcher"], launcher._target_):
        raise ConfigError(found)
    jobs = _planned(config, overrides)
    record = Record.of_command()
    if name is None:
        if (folder / RECORD).exists():
            raise ConfigError(
                f"hydra.sweep.dir={config.hydra.sweep.dir}: already holds a sweep; expected a new"
                " folder, or sweep.name=NAME for a sweep that can be repeated"
            )
        known = False
    else:
        if not _NAME.fullmatch(name):
            raise ConfigError(
                f"sweep.name={name}: expected letters, digits, dots, hyphens and underscores"
            )
        known = check_folder(name, folder, record)
    if not known:
        record.write(folder)
    limits = ExitStack()
    limits.enter_context(env_override(dict(share_cores(launcher, threads))))
    return Sweep(folder, jobs, not known, limits)


def _planned(config: DictConfig, overrides: list[str]) -> tuple[tuple[str, ...], ...]:
    """The overrides of the jobs, where Hydra's own sweeper makes them; others decide on the way.

    Raises ConfigError where the name of a sweep is swept.
    """
    loader = GlobalHydra.instance().config_loader()
    parsed = OverridesParser.create(loader).parse_overrides(overrides)
    for override in parsed:
        key = key_of(override.get_key_element())
        if key.partition(".")[0] == "sweep" and override.is_sweep_override():
            raise ConfigError(f"{key}={override.get_value_string()}: expected one value")
    sweeper = config.hydra.sweeper
    if not sweeper._target_.endswith(f".{BasicSweeper.__name__}"):
        return ()
    params = [f"{key}={value}" for key, value in (sweeper.params or {}).items()]
    parsed = OverridesParser.create(loader).parse_overrides([*params, *overrides])
    (jobs,) = BasicSweeper.split_arguments(parsed, None)
    return tuple(tuple(significant(job)) for job in jobs)


@contextmanager
def following(command: str) -> Iterator[None]:
    """Tell what has become of the sweep that was begun in this block, if one was.

    Raises SystemExit where jobs have failed or ended without a result.
    """
    SweepCallback.sweep = None
    try:
        yield
    except KeyboardInterrupt as error:
        for job in left_behind(error):
            job.cancel(check=False)
        if (sweep := _in_progress()) is not None:
            _recorded(sweep)
        raise
    except Exception as error:
        if (sweep := _in_progress()) is None:
            raise
        for job in left_behind(error):
            job.wait()
        line = _told(sweep)
        if debugging() or not is_of_launcher(error):
            raise
        why = textwrap.shorten(str(error).partition("\n")[0], 100)
        stopped = f"the launcher has stopped ({type(error).__name__}: {why})"
        print(f"{command}: {stopped}; {line}", file=sys.stderr)
        raise SystemExit(1) from error
    else:
        if (sweep := _in_progress()) is not None and (line := _told(sweep)):
            print(f"{command}: {line}", file=sys.stderr)
            raise SystemExit(1)
    finally:
        if SweepCallback.sweep is not None:
            SweepCallback.sweep.limits.close()


def _in_progress() -> Sweep | None:
    sweep = SweepCallback.sweep
    return None if sweep is None or sweep.withdraw() else sweep


def _recorded(sweep: Sweep) -> tuple[list[Outcome], Path]:
    """Write ``sweep.csv``."""
    # Not before: it takes seconds to import what knows results.
    from edtorch.app.sweep_table import outcomes, write_csv

    jobs = outcomes(sweep.folder, sweep.jobs)
    return jobs, write_csv(sweep.folder, jobs)


def _told(sweep: Sweep) -> str:
    """The last line of a sweep in which not all jobs are done, after the table of the others; ""
    where all are."""
    from edtorch.app.sweep_table import table_of

    jobs, path = _recorded(sweep)
    if not (table := table_of(sweep.folder, jobs)):
        print(f"{len(jobs)} jobs done: {path}")
        return ""
    print(table, file=sys.stderr)
    counts = Counter(job.status for job in jobs).most_common()
    listed = ", ".join(f"{count} {status}" for status, count in counts)
    return f"of {len(jobs)} jobs {listed}: {path}"
