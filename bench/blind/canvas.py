"""What all figures of the blind report have in common."""

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

OUR_COLOR = "#00527f"
"""The accent of the pages."""
STYLE: Any = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}
"""Settings of every figure."""


def saved(figure: Figure, path: Path) -> bool:
    """True, after the figure was written and closed."""
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return True
