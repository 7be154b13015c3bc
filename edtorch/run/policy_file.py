"""Files of policies: parameters as safetensors, with a card that says what they were made for."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from edtorch.renamed import current_component
from edtorch.run.files import FileProblem, write_atomically
from edtorch.types import Parameters


@dataclass(frozen=True)
class PolicyCard:
    """What a saved policy was made for; a policy is refused elsewhere.

    domain: name of the sim's spec; states, actions: names in order; scales: of states, then of
    actions; policy: class and feature map; seeds: one per row of the parameters.
    """

    domain: str
    states: list[str]
    actions: list[str]
    scales: list[float]
    policy: str
    seeds: list[int]


def save_policy(path: Path, policy: Parameters, card: PolicyCard) -> None:
    """Save the policies of a population, ``[S, ...]``, as safetensors with their card."""
    tensors = {name: p.detach().contiguous() for name, p in policy.items()}
    metadata = {"edtorch": json.dumps(asdict(card))}
    content = save(tensors, metadata)
    write_atomically(path, lambda partial: partial.write_bytes(content))


def policy_dtype(path: Path) -> torch.dtype:
    """The number type of a saved policy; FileProblem if the file is none."""
    try:
        with safe_open(path, framework="pt") as file:
            return file.get_tensor(next(iter(file.keys()))).dtype
    except (OSError, SafetensorError, StopIteration) as error:
        raise FileProblem(f"{path}: not a saved policy ({error})") from error


def saved_seeds(path: Path) -> list[int]:
    """The seeds on the card of a saved policy; FileProblem if the file is none."""
    return _card(path).seeds


def _card(path: Path) -> PolicyCard:
    try:
        with safe_open(path, framework="pt") as file:
            card = PolicyCard(**json.loads(file.metadata()["edtorch"]))
    except (OSError, SafetensorError, KeyError, TypeError, ValueError) as error:
        raise FileProblem(f"{path}: not a saved policy ({error})") from error
    return replace(
        card,
        states=[current_component(card.domain, name) for name in card.states],
        actions=[current_component(card.domain, name) for name in card.actions],
    )


def load_policy(path: Path, expected: PolicyCard, shapes: dict[str, tuple[int, ...]]) -> Parameters:
    """Load what ``save_policy`` saved; ``expected`` has the seeds, ``shapes`` those of one policy.

    Raises FileProblem if the file is something else, or was made for another domain or policy.
    """
    card = _card(path)
    with safe_open(path, framework="pt") as file:
        tensors: dict[str, Tensor] = {name: file.get_tensor(name) for name in file.keys()}
    for field in fields(PolicyCard):
        found, wanted = getattr(card, field.name), getattr(expected, field.name)
        if found != wanted:
            raise FileProblem(
                f"{path}: policy made for {field.name} {found}, expected {field.name} {wanted}"
            )
    for name, shape in shapes.items():
        wanted = (len(card.seeds), *shape)
        found = tuple(tensors[name].shape) if name in tensors else None
        if found != wanted:
            raise FileProblem(f"{path}: parameter {name!r} has shape {found}, expected {wanted}")
    return tensors
