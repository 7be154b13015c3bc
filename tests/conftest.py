"""What every test runs under."""

from __future__ import annotations

import torch

# Small tensors: a second thread only waits, and several test processes share the machine.
torch.set_num_threads(1)
