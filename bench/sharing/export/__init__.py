"""Rows and learning curves in the formats of other tools; `formats.py` lists them."""
