"""The plug-in kit: what every method, task, simulator, residual and effect must keep to."""
