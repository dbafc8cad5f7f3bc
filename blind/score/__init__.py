"""What answers are worth: scores, bounds, baselines, limits."""
