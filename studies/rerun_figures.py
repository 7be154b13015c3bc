"""The paper's figures from the runs of their cells: Figure 2 upper and lower, Figure 3."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from edtorch.app.domain import build_sim
from edtorch.app.policy import build_actor, policy_card
from edtorch.app.rundir import POLICY, load_config
from edtorch.report.domain import Domain, domain_of
from edtorch.report.figures import Trace, learning_curve, length, one_episode, save_figure
from edtorch.report.runs import FinishedRun
from edtorch.report.task_curve import task_curve
from edtorch.run.evaluation import evaluate
from edtorch.run.policy_file import load_policy, policy_dtype
from edtorch.run.scaled_sim import World
from sims.cardea.cardea import MEASURES, WORDS
from studies.cardea_figure import episodes_of
from studies.rerun_methods import FIGURE_2, FIGURE_3, Material

STARTS = 1000
"""Of which the median of the shortest possible times is taken."""


def draw(material: Material, folder: Path) -> list[str]:
    """Those that there are runs for; their names."""
    folder.mkdir(parents=True, exist_ok=True)
    drawn: list[str] = []
    for run in material.runs.get(FIGURE_2, []):
        drawn += _figure_2(run, folder)
    reaching = {
        row.rpartition("/")[2]: episodes_of(run.path, [m.name for m in MEASURES])
        for row in FIGURE_3
        for run in material.runs.get(row, [])
    }
    if reaching:
        title = "Error and speed at the ends of the episodes, actions perturbed"
        domain = Domain("cardea", WORDS, MEASURES)
        save_figure(task_curve(reaching, domain, title), folder, "figure_3")
        drawn.append("figure_3")
    return drawn


def _figure_2(run: FinishedRun, folder: Path) -> list[str]:
    """Length of episode against training time; the angle to the goal in one episode after it."""
    config = load_config(run.path)
    sim = build_sim(config.domain)
    path = run.path / POLICY
    dtype = policy_dtype(path)
    world = World(sim, dtype, unwrap=config.observation.unwrap)
    policy, shapes = build_actor(config, world)
    parameters = load_policy(path, policy_card(sim, policy, run.seeds), shapes)

    episodes, size = episodes_of(run.path)
    title = f"Figure 2, upper: {size} learners"
    heights = length(_shortest(world))
    upper = learning_curve(episodes, size, domain_of(world.spec), heights, None, title)
    save_figure(upper, folder, "figure_2_upper")

    states: list[Tensor] = []
    first = {name: p[:1] for name, p in parameters.items()}
    ((episode,),) = evaluate(policy, first, world, run.seeds[:1], 1, watch=states.append)
    spec = world.spec
    index = [q.name for q in spec.state].index(spec.headline)
    shown = sim.observe(torch.stack(states)[:, 0])[:, index].numpy()
    quantity = spec.state[index]
    learned = run.summary["simulated_seconds"][0]
    text = f"seed {run.seeds[0]}, without exploration, {episode.outcome.name.lower()}"
    trace = Trace(
        spec.dt * np.arange(1, len(shown) + 1),
        shown,
        quantity.name,
        quantity.unit,
        text.replace("_", " "),
        quantity.period,
    )
    lower = one_episode(trace, f"Figure 2, lower: an episode after {learned:,.0f} s of learning")
    save_figure(lower, folder, "figure_2_lower")
    return ["figure_2_upper", "figure_2_lower"]


def _shortest(world: World) -> float:
    """Median over starts of the shortest time that they allow."""
    generator = torch.Generator().manual_seed(0)
    uniform = torch.rand(STARTS, world.uniforms, dtype=world.dtype, generator=generator)
    start = world.initial(uniform)
    measures = world.sim.measures(start, start, torch.zeros(STARTS, dtype=torch.float64))
    return float(measures["shortest_time_s"].median())
