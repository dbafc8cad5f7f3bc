"""What should be run: suites, settings, keys, and where a result comes from."""
