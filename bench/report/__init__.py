"""Boards, figures and pages of a sweep."""
