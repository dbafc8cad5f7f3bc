"""Answers that a change of structure must not move: `python -m tests.golden`, or `make golden`."""
