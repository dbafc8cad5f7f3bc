"""A method at work: what configurations share once they have a cell, its bill and its profile."""
