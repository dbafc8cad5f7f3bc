"""Flights whose cause is withheld from the diagnosis, and how its answers are scored."""
