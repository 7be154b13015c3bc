"""Tensors of a tree by name and back."""

import pytest
import torch

from edtorch.run.tick import Tally
from edtorch.run.trees import tensors_of, with_tensors


def _tree(offset: float = 0.0) -> dict[str, object]:
    transposed = (torch.arange(6.0, dtype=torch.float64) + offset).reshape(2, 3).mT
    tally = Tally.zero(2, torch.device("cpu"))
    return {"weights": {"gain": transposed}, "tally": tally, "list": [torch.zeros(()), {}]}


def test_names_are_dotted_in_the_order_of_the_tree():
    assert list(tensors_of(_tree()))[:3] == ["weights.gain", "tally.value", "tally.gradient"]
    assert list(tensors_of(_tree()))[-2:] == ["tally.first_floored", "list.0"]


def test_what_was_taken_out_is_put_back():
    first = _tree(offset=0.5)
    back = with_tensors(_tree(), tensors_of(first))
    assert isinstance(back["tally"], Tally)
    found, wanted = tensors_of(back), tensors_of(first)
    assert list(found) == list(wanted)
    for name, tensor in found.items():
        assert torch.equal(tensor, wanted[name])
        assert tensor.data_ptr() != wanted[name].data_ptr()
    assert found["weights.gain"].stride() == wanted["weights.gain"].stride()


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"weights.gain": None}, r"weights\.gain is missing, expected \[3, 2\] of float64"),
        ({"list.1": torch.zeros(1)}, r"list\.1 is superfluous"),
        (
            {"list.0": torch.zeros(2)},
            r"list\.0 is \[2\] of float32, expected \[\] of float32",
        ),
        (
            {"tally.finite": torch.zeros(2, 3)},
            r"tally\.finite is \[2, 3\] of float32, expected \[2, 3\] of bool",
        ),
    ],
)
def test_what_does_not_fit_is_named(change: dict[str, torch.Tensor | None], problem: str):
    tensors = {**tensors_of(_tree()), **change}
    with pytest.raises(ValueError, match=problem):
        with_tensors(_tree(), {k: t for k, t in tensors.items() if t is not None})


def test_names_that_say_two_things_are_refused():
    with pytest.raises(ValueError, match=r"two tensors are called a\.b"):
        tensors_of({"a": {"b": torch.zeros(1)}, "a.b": torch.zeros(1)})
