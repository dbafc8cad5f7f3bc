"""Flight logs: read, checked, cut into windows."""
