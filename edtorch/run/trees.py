"""The tensors of a tree by name, so that they can be saved, and put back into one like it."""

from __future__ import annotations

from typing import Any, TypeVar

from torch import Tensor
from torch.utils import _pytree as pytree

_Tree = TypeVar("_Tree")


def tensors_of(tree: Any) -> dict[str, Tensor]:
    """The leaves of a tree of tensors (not copied), in its order, by their dotted names, e.g.
    ``learners.model.weight``.

    Raises ValueError if two have the same name.
    """
    found = pytree.tree_flatten_with_path(tree)[0]
    named: dict[str, Tensor] = {}
    for path, tensor in found:
        name = ".".join(str(_step(key)) for key in path)
        if name in named:
            raise ValueError(f"two tensors are called {name}, expected names of their own")
        named[name] = tensor
    return named


def with_tensors(tree: _Tree, tensors: dict[str, Tensor]) -> _Tree:
    """A tree of the structure of this one with copies of ``tensors``, on the devices of its own.

    ``tensors_of`` names them.  Raises ValueError naming the first that is missing, is superfluous,
    or has another shape or dtype than the one in ``tree``.
    """
    wanted = tensors_of(tree)
    for name, leaf in wanted.items():
        if name not in tensors:
            raise ValueError(f"{name} is missing, expected {_described(leaf)}")
        if _described(tensors[name]) != _described(leaf):
            raise ValueError(f"{name} is {_described(tensors[name])}, expected {_described(leaf)}")
    for name in tensors:
        if name not in wanted:
            raise ValueError(f"{name} is superfluous, expected no tensor of that name")
    # Copies keep the order of their strides and are aligned: digits can depend on both.
    leaves = [tensors[name].to(leaf.device, copy=True) for name, leaf in wanted.items()]
    return pytree.tree_unflatten(leaves, pytree.tree_structure(tree))


def _step(key: Any) -> Any:
    """What torch calls the name of a field, the key of a dict or the place in a list."""
    return next(getattr(key, kind) for kind in ("name", "key", "idx") if hasattr(key, kind))


def _described(tensor: Tensor) -> str:
    return f"{list(tensor.shape)} of {str(tensor.dtype).removeprefix('torch.')}"
