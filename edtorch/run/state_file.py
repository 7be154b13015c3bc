"""States in files: nested dicts and lists of tensors, arrays and plain values, and nothing else.

A file is one safetensors file.  Its metadata hold a JSON text with the structure and the plain
values; the tensors lie beside it, by dotted name.  Reading constructs tensors, arrays and plain
values only.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from edtorch.run.files import FileProblem, write_atomically

STATE_FORMAT = 1
"""Of the files that this version writes; older ones are read."""

_TENSOR, _ARRAY = "$tensor", "$array"


def save_state(path: Path, state: Mapping[str, Any]) -> None:
    """Write ``state`` atomically.

    Its values are dicts with texts as keys, lists, tensors, numpy arrays, bool, int, float, str and
    None.  Raises TypeError, with the dotted name, for anything else, and OSError.
    """
    arrays: dict[str, np.ndarray[Any, Any]] = {}
    text = json.dumps(_plain("", dict(state), arrays))
    metadata = {"format": str(STATE_FORMAT), "state": text, "digest": _digest(text, arrays)}

    def write(partial: Path) -> None:
        try:
            save_file(arrays, partial, metadata)
        except SafetensorError as error:
            raise OSError(f"{path}: {error}") from error  # of a full disk, for instance
        # safetensors writes files that nobody else may read.
        mask = os.umask(0)
        os.umask(mask)
        partial.chmod(0o666 & ~mask)

    write_atomically(path, write)


def load_state(path: Path) -> dict[str, Any]:
    """What ``save_state`` has written.

    Raises FileProblem for a file that is damaged, that something else has written, or a later
    version.
    """
    try:
        with safe_open(path, framework="np") as file:
            metadata = file.metadata() or {}
            _check_format(path, metadata.get("format"))
            arrays = {name: file.get_tensor(name) for name in file.keys()}
    except (OSError, SafetensorError) as error:
        raise FileProblem(f"{path}: damaged, or no checkpoint ({error})") from error
    text = metadata.get("state", "")
    if _digest(text, arrays) != metadata.get("digest"):
        raise FileProblem(f"{path}: damaged (its content does not match its digest)")
    return _read(json.loads(text), arrays)


def _check_format(path: Path, found: str | None) -> None:
    if found is None or not found.isdigit():
        raise FileProblem(f"{path}: damaged, or no checkpoint (it names no format)")
    if int(found) > STATE_FORMAT:
        raise FileProblem(
            f"{path}: has format {found}, expected {STATE_FORMAT} at most: written by a later"
            " version of edtorch"
        )


def _plain(name: str, value: Any, arrays: dict[str, np.ndarray[Any, Any]]) -> Any:
    """``value`` for JSON; its tensors and arrays go to ``arrays``."""
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, torch.Tensor):
        order = _memory_order(value)
        arrays[name] = _contiguous(value.detach().cpu().permute(order).numpy())
        return {_TENSOR: name, "order": order}
    if isinstance(value, np.ndarray):
        arrays[name] = _contiguous(value)
        return {_ARRAY: name}
    if isinstance(value, list | tuple):
        return [_plain(f"{name}.{k}", each, arrays) for k, each in enumerate(value)]
    if isinstance(value, dict) and all(isinstance(key, str) for key in value):
        if value.keys() & {_TENSOR, _ARRAY}:
            raise TypeError(f"{name}: has a key {_TENSOR} or {_ARRAY}, expected others")
        return {key: _plain(f"{name}.{key}", each, arrays) for key, each in value.items()}
    raise TypeError(
        f"{name}: is {type(value).__name__}, expected tensors, arrays, plain values, or dicts and"
        " lists of them"
    )


def _memory_order(tensor: torch.Tensor) -> list[int]:
    """Its axes as they lie in memory, the innermost last: sums of products, and so the digits of
    what follows, depend on that."""
    return sorted(range(tensor.ndim), key=lambda axis: -tensor.stride(axis))


def _contiguous(array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    return np.ascontiguousarray(array).reshape(array.shape)  # which keeps [] what it is


def _read(value: Any, arrays: Mapping[str, np.ndarray[Any, Any]]) -> Any:
    if isinstance(value, list):
        return [_read(each, arrays) for each in value]
    if isinstance(value, dict):
        if _TENSOR in value:
            order = value["order"]
            places = sorted(range(len(order)), key=lambda axis: order[axis])
            return torch.from_numpy(arrays[value[_TENSOR]]).permute(places)
        if _ARRAY in value:
            return arrays[value[_ARRAY]]
        return {key: _read(each, arrays) for key, each in value.items()}
    return value


def _digest(text: str, arrays: Mapping[str, np.ndarray[Any, Any]]) -> str:
    found = hashlib.blake2b(text.encode(), digest_size=16)
    for name in sorted(arrays):
        array = arrays[name]
        found.update(f"{name} {array.dtype} {array.shape}".encode())
        found.update(np.ascontiguousarray(array).reshape(-1).view(np.uint8).data)
    return found.hexdigest()
