"""The peers of the benchmarks compute what edtorch computes, else their times mean nothing.

They come with the extra [bench], which neither edtorch nor its development needs.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from benchmarks.bicycle import draws, numbers, paper_training
from edtorch.run.training import Training
from edtorch.types import Belief, replace
from edtorch.value.linear import (
    mean_value_and_gradient,
    moment_value_and_gradient,
)
from tests.systems import normal, random_cost

SIZES = [(5, 2, 30), (7, 3, 1), (1, 1, 5)]
Array = np.ndarray[Any, Any]


def peer(name: str) -> Any:
    """The module of a peer, or skip: what it is made of comes with the extra [bench]."""
    reason = f"{name} is not installed; it comes with the extra [bench]"
    pytest.importorskip(name, reason=reason)
    return importlib.import_module(f"benchmarks.peers_{name}")


# Value and gradient.


@dataclass(frozen=True)
class Problem:
    """A linear problem, and edtorch's value and gradient of it, mean only and with covariance."""

    weight: Tensor
    theta: Tensor
    start: Tensor
    noise: Tensor
    cost: Tensor
    weights: Tensor
    dt: float
    mean: tuple[Tensor, Tensor]
    covariance: tuple[Tensor, Tensor]


@cache
def problem(n: int, m: int, steps: int) -> Problem:
    g = torch.Generator().manual_seed(100 * n + steps)
    batch, dt = 3, 0.05
    weight, theta, start = normal(g, batch, n, n + m), normal(g, batch, m, n), normal(g, batch, n)
    noise = torch.stack([random_cost(g, n) for _ in range(batch)])
    cost, weights = random_cost(g, n), dt * 0.97 ** torch.arange(steps, dtype=torch.float64)
    drift, G = dt * weight[..., :n], dt * weight[..., n:]
    more: Any = {"state_cost": cost, "action_cost": None, "weights": weights}
    belief = Belief(start, torch.zeros_like(noise))
    return Problem(
        weight,
        theta,
        start,
        noise,
        cost,
        weights,
        dt,
        mean_value_and_gradient(drift, G, theta, start, **more),
        moment_value_and_gradient(drift, G, theta, belief, noise, **more),
    )


def last(array: Array) -> Array:
    """The learners as the last axis."""
    return np.moveaxis(array, 0, -1)


def arguments(
    case: Problem, covariance: bool, dtype: Any, convert: Callable[[Array], Any] = np.asarray
) -> list[Any]:
    own = [case.weight, case.theta, case.start] + ([case.noise] if covariance else [])
    arrays = [convert(tensor.numpy().astype(dtype)) for tensor in own]
    return [*arrays, case.cost.numpy().astype(dtype), case.weights.numpy().astype(dtype)]


def check(found: Any, wanted: tuple[Tensor, Tensor], tolerance: float) -> None:
    value, gradient = (np.asarray(f, dtype=np.float64) for f in found)
    size = np.abs(wanted[1].numpy()).max()
    np.testing.assert_allclose(value, wanted[0].numpy(), rtol=tolerance, atol=0)
    np.testing.assert_allclose(gradient, wanted[1].numpy(), rtol=tolerance, atol=tolerance * size)


TOLERANCES = [(np.float64, 1e-11), (np.float32, 1e-4)]


@pytest.mark.oracle
@pytest.mark.parametrize(("n", "m", "steps"), SIZES)
@pytest.mark.parametrize(("dtype", "tolerance"), TOLERANCES)
@pytest.mark.parametrize(
    "name",
    [
        "mean",
        "mean_adjoint",
        "mean_adjoint_last",
        "covariance",
        "covariance_own_jacobian",
        "covariance_adjoint",
        "covariance_adjoint_last",
    ],
)
def test_jax_value_and_gradient(
    name: str, n: int, m: int, steps: int, dtype: Any, tolerance: float
) -> None:
    jax = peer("jax")
    case, covariance = problem(n, m, steps), name.startswith("covariance")
    given = arguments(case, covariance, dtype, last if name.endswith("last") else np.asarray)
    value, gradient = getattr(jax, name)(*given, dtype(case.dt))
    assert value.dtype == dtype and gradient.dtype == dtype
    if name.endswith("last"):
        gradient = np.moveaxis(np.asarray(gradient), -1, 0)
    check((value, gradient), case.covariance if covariance else case.mean, tolerance)


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("n", "m", "steps", "dtype", "tolerance"),
    [(*size, *TOLERANCES[k % 2]) for k, size in enumerate(SIZES)],  # each is compiled anew
)
@pytest.mark.parametrize("covariance", [False, True])
def test_numba_value_and_gradient(
    covariance: bool, n: int, m: int, steps: int, dtype: Any, tolerance: float
) -> None:
    numba = peer("numba")
    case = problem(n, m, steps)
    function = (numba.covariance if covariance else numba.mean)(n, m, steps, dtype)
    found = function(*arguments(case, covariance, dtype), dtype(case.dt))
    check(found, case.covariance if covariance else case.mean, tolerance)


