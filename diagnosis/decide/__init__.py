"""Which effects are blamed, and how sure that is."""
