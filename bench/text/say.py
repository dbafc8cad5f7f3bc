"""Lines on a terminal that mean what they say: no markup, no colours of numbers, no wrapping."""

from rich.console import Console
from rich.text import Text


def say(console: Console, text: object, style: str = "") -> None:
    """Prints one line as it is."""
    console.print(Text(str(text), style), soft_wrap=True)
