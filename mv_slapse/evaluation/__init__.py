"""Errors of a run against truth."""
