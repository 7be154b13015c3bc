"""What every test runs under."""

from __future__ import annotations

import gc
import os

import pytest
import torch

from tests.shapes import install

# Small tensors: a second thread only waits, and several test processes share the machine.
torch.set_num_threads(1)

install()


def pytest_configure(config: pytest.Config) -> None:
    """Kernels are compiled once for all processes, and kept in the checkout for later sessions."""
    assert config.cache is not None
    os.environ["EDTORCH_CACHE"] = str(config.cache.mkdir("kernels"))


def pytest_collection_finish() -> None:
    """What has been imported by now stays: no collection of garbage need look through it again."""
    gc.collect()
    gc.freeze()
