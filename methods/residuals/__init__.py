"""Classes of residual: what is added to the point mass's acceleration."""
