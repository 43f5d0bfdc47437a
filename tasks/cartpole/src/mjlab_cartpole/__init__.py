"""Cartpole balance and swing-up tasks."""
