"""Policies of other projects as bundles, and files for other runners."""
