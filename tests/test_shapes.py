"""Shapes in annotations are checked at every call, also after calls that were right."""

from __future__ import annotations

import pytest
import torch
from beartype import beartype
from beartype.roar import BeartypeCallHintViolation
from torch import Tensor

from edtorch.shapes import Squares, States
from tests.shapes import checked

SQUARE, STATE = torch.eye(2).double().expand(3, 2, 2), torch.ones(3, 2).double()


def moved(cov: Squares, state: States, gone: int = 0) -> States:
    """The covariance times the state, of which so many components get lost."""
    return (cov @ state[..., None])[..., gone:, 0]


moved.__annotations__ = {"cov": Squares, "state": States, "gone": int, "return": States}


@pytest.mark.parametrize("before", [0, 2])
@pytest.mark.parametrize(
    ("state", "gone"),
    [(torch.ones(3, 3).double(), 0), (STATE.long(), 0), (STATE, 1), ([1.0, 2.0], 0)],
    ids=["another length", "another type", "in what is returned", "no tensor"],
)
def test_what_does_not_fit_is_refused(before: int, state: Tensor, gone: int) -> None:
    function = checked(typechecker=beartype)(moved)
    for _ in range(before):
        assert function(SQUARE, STATE).equal(STATE)
        assert function(SQUARE[0], state=STATE[0]).equal(STATE[0])
    with pytest.raises(BeartypeCallHintViolation):
        function(SQUARE, state, gone)
    assert function(SQUARE, STATE).equal(STATE)
