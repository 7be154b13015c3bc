"""States, as files keep them: read back, sharing nothing with what they were taken from."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import torch


def read_back(state: Any) -> Any:
    """``state`` as it comes from a file; TypeError for what a file does not take."""
    if state is None or isinstance(state, bool | int | float | str):
        return json.loads(json.dumps(state))
    if isinstance(state, torch.Tensor):
        return state.detach().clone()
    if isinstance(state, np.ndarray):
        return state.copy()
    if isinstance(state, list):
        return [read_back(each) for each in state]
    if isinstance(state, dict) and all(isinstance(name, str) for name in state):
        return {name: read_back(each) for name, each in state.items()}
    raise TypeError(f"{type(state).__name__} in a state")
