"""Cartpole balance and swing-up tasks."""

from mjlab_cartpole.tasks import balance, swingup

__all__ = ["balance", "swingup"]
