"""What is learned from calibration flights: residuals, lags, effects."""
