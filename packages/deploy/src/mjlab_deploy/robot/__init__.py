"""Policies on a robot: interface, loop, safety, remote control and log."""
