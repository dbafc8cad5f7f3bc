"""Which cases are drawn, and where they are kept."""
