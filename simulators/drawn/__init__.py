"""Realities that are drawn anew in every episode: teams that are not alike, seen by sensors."""
