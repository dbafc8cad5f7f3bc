"""Measures whether tests notice small changes of the code that they test."""
