"""Old module names are the present modules."""

import importlib

import pytest
from hydra.utils import get_class

import edtorch
from edtorch.renamed import RENAMED, current_name, current_target

assert edtorch.__version__  # importing the package installs the aliases


@pytest.mark.parametrize("old", sorted(RENAMED))
def test_an_old_name_is_the_present_module(old: str) -> None:
    module = importlib.import_module(old)
    assert module is importlib.import_module(RENAMED[old])
    assert module.__name__ == RENAMED[old]
    assert module.__spec__ is not None and module.__spec__.name == RENAMED[old]


def test_what_lies_within_a_renamed_package() -> None:
    assert current_name("edtorch.closed_form.lqr") == "edtorch.value.linear.lqr"
    assert current_name("edtorch.closed_form.linear") == "edtorch.value.linear.loop"
    assert current_name("edtorch.transform.first") is None
    assert current_name("numpy") is None


def test_a_name_that_never_was_is_not_found() -> None:
    with pytest.raises(ModuleNotFoundError, match=r"edtorch\.fitting"):
        importlib.import_module("edtorch.fitting")
    with pytest.raises(ModuleNotFoundError):
        importlib.import_module("edtorch.closed_form.nothing")


def test_a_class_under_its_old_name() -> None:
    assert current_target("edtorch.fit.SquaredError") == "edtorch.model.fit.SquaredError"
    products = current_target("edtorch.inverse.features.Pairwise")
    assert get_class(products).__name__ == "PairwiseProducts"
    assert current_target("numpy.array") == "numpy.array"


def test_a_former_module_that_is_now_a_package_has_what_it_had() -> None:
    former = importlib.import_module("edtorch.transitions")
    present = importlib.import_module("edtorch.run.transitions_file")
    for name in ("FORMAT", "Recorded", "Loaded", "gathered", "joined", "load_transitions"):
        assert getattr(former, name) is getattr(present, name)
    assert get_class(current_target("edtorch.transitions.Recorded")) is present.Recorded
