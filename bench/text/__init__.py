"""Texts that all wings write: numbers, Markdown, pages, errors."""
