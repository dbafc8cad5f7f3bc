"""Commands that run a suite, or show what there is to run."""
