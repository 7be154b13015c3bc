"""What every test runs under."""

from __future__ import annotations

import torch

from tests.shapes import install

# Small tensors: a second thread only waits, and several test processes share the machine.
torch.set_num_threads(1)

install()
