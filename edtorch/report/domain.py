"""What the results of a domain are called: its measures, its words, its kind of return."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

from sims.base import DEFAULT_WORDS, Measure, Spec, Words

RETURN = "return"
ReturnOf = Literal["", "environment", "shaping reward"]
RETURN_LABELS: dict[str, str] = {
    "": RETURN,
    "environment": RETURN,
    "shaping reward": "shaping reward, summed over time",
}
RESERVED = (RETURN, "lost", "success", "seconds", "outcome")
"""Names of measures that every episode has anyway."""


@dataclass(frozen=True)
class Domain:
    """survival: as in ``sims.base.Spec``; return_of: whose rewards a return sums up: those of the
    environment, or where it has none of the configured reward; "" where neither is known; can_fail:
    whether the domain declares that an episode can fail, without which failures are told only where
    there are some."""

    name: str
    words: Words = DEFAULT_WORDS
    measures: tuple[Measure, ...] = ()
    survival: bool | None = None
    return_of: ReturnOf = ""
    can_fail: bool = True

    @property
    def has_goal(self) -> bool:
        """Whether an episode can be a success before the time limit, as far as is declared."""
        return self.survival is False or any(measure.successes for measure in self.measures)

    @property
    def return_label(self) -> str:
        """The return, in words."""
        return RETURN_LABELS[self.return_of]

    def as_json(self) -> dict[str, Any]:
        """For ``summary.json``; ``from_json`` reads it."""
        return {**asdict(self), "measures": [asdict(m) for m in self.measures]}


def domain_of(spec: Spec, return_of: ReturnOf = "", names: Iterable[str] = ()) -> Domain:
    """That of a sim; names: of what it measures, for one that declares no measures."""
    measures = spec.measures or undeclared(names)
    can_fail = bool(spec.survival or spec.can_fail)
    return Domain(spec.name, spec.words, measures, spec.survival, return_of, can_fail)


def undeclared(names: Iterable[str]) -> tuple[Measure, ...]:
    """Measures labelled by their names."""
    return tuple(Measure(n, n.replace("_", " ")) for n in names if n not in RESERVED)


def from_json(content: Mapping[str, Any]) -> Domain:
    """Raises KeyError, TypeError or ValueError for what is no domain."""
    measures = tuple(Measure(**each) for each in content["measures"])
    found = Domain(**{**content, "measures": measures, "words": Words(**content["words"])})
    texts = [found.name, *vars(found.words).values()]
    texts += [text for m in measures for text in (m.name, m.label, m.unit)]
    if not all(isinstance(text, str) for text in texts):
        raise TypeError("expected texts")
    if found.return_of not in RETURN_LABELS:
        raise ValueError(f"return_of={found.return_of}: expected one of {list(RETURN_LABELS)}")
    return found
