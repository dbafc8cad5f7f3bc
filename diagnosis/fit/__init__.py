"""Effects fitted to windows of flights."""
