"""Own rows as a folder that a pull request can carry, and the check of such a folder."""
