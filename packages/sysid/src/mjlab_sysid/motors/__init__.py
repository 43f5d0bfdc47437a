"""Fits of motors."""