# Whole ticks.

BLOCK, BLOCKS = 16, 7


def eventful_training(covariance: bool) -> Training:
    """The paper's bicycle, about to fall (learners 0 and 1), to arrive (2), to be timed out (3)."""
    training = paper_training(6, covariance=covariance)
    here = training.worlds
    world, begun = here.world.clone(), here.begun.clone()
    world[0, 2], world[0, 3] = 0.2, 0.5
    world[1, 2], world[1, 3] = 0.1, 0.2
    world[2, 5:] = torch.tensor([-torch.pi / 2, 988.61, 0.0, 987.5, 0.0])
    begun[3] = 30 - training.world.limit_ticks
    here = replace(
        here, world=world, observation=training.world.observe(world), start=world, begun=begun
    )
    training.stage.replace(replace(training.stage.population, worlds=here))
    return training


def blocks(training: Training) -> Iterator[tuple[Array, Array]]:
    for _ in range(BLOCKS):
        yield draws(training, BLOCK)
        training.advance(BLOCK)


def check_ticks(training: Training, found: dict[str, Any], values: Array) -> None:
    wanted = numbers(training)
    assert wanted["falls"].tolist()[:2] == [1, 1]
    assert wanted["rides"].tolist()[2:4] == [1, 1]
    for name, array in wanted.items():
        # Differences of rounding grow with the ticks: the closed loop is not a stable one.
        np.testing.assert_allclose(found[name], array, rtol=1e-9, atol=1e-9, err_msg=name)
    np.testing.assert_allclose(values.mean(0), training.snapshot().value, rtol=1e-9)


@pytest.mark.oracle
@pytest.mark.parametrize("name", ["ticks", "ticks_by_hand"])
@pytest.mark.parametrize("covariance", [False, True])
def test_jax_ticks(covariance: bool, name: str) -> None:
    jax = peer("jax")
    ticks = getattr(jax, name)
    training = eventful_training(covariance)
    population, values = jax.population(numbers(training), np.float64), []
    for uniform, normals in blocks(training):
        population, value = ticks(population, uniform, normals)
        values.append(np.asarray(value))
    check_ticks(training, population._asdict(), np.concatenate(values))


@pytest.mark.oracle
def test_jax_ticks_in_mixed_precision() -> None:
    jax = peer("jax")
    training = eventful_training(False)
    population = jax.population(numbers(training), np.float32)
    for uniform, normals in list(blocks(training))[:1]:
        population, _ = jax.ticks(
            population, uniform.astype(np.float32), normals.astype(np.float32)
        )
    assert population.world.dtype == np.float64
    assert {
        str(a.dtype) for a in (population.weight, population.theta, population.observation)
    } == {"float32"}
    reference = eventful_training(False)
    reference.advance(BLOCK)
    for name, array in numbers(reference).items():
        np.testing.assert_allclose(
            getattr(population, name), array, rtol=1e-3, atol=1e-3, err_msg=name
        )


@pytest.mark.oracle
@pytest.mark.parametrize("covariance", [False, True])
def test_numba_ticks(covariance: bool) -> None:
    numba = peer("numba")
    training = eventful_training(covariance)
    population = {"noise": np.empty((0, 5, 5)), **numbers(training)}
    values = np.empty((BLOCKS * BLOCK, len(training.seeds)))
    for k, (uniform, normals) in enumerate(blocks(training)):
        place = values[k * BLOCK : (k + 1) * BLOCK]
        numba.ticks(*(population[name] for name in numba.ORDER), uniform, normals, place)
    check_ticks(training, population, values)
