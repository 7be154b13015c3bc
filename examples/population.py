"""Eight learners in lockstep: each does what it would do alone, to the last digit.

python examples/population.py
"""

import torch

import edtorch


def main(seconds: float = 10.0, seeds: int = 8) -> bool:
    """Learn together and one of them alone; returns whether that one learned the same."""
    together = edtorch.learn(preset="bicycle_paper", seconds=seconds, seeds=seeds)
    alone = edtorch.learn(preset="bicycle_paper", seconds=seconds, seed=seeds - 1)
    for row in together.episodes:
        print(f"seed {row['seed']}: {row['seconds']:.2f} s, {row['outcome']}")
    one, other = (run.policies[-1].parameters for run in (together, alone))
    return all(torch.equal(one[name], other[name]) for name in one)


if __name__ == "__main__":
    print("the same alone:", main())
