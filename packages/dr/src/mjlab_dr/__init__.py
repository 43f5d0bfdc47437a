"""Domain randomisation of MuJoCo models: one model, tensors for any engine, or a running simulation."""

from mjlab_dr.apply import Quantity, RandomizeField, apply_all
from mjlab_dr.binding import Component
from mjlab_dr.catalogue import FIELDS, followers_of, needs_constants
from mjlab_dr.distributions import (
  Categorical,
  Custom,
  Distribution,
  Gaussian,
  LogUniform,
  Uniform,
)
from mjlab_dr.draws import agreement, drawn_values
from mjlab_dr.fields import Field, Operation, element_names
from mjlab_dr.inertia import inertia_perturbation, perturb_inertia
from mjlab_dr.randomizers import (
  FieldRandomizer,
  body_com_offset,
  body_mass,
  encoder_bias,
  geom_friction,
  pseudo_inertia,
  randomize_field,
)
from mjlab_dr.standalone import Change, Randomization, RandomizedTensors, randomize

__all__ = [
  "FIELDS",
  "Categorical",
  "Change",
  "Component",
  "Custom",
  "Distribution",
  "Field",
  "FieldRandomizer",
  "Gaussian",
  "LogUniform",
  "Operation",
  "Quantity",
  "Randomization",
  "RandomizeField",
  "RandomizedTensors",
  "Uniform",
  "agreement",
  "apply_all",
  "body_com_offset",
  "body_mass",
  "drawn_values",
  "element_names",
  "encoder_bias",
  "followers_of",
  "geom_friction",
  "inertia_perturbation",
  "needs_constants",
  "perturb_inertia",
  "pseudo_inertia",
  "randomize",
  "randomize_field",
]
