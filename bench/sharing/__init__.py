"""Results for others: in the formats of other tools, and as a folder for a pull request."""
