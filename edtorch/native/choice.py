"""Whether a part is compiled."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Literal, TypeVar

from edtorch.errors import Unavailable
from edtorch.native.plan import NoKernel

logger = logging.getLogger("edtorch")

Mode = Literal["auto", "on", "off"]
"""Whether kernels are used: where the parts have them, or else it is an error, or never."""

_Kernel = TypeVar("_Kernel")


def kernel_for(mode: Mode, build: Callable[[], _Kernel], what: str) -> _Kernel | None:
    """What ``build`` compiles; None with ``off``, and with ``auto`` where it raises NoKernel or
    Unavailable, which is logged.  ValueError instead with ``on``."""
    if mode == "off":
        return None
    try:
        return build()
    except NoKernel as error:
        reason = f"there is no kernel for {error}"
    except Unavailable as error:
        reason = str(error)
    if mode == "on":
        raise ValueError(f"{reason}; expected compute.native=auto or off instead of on")
    logger.warning("%s uncompiled, many times slower: %s", what, reason)
    return None
