"""From the group ``domain`` to a sim."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, cast

from edtorch.app.construct import construct, given_part, is_given
from edtorch.app.errors import ConfigError, unknown_key
from edtorch.app.settings import Settings
from edtorch.report.domain import Domain, ReturnOf, domain_of
from edtorch.run.episodes import Episode
from edtorch.run.scaled_sim import World
from sims.base import Rewarded, Sim, are_names
from sims.rows import HasRows, NoRows, torch_rows_of

METHODS = ("initial", "restart", "step", "observe", "outcome", "measures")
"""Of a ``Sim``."""


def build_sim(config: Any, key: str = "domain") -> Sim:
    """The domain; key: of the settings, for messages."""
    if not is_given(config):
        return _checked(construct(key, config, *METHODS), key)
    sim = given_part("domain", config)
    lacking = [name for name in ("spec", *METHODS) if not hasattr(sim, name)]
    if lacking:
        raise ConfigError(
            f"env: {type(sim).__name__} lacks {', '.join(lacking)}; expected a simulator"
            " (sims.base.Sim), or an environment of Gymnasium"
        )
    return _checked(sim, "env")


def _checked(sim: Sim, key: str) -> Sim:
    if hasattr(sim, "rows"):
        try:
            torch_rows_of(cast(HasRows, sim))
        except NoRows:
            pass  # its tensor functions are its own
        except (ValueError, NotImplementedError) as error:
            raise ConfigError(f"{key}: {error}") from error
    for which, quantities in (("state", sim.spec.state), ("action", sim.spec.action)):
        names = [quantity.name for quantity in quantities]
        if not are_names(names):
            raise ConfigError(
                f"{key}: the components of the {which} of {sim.spec.name} are called {names};"
                " expected different names without dots"
            )
    return sim


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
