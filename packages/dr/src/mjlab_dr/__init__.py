"""Domain randomisation of MuJoCo models: one model, tensors for any engine, or a running simulation."""

from mjlab_dr.apply import ModelFields, RandomizeField, apply_all
from mjlab_dr.catalogue import FIELDS, Field
from mjlab_dr.distributions import Distribution, Gaussian, LogUniform, Uniform
from mjlab_dr.randomizers import FieldRandomizer, body_com_offset, encoder_bias, geom_friction, randomize_field
from mjlab_dr.standalone import Change, Randomization, randomize

__all__ = [
  "FIELDS",
  "Change",
  "Distribution",
  "Field",
  "FieldRandomizer",
  "Gaussian",
  "LogUniform",
  "ModelFields",
  "Randomization",
  "RandomizeField",
  "Uniform",
  "apply_all",
  "body_com_offset",
  "encoder_bias",
  "geom_friction",
  "randomize",
  "randomize_field",
]
