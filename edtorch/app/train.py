"""``edtorch-train``: learn, evaluate, and leave a complete run folder."""

from __future__ import annotations

import logging
import math
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import hydra
import torch
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from rich.table import Table

from edtorch.app import schemas
from edtorch.app.build import Setup, build
from edtorch.app.errors import ConfigError, guarded
from edtorch.app.pictures import draw
from edtorch.app.rundir import (
    CHECKPOINT,
    POLICY,
    RunFolder,
    command_line,
    json_text,
    remove_if_empty,
    versions,
)
from edtorch.checkpoint import save_policy, save_training, write_text
from edtorch.interact import Training, evaluate
from edtorch.learner import Check
from edtorch.log import ConsoleSink, CsvSink, Sink, TensorBoardSink
from edtorch.report.statistics import evaluation_figures, learning_figures

logger = logging.getLogger("edtorch")

_STARTED = time.monotonic()


@dataclass(frozen=True)
class Clock:
    """Wall and CPU seconds that something took."""

    wall: float
    cpu: float

    @staticmethod
    def now() -> Clock:
        """The present."""
        return Clock(time.monotonic(), time.process_time())

    def since(self) -> Clock:
        """What has passed from then to now."""
        now = Clock.now()
        return Clock(now.wall - self.wall, now.cpu - self.cpu)


def _broken(training: Training) -> dict[int, tuple[str, int]]:
    """Learners whose numbers were not finite somewhere: the first place, the first tick."""
    rows = (~training.finite).any(0).nonzero().flatten().tolist()
    sound_ticks = training.learners.sound_ticks.tolist()
    places = training.finite.to(torch.int8).argmin(0).tolist()
    return {row: (Check(places[row]).name.lower(), sound_ticks[row]) for row in rows}


def _warn_of_trouble(training: Training, warned: set[int]) -> None:
    """One line for each learner whose numbers broke, when it is first seen."""
    for row, (place, tick) in _broken(training).items():
        if row not in warned:
            warned.add(row)
            logger.warning(
                "seed %d: not finite in %s from tick %d (%.2f s) on; such updates are skipped",
                training.seeds[row],
                place,
                tick,
                tick * training.world.dt,
            )


def _learn(training: Training, sinks: list[Sink], config: DictConfig, folder: Path) -> None:
    """Run the loop to the end of every budget, reporting on the way."""
    per_snapshot = max(1, round(config.log.every / training.world.dt))
    next_save = config.log.checkpoint
    reported, warned = 0, set()
    while not training.done:
        training.advance(per_snapshot)
        snapshot = training.snapshot()
        for sink in sinks:
            sink.write(snapshot, training.episodes[reported:])
        reported = len(training.episodes)
        _warn_of_trouble(training, warned)
        if training.seconds >= next_save:
            save_training(folder / CHECKPOINT, training)
            next_save += config.log.checkpoint


def _summary(training: Training, timing: dict[str, float], evaluated: Any) -> dict[str, Any]:
    lived = (training.learners.tick * training.world.dt).tolist()
    ticks = int(training.learners.tick.sum())
    return {
        "seeds": training.seeds,
        **learning_figures(training.episodes, training.seeds, lived),
        **evaluation_figures(evaluated),
        "simulated_seconds": lived,
        "ticks": ticks,
        "ticks_per_cpu_s": ticks / timing["cpu_s"],
        **timing,
        "not_finite": {
            str(training.seeds[row]): {"place": place, "tick": tick}
            for row, (place, tick) in _broken(training).items()
        },
        "versions": versions(),
        "command": command_line(),
    }


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _table(summary: dict[str, Any], title: str) -> Table:
    table = Table(title=title, title_justify="left")
    table.add_column("over the seeds")
    for name in ("median", "min", "max"):
        table.add_column(name, justify="right")
    rows = (
        ("falls before the first ride", "falls_before_first_ride", 0),
        ("seconds before the first ride", "seconds_before_first_ride", 1),
        ("falls after the first ride", "falls_after_first_ride", 0),
        ("evaluation: reached the goal", "goal_rate", 3),
        ("evaluation: time to the goal, s", "goal_time_s", 1),
        ("evaluation: over the shortest possible", "goal_time_over_shortest", 4),
        ("evaluation: length of path, m", "path_length_m", 1),
    )
    for label, key, digits in rows:
        spread = summary[key]
        if spread["median"] is not None:
            table.add_row(label, *(_number(spread[k], digits) for k in ("median", "min", "max")))
    return table


