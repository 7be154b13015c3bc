"""Tests of this folder compose configurations."""

from tests.config_store import hydra as hydra
