"""Rotations and small products, written out for speed and gradients."""
