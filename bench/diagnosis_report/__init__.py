"""Pages, Markdown and terminal of a diagnosis."""
