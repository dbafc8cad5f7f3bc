"""How a policy is trained: one file a configuration, residual classes, calibration, trainer."""
