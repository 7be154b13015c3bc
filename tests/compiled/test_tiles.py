"""Populations on compiled ticks: the same lives as tick by tick, in any company."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from torch.utils import _pytree as pytree

from edtorch.compiled import program
from edtorch.compiled.tiles import LARGEST_TILE, VECTOR, Tiles, tile_size
from edtorch.run.episodes import Budget
from edtorch.run.training import Training
from tests.compiling import Kind, needs_a_compiler, training_and_tick

needs_a_compiler()

SEEDS = [11 + k for k in range(20)]
LONG = Budget(seconds=60.0)


@pytest.fixture(scope="module", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A cache of this module's own: each program is compiled once."""
    folder = tmp_path_factory.mktemp("programs")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("EDTORCH_CACHE", str(folder))
        yield folder


def on_tiles(seeds: list[int], budget: Budget, *, kind: Kind = "plain") -> Training:
    """A training that is compiled from its first tick on."""
    training, tick = training_and_tick(seeds, budget, kind=kind)
    training.stage = Tiles(tick, training.stage.population, seeds)
    return training


def test_the_size_of_a_tile() -> None:
    cpu, gpu = torch.device("cpu"), torch.device("cuda")
    sizes = [tile_size(b, cpu) for b in (1, 16, 17, 256, 257, 100_000)]
    assert sizes == [16, 16, 32, 256, 256, 256]
    assert tile_size(100_001, gpu) == 100_016
    assert LARGEST_TILE % VECTOR == 0


@pytest.mark.parametrize("kind", ["plain", "rich", "cautious"])
def test_compiled_ticks_are_the_same_ticks(kind: Kind) -> None:
    eager, tiles = training_and_tick(SEEDS, LONG, kind=kind)[0], on_tiles(SEEDS, LONG, kind=kind)
    # Rounding differs, and the closed loop of a bicycle that falls makes much of it.
    for training in (eager, tiles):
        training.advance(300)
    assert tiles.clock == 300 and len(tiles.episodes) > 20
    lives = [
        sorted((e.row, e.number, e.start, e.seconds, e.outcome, e.trail) for e in t.episodes)
        for t in (eager, tiles)
    ]
    assert lives[0] == lives[1]
    for measured, wanted in zip(tiles.episodes, eager.episodes, strict=True):
        assert measured.measures == pytest.approx(wanted.measures, nan_ok=True)
    pairs = zip(*(pytree.tree_leaves(t.stage.population) for t in (tiles, eager)), strict=True)
    for found, wanted in pairs:
        assert found.dtype == wanted.dtype and found.shape == wanted.shape
        assert torch.allclose(found.double(), wanted.double(), rtol=1e-6, atol=1e-8)
    for row in (0, 15):
        last = max((e for e in tiles.episodes if e.row == row), key=lambda e: e.number)
        kept = [t.trail.states(row, *last.trail) for t in (tiles, eager)]
        assert torch.allclose(*kept, rtol=1e-6, atol=1e-8)


def test_a_learner_does_not_depend_on_its_company(monkeypatch: pytest.MonkeyPatch) -> None:
    together, alone = on_tiles(SEEDS, LONG), on_tiles([SEEDS[7]], LONG)
    # Several tiles, the last one padded.
    monkeypatch.setattr("edtorch.compiled.tiles.LARGEST_TILE", VECTOR)
    apart = on_tiles(SEEDS, LONG)
    for training in (together, alone, apart):
        training.advance(200)
    wholes = [pytree.tree_leaves(t.stage.population) for t in (together, apart, alone)]
    for whole, tiled, single in zip(*wholes, strict=True):
        assert torch.equal(whole, tiled)
        assert torch.equal(whole[7:8], single)
    own = [e for e in together.episodes if e.row == 7]
    assert own and [e.seconds for e in own] == [e.seconds for e in alone.episodes]


def test_nothing_is_compiled_twice(own_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    on_tiles(SEEDS, LONG)
    programs = sorted(own_cache.iterdir())
    monkeypatch.setattr(program, "_make", lambda *_: pytest.fail("compiled again"))
    training = on_tiles([99 + k for k in range(20)], LONG)
    assert isinstance(training.stage, Tiles) and not training.stage.was_compiled
    training.advance(100)
    assert sorted(own_cache.iterdir()) == programs


def test_learners_stop_with_their_budget() -> None:
    budget = Budget(episodes=2)
    eager, tiles = training_and_tick(SEEDS, budget)[0], on_tiles(SEEDS, budget)
    for training in (eager, tiles):
        while not training.done:
            training.advance(64)
    assert len(tiles.episodes) == 2 * len(SEEDS)
    assert torch.equal(tiles.learners.tick, eager.learners.tick)
    # What a learner knew when it stopped stays: the others' ticks do not reach it.
    first = int(tiles.learners.tick.argmin())
    tiles_again = on_tiles(SEEDS, budget)
    tiles_again.advance(int(tiles.learners.tick.min()))
    for found, wanted in zip(
        pytree.tree_leaves(tiles_again.learners), pytree.tree_leaves(tiles.learners), strict=True
    ):
        assert torch.equal(found[first], wanted[first])


def test_a_population_moves_between_stages() -> None:
    # Half eager, half compiled; snapshots begin the sums anew.
    training, tick = training_and_tick(SEEDS, LONG)
    training.advance(100)
    before = training.stage.population
    training.stage = Tiles(tick, before, SEEDS)
    for found, wanted in zip(
        pytree.tree_leaves(training.stage.population), pytree.tree_leaves(before), strict=True
    ):
        assert torch.equal(found, wanted)
    training.advance(50)
    assert training.snapshot().seconds == pytest.approx(1.5)
    assert bool((training.stage.population.tally.ticks == 0).all())
    training.advance(30)
    assert bool((training.stage.population.tally.ticks == 30).all())
    assert training.learners.tick.tolist() == [180] * 20
