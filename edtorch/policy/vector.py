"""Policies whose parameters are one vector, as an evolution strategy and kernels take them."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import ClassVar, Protocol, final

import numpy as np
import torch
from torch import Tensor

from edtorch.model.told import Told
from edtorch.policy.bounded import BoundedPolicy
from edtorch.policy.squash import Squash
from edtorch.types import Parameters


class VectorPolicy(BoundedPolicy):
    """kernel: the text in ``edtorch/search/kernels`` that computes its raw actions from the vector
    and ``arrays``."""

    kernel: ClassVar[str]

    @property
    @abstractmethod
    def arrays(self) -> tuple[np.ndarray, ...]:
        """What the kernel is given beside the vector; its place says how many dimensions it has."""

    @property
    @abstractmethod
    def begun(self) -> tuple[Tensor, Tensor]:
        """The vector to begin a search from, and the deviations of random ones, ``[p]``."""

    @property
    @abstractmethod
    def shapes(self) -> Mapping[str, tuple[int, ...]]:
        """Of the parameters, in the order of the vector."""

    @final
    @property
    def size(self) -> int:
        """p."""
        return len(self.begun[0])

    @final
    def vector(self, parameters: Parameters) -> Tensor:
        """All of them, ``[*B, p]``."""
        flat = [parameters[name].flatten(-len(shape)) for name, shape in self.shapes.items()]
        return torch.cat(flat, dim=-1)

    @final
    def of_vector(self, vector: Tensor) -> Parameters:
        """The parameters of ``[*B, p]``."""
        sizes = [int(np.prod(shape)) for shape in self.shapes.values()]
        parts = zip(self.shapes.items(), vector.split(sizes, dim=-1), strict=True)
        return {name: part.unflatten(-1, shape) for (name, shape), part in parts}

    @final
    def initial(self, seeds: Sequence[int]) -> Parameters:
        """Those to begin from, for each seed."""
        return self.of_vector(self.begun[0].expand(len(seeds), -1).clone())

    @final
    def random(self, count: int, spread: float, generator: np.random.Generator) -> Parameters:
        """Normal about those to begin from; spread: of the deviations."""
        middle, deviation = self.begun
        normal = torch.from_numpy(generator.standard_normal((count, self.size)))
        return self.of_vector(middle + spread * deviation * normal)


class Gait(Protocol):
    """What of a policy is told, as a configuration names it."""

    @property
    def words(self) -> str:
        """It, for the list of what is told."""
        ...

    def policy(self, told: Told, squash: Squash) -> VectorPolicy:
        """The policy.  Raises ValueError for unknown names."""
        ...
