"""A blind run from draw to report."""
