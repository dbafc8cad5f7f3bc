"""What a team is asked to do, and the rollout that flies it."""
