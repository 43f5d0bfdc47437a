"""Derived constants per world."""
