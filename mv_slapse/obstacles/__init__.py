"""Filters of the moving obstacles, one for each."""
