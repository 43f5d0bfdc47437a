"""Declarations for the export of policies: sources of observation terms, and targets of actions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import torch

T = TypeVar("T", bound=Callable[..., Any])


@dataclass(frozen=True, kw_only=True)
class Reading:
  """Quantity that a robot, an operator or a motion supplies outside the simulation."""

  name: str
  """Name in policy bundles: "joint/position", "imu/gyro", "command/velocity", "camera/wrist/depth" ...

  A name that begins with "estimate/" needs a state estimator, one with "perception/" a perception system."""
  read: Callable[[], torch.Tensor]
  """Function that returns the present value in the simulation, (num_envs, ...)."""
  unit: str = ""
  frame: str = ""
  """Frame of a vector: a body or a site, or "world"."""
  columns: tuple[str, ...] = ()
  """Meaning of each column."""
  origin: Mapping[str, Any] | None = None
  """Place of the value in a MuJoCo model, as fields of `mjlab_deploy.Origin`; None if MuJoCo cannot supply it."""


@dataclass(frozen=True, kw_only=True)
class TermSource:
  """Computation of an observation term from readings."""

  readings: tuple[Reading, ...]
  compute: Callable[..., torch.Tensor] | None = None
  """Function of the readings, float32 on the CPU each, that returns the value of the term, (N, ...).

  It is traced into the graph of the policy, so it may use tensor operations only. None returns the only reading."""


@dataclass(frozen=True, kw_only=True)
class ActionTargets:
  """Computation of joint targets from an action."""

  quantity: str
  """"position", "velocity" or "effort"."""
  joints: tuple[str, ...]
  """Joints in the order of the targets."""
  compute: Callable[..., torch.Tensor]
  """Function of `(action, *readings)`, or `(action, last targets, *readings)` with `start`, that returns the targets,
  (N, joints)."""
  readings: tuple[Reading, ...] = ()
  start: Callable[..., torch.Tensor] | None = None
  """Function of the readings that replaces the last targets in the first step; None if they are not needed."""


def sourced(describe: Callable[..., TermSource]) -> Callable[[T], T]:
  """Declare the source of an observation term, so that policies with it can be exported.

  Args:
    describe: function of the environment and the parameters of the term that returns the source. A class term has a
      method `source(self)` instead.
  """

  def mark(func: T) -> T:
    vars(func)["source"] = describe
    return func

  return mark
