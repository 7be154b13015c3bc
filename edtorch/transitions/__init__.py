"""Recorded transitions: other formats read into ours (``read``), and our file format.

``read`` takes Minari's and D4RL's layouts and CSV logs; ``save_transitions`` and
``load_transitions`` are those of ``edtorch.run.transitions_file`` (docs/offline.md).
"""

from __future__ import annotations

from edtorch.run.recorded import Recorded
from edtorch.run.transitions_file import (
    Invalid,
    Loaded,
    gathered,
    joined,
    load_transitions,
    save_transitions,
)
from edtorch.run.transitions_meta import FORMAT
from edtorch.transitions.columns import FileColumn, described_spec, parse_column
from edtorch.transitions.reading import Imported, read, save_imported

__all__ = [
    "FORMAT",
    "FileColumn",
    "Imported",
    "Invalid",
    "Loaded",
    "Recorded",
    "described_spec",
    "gathered",
    "joined",
    "load_transitions",
    "parse_column",
    "read",
    "save_imported",
    "save_transitions",
]
