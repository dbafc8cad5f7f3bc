"""What configurations share while they train: in low or high fidelity, billed and profiled."""
