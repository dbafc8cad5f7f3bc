"""The laboratory that checks the diagnosis on causes that it is not told."""
