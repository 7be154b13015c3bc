"""Packages that only some searches need, and that extras of edtorch install."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any

from edtorch.errors import Unavailable


@dataclass(frozen=True)
class Package:
    """name: of the package; extra: that of edtorch which installs it."""

    name: str
    extra: str

    def module(self) -> Any:
        """It, imported.  Raises Unavailable where it is missing."""
        try:
            return importlib.import_module(self.name)
        except ImportError as error:
            raise Unavailable(
                f"{self.name} cannot be imported ({error}): pip install 'edtorch[{self.extra}]'"
            ) from error
