"""The paper's Figure 3 of several runs at once, from what their folders hold.

    python -m studies.cardea_figure FOLDER FILE LABEL=RUN [LABEL=RUN ...]

Writes ``FILE.png`` and ``FILE.svg`` into ``FOLDER``.
"""

from __future__ import annotations

import sys
from pathlib import Path

from edtorch.report.figures import save_figure
from edtorch.report.reaching import PANELS, reaching_curve
from studies.episodes import episodes_of


def main() -> None:
    folder, name, *given = sys.argv[1:]
    pairs = (argument.partition("=") for argument in given)
    runs = {
        label: episodes_of(Path(path), [name for name, _ in PANELS]) for label, _, path in pairs
    }
    title = "Cardea: error and speed at the ends of the episodes, with 2 % torque noise"
    save_figure(reaching_curve(runs, title), Path(folder), name)


if __name__ == "__main__":
    main()
