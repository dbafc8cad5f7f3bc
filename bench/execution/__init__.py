"""How runs are executed: workers, executors, progress, a sweep from start to end."""
