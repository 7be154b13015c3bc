"""From the group ``domain`` to a sim."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

from edtorch.app.construct import construct, given_part, is_given
from edtorch.app.errors import ConfigError, unknown_key
from edtorch.app.settings import Settings
from edtorch.report.domain import Domain, ReturnOf, domain_of
from edtorch.run.episodes import Episode
from edtorch.run.scaled_sim import World
from sims.base import Rewarded, Sim


def build_sim(config: Any) -> Sim:
    """The domain."""
    if is_given(config):
        return given_part("domain", config)
    return construct("domain", config, "initial", "restart", "step", "observe", "outcome")


def changed_domain(domain: Any, changes: Any, key: str) -> Settings:
    """The domain's node with the changes asked for under ``key``; unknown names are refused."""
    if not isinstance(domain, Settings):
        raise ConfigError(f"domain={domain}: expected a mapping with a _target_")
    known = sorted(str(k) for k in domain if k != "_target_")
    for name, value in changes.items():
        if name not in domain:
            raise ConfigError(unknown_key(f"{key}.{name}={value}", f"{key}.{name}", known))
    return domain.merged(changes)


def described(world: World, names: Iterable[str] = ()) -> Domain:
    """What the results in a world are called; names: of what its sim measures, for one that
    declares no measures."""
    own = isinstance(world.sim, Rewarded)
    shaped: ReturnOf = "shaping reward" if world.reward is not None else ""
    found = domain_of(world.spec, "environment" if own else shaped, names)
    # A return that is asked for makes success, and not the time limit.
    return replace(found, survival=world.rule.survival)


def measured(episodes: Sequence[Sequence[Episode]]) -> list[str]:
    """What the sim measured of these episodes."""
    return next((list(e.measures) for own in episodes for e in own), [])