def _flat_settings(config: DictConfig) -> dict[str, str | float | bool]:
    """Every leaf of the configuration by its full key, for TensorBoard's table of settings."""
    flat: dict[str, str | float | bool] = {}

    def visit(node: Any, prefix: str) -> None:
        for key, value in node.items():
            if isinstance(value, dict):
                visit(value, f"{prefix}{key}.")
            else:
                flat[f"{prefix}{key}"] = value if isinstance(value, bool | int | float) else str(value)

    visit(OmegaConf.to_container(config, resolve=True), "")
    return flat


def train(setup: Setup, config: DictConfig, folder: RunFolder, console: Console) -> dict[str, Any]:
    """Learn, evaluate, write everything; returns the content of ``summary.json``."""
    path = folder.path
    training = Training(setup.learner, setup.world, setup.seeds, setup.budget)
    logger.info("%d learners on %s; %s", len(setup.seeds), setup.world.spec.name, setup.path)
    timing = {"startup_s": round(time.monotonic() - _STARTED, 3)}
    sinks: list[Sink] = [CsvSink(path)]
    board = None
    if config.log.tensorboard:
        board = TensorBoardSink(path, OmegaConf.to_yaml(config, resolve=True))
        sinks.append(board)
    if config.log.progress:
        sinks.append(ConsoleSink(console))
    try:
        began = Clock.now()
        try:
            _learn(training, sinks, config, path)
        finally:
            spent = began.since()
            timing |= {"wall_s": spent.wall, "cpu_s": spent.cpu}
            save_training(path / CHECKPOINT, training)
            save_policy(path / POLICY, training.learners.policy, setup.card)

        began = Clock.now()
        if config.eval.episodes:
            console.print(
                f"{config.eval.episodes} fresh episodes for each of {len(setup.seeds)} policies..."
            )
        fresh = build(config).world
        evaluated = evaluate(
            setup.learner.policy,
            training.learners.policy,
            fresh,
            setup.seeds,
            config.eval.episodes,
        ).episodes
        timing["eval_s"] = began.since().wall

        began = Clock.now()
        if config.log.figures:
            figure = draw(training, path, animate=config.log.animation)
            if board is not None:
                board.writer.add_figure("learning_curve", figure, round(training.seconds))
        timing["figures_s"] = began.since().wall

        summary = _summary(training, timing, evaluated)
        if board is not None:
            medians = {
                f"summary/{key}": value["median"]
                for key, value in summary.items()
                if isinstance(value, dict) and value.get("median") is not None
            }
            board.hparams(_flat_settings(config), medians)
    finally:
        for sink in sinks:
            sink.close()
    write_text(path / "summary.json", json_text(summary))
    console.print(_table(summary, f"{setup.world.spec.name}, {len(setup.seeds)} learners"))
    if summary["never_rode"]:
        console.print(f"never rode: seeds {summary['never_rode']}")
    console.print(
        f"learning {timing['wall_s']:.1f} s, {summary['ticks_per_cpu_s']:.0f} learner ticks per CPU "
        f"second; evaluation {timing['eval_s']:.1f} s, pictures {timing['figures_s']:.1f} s"
    )
    console.print(f"run folder: {path}", soft_wrap=True)
    return summary


def _log_to(folder: Path) -> logging.Handler:
    handler = logging.FileHandler(folder / "run.log", encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    return handler


def _task(config: DictConfig) -> float:
    """One job.  Returns the median of the seconds before the first ride, for sweepers to minimise."""
    torch.set_num_threads(max(1, config.compute.threads))
    folder = RunFolder(Path(HydraConfig.get().runtime.output_dir))
    try:
        setup = build(config)
        folder.begin(config, setup.seeds)
    except ConfigError:
        remove_if_empty(folder.path)
        raise
    handlers = [_log_to(folder.path), logging.StreamHandler()]
    logger.setLevel(logging.INFO)
    logger.propagate = False
    for handler in handlers:
        logger.addHandler(handler)
    console = Console()
    try:
        summary = train(setup, config, folder, console)
    except KeyboardInterrupt:
        folder.set_status("interrupted", "stopped by a signal; policy and checkpoint are of then")
        raise
    except BaseException as error:
        logger.exception("failed")
        folder.set_status("failed", f"{type(error).__name__}: {error}")
        raise
    finally:
        for handler in handlers:
            logger.removeHandler(handler)
            handler.close()
    folder.set_status("done")
    objective = summary["seconds_before_first_ride"]["median"]
    return math.inf if objective is None else float(objective)


def _stop(signum: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def main() -> None:
    """Entry point of ``edtorch-train``."""
    schemas.register()
    signal.signal(signal.SIGTERM, _stop)
    run = hydra.main(version_base="1.3", config_path="pkg://conf", config_name="train")(_task)
    sys.exit(guarded("edtorch-train", run))


if __name__ == "__main__":
    main()
