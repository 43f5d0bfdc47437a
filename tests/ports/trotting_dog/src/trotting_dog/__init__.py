"""Walking of the Go1 with rewards, clock and learner of another package, on the velocity command of mjlab."""

from trotting_dog.task import trot

__all__ = ["trot"]
