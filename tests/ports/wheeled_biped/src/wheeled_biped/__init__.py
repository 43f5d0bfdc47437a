"""Balancing of a robot with two legs that end in wheels, in the manner of Upkie."""

from wheeled_biped.task import balance

__all__ = ["balance"]
