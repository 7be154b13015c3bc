"""Folders that Hydra makes before a job can say whether it will run at all.

Hydra makes the output folder, parents included, and only then calls the job.  One that is refused
must leave nothing behind, so a callback (named in ``conf/train.yaml``) looks first at what exists.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.experimental.callback import Callback
from omegaconf import DictConfig, OmegaConf

SWEEP_RECORD = "multirun.yaml"
"""What Hydra's sweeper writes before the first job."""


@dataclass(frozen=True)
class Footprint:
    """key, wanted: the setting that names the output folder, and its value; standing: the deepest
    folder on the way to it that was there before."""

    key: str
    wanted: Path
    standing: Path

    def remove(self) -> None:
        """Remove what Hydra made, where nothing else has come into it."""
        record = self.wanted / SWEEP_RECORD
        if (
            record.is_file()
            and self.wanted != self.standing
            and _names(self.wanted) == [record.name]
        ):
            record.unlink()
        remove_empty(self.wanted, self.standing)


def _names(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir()]


def remove_empty(folder: Path, standing: Path) -> None:
    """Remove ``folder`` and the folders above it as long as they are empty, up to ``standing``."""
    while folder != standing and folder.is_dir() and not _names(folder):
        folder.rmdir()
        folder = folder.parent


class FootprintCallback(Callback):
    """Remembers the footprint of the command that is running in this process."""

    footprint: Footprint | None = None

    def on_run_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Before the folder of a single run is made."""
        self._look(config, "hydra.run.dir")

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Before the folder of a sweep is made."""
        self._look(config, "hydra.sweep.dir")

    @staticmethod
    def _look(config: DictConfig, key: str) -> None:
        # The folder's name refers to Hydra's own settings, which are not in force yet.
        HydraConfig.instance().set_config(config)
        wanted = Path(str(OmegaConf.select(config, key))).absolute()
        standing = wanted
        while not standing.exists() and standing != standing.parent:
            standing = standing.parent
        FootprintCallback.footprint = Footprint(key, wanted, standing)
