"""Observations: terms, noise, memory and their description for deployment."""
