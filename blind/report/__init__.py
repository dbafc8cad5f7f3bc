"""The report on a blind run."""
