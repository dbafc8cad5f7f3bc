"""Logs replayed through a simulator with candidate effects."""
