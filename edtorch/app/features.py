"""From ``model.features`` or ``policy.features`` to a feature map."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import torch

from edtorch.app.construct import construct
from edtorch.app.errors import ConfigError
from edtorch.app.settings import Settings
from edtorch.model.features import Affine, FeatureMap, Identity, Pairwise, Trigonometric
from sims.base import Spec

FEATURES: Mapping[str, Callable[[int], FeatureMap]] = {
    "identity": Identity,
    "affine": Affine,
    "pairwise": Pairwise,
    "trigonometric": Trigonometric,
}


def build_features(key: str, config: Any, inputs: int, spec: Spec, seed: int) -> FeatureMap:
    """A feature map from its name, or from a ``_target_`` with its arguments."""
    if not isinstance(config, Settings):
        if config not in FEATURES:
            raise ConfigError(
                f"{key}={config}: expected one of {', '.join(FEATURES)},"
                " or a mapping with a _target_"
            )
        return FEATURES[config](inputs)
    generator = torch.Generator().manual_seed(seed)
    more = {"generator": generator, "spec": spec} | (
        {} if "inputs" in config else {"inputs": inputs}
    )
    features = construct(key, config, "forward", **more)
    taken = getattr(features, "inputs", None)
    if taken != inputs:
        raise ConfigError(f"{key}.inputs={taken}: expected {inputs}, the size of what it is given")
    if not isinstance(getattr(features, "outputs", None), int):
        raise ConfigError(
            f"{key}._target_={config._target_}: expected a feature map, which knows its outputs"
        )
    return features


def without_features(group: str, config: Settings) -> Settings:
    """The node of a part that has no feature map; one that is asked for is refused."""
    if config.get("features", "identity") != "identity":
        raise ConfigError(
            f"{group}.features={config.features}: {config._target_} has no argument features"
        )
    return config.without("features")


def features_of(
    group: str, config: Any, inputs: int, spec: Spec, seed: int
) -> tuple[FeatureMap, Settings]:
    """The feature map of a model or policy, and the rest of its node."""
    if not isinstance(config, Settings):
        raise ConfigError(f"{group}={config}: expected a mapping with a _target_")
    chosen = config.get("features", "identity")
    features = build_features(f"{group}.features", chosen, inputs, spec, seed)
    return features, config.without("features")
