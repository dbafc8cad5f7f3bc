"""What the rows say: estimates, verdicts, scores, ranks, costs."""
