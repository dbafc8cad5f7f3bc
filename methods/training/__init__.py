"""Training a policy by gradients through a simulator, and evaluating it."""
