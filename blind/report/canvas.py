"""What all figures of the blind report have in common."""

from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

OUR_COLOR = "#00527f"
"""The accent of the pages."""


def saved(figure: Figure, path: Path) -> bool:
    """True, after the figure was written and closed."""
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return True
