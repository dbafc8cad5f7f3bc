"""What flies: the point mass (low fidelity), crazyflow (high fidelity), effects, tracking."""
