"""Figure 1 of the paper on one page, in its order, with torch and nothing of edtorch.

    python examples/figure_1.py

A learner lives in a world s' = F s + G a + noise that it does not know.  After every step it fits a
model of the world, predicts how its policy will do by that model, noise included, and moves the
policy up the gradient.  ``tests/examples/test_figure_1.py`` holds it equal to ``Learner.step``.
"""

import time
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.func import grad_and_value, jacrev

torch.set_default_dtype(torch.float64)


@dataclass(frozen=True)
class Settings:
    """Rates of model, noise and policy; the horizon n; the discount gamma per step."""

    model_rate: float = 0.1
    noise_rate: float = 0.05
    alpha: float = 0.02
    horizon: int = 5
    discount: float = 0.9


@dataclass(frozen=True)
class Learner:
    """Model mu~(s, a) = W [s, a], noise nu~, and policy pi(s) = theta s: all start at zero."""

    W: Tensor  # [n, n + m]
    nu: Tensor  # [n, n]
    theta: Tensor  # [m, n]


def mu(W: Tensor, s: Tensor, a: Tensor) -> Tensor:
    """The mean of the next state, as the learner believes."""
    return W @ torch.cat([s, a])


def reward(s: Tensor, a: Tensor) -> Tensor:
    """What is wanted: the state at zero."""
    return -(s @ s) + 0 * (a @ a)


def value(theta: Tensor, W: Tensor, nu: Tensor, s: Tensor, settings: Settings) -> Tensor:
    """Steps 3 to 6: the expected sum of rewards of the next n steps under policy and model."""

    def mu_pi(s: Tensor) -> Tensor:
        return mu(W, s, theta @ s)

    def r_pi(s: Tensor) -> Tensor:
        return reward(s, theta @ s)

    mean, cov = s, torch.zeros_like(nu)  # 3, 4: the present state is known
    total = torch.zeros(())
    for tau in range(settings.horizon):  # 5
        J = jacrev(mu_pi)(mean)
        mean, cov = mu_pi(mean), nu + J @ cov @ J.T  # 6a, 6b
        expected = r_pi(mean) + 0.5 * torch.trace(jacrev(jacrev(r_pi))(mean) @ cov)  # 6c
        total = total + settings.discount**tau * expected  # 6
    return total


def tick(
    learner: Learner, s: Tensor, a: Tensor, s_next: Tensor, settings: Settings
) -> tuple[Learner, Tensor]:
    """One step of Figure 1 after the transition (s, a, s'); returns the value as well."""
    error = s_next - mu(learner.W, s, a)
    W = learner.W + settings.model_rate * torch.outer(error, torch.cat([s, a]))  # 1
    nu = learner.nu + settings.noise_rate * (torch.outer(error, error) - learner.nu)  # 2
    gradient, V = grad_and_value(value)(learner.theta, W, nu, s_next, settings)  # 3 to 6
    theta = learner.theta + settings.alpha * gradient  # 7
    return replace(learner, W=W, nu=nu, theta=theta), V


def main(ticks: int = 2000, seconds: float = 20.0) -> Learner:
    """Live in an unstable world until the ticks or the seconds are over."""
    F, G = torch.tensor([[1.0, 0.1], [0.1, 1.0]]), torch.tensor([[0.0], [0.5]])
    learner = Learner(torch.zeros(2, 3), torch.zeros(2, 2), torch.zeros(1, 2))
    generator = torch.Generator().manual_seed(0)
    s, began = torch.ones(2), time.monotonic()
    for count in range(ticks):
        a = learner.theta @ s + 0.3 * torch.randn(1, generator=generator)
        s_next = F @ s + G @ a + 0.05 * torch.randn(2, generator=generator)
        learner, V = tick(learner, s, a, s_next, Settings())
        s = s_next if s_next.norm() < 5 else torch.ones(2)
        if count % 200 == 0:
            print(f"tick {count}: value {V:.2f}, policy {learner.theta.tolist()}")
        if time.monotonic() - began > seconds:
            break
    return learner


if __name__ == "__main__":
    main()
