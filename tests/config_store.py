"""A configuration store of its own for every test that composes."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hydra.core.config_store import ConfigStore


@pytest.fixture(autouse=True)
def hydra(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    store = ConfigStore.instance()
    monkeypatch.setattr(store, "repo", {"hydra": store.repo.get("hydra", {})})
    yield
