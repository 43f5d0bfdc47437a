"""Policy bundles: read, verify, run in MuJoCo C or on a robot. NumPy, MuJoCo and ONNX Runtime only."""

from mjlab_deploy.bundle import Bundle, describe, open_bundle, pack, write_description
from mjlab_deploy.description import (
  FORMAT,
  Command,
  Description,
  Golden,
  Input,
  Joint,
  Memory,
  Motion,
  Observation,
  Origin,
  Robot,
  Target,
  Timing,
)
from mjlab_deploy.errors import DeployError
from mjlab_deploy.policy import Policy, Step

__all__ = [
  "FORMAT",
  "Bundle",
  "Command",
  "DeployError",
  "Description",
  "Golden",
  "Input",
  "Joint",
  "Memory",
  "Motion",
  "Observation",
  "Origin",
  "Policy",
  "Robot",
  "Step",
  "Target",
  "Timing",
  "describe",
  "open_bundle",
  "pack",
  "write_description",
]
