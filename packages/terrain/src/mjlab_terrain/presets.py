"""Sets of types of tile with useful settings, and changes of settings given as text."""

from __future__ import annotations

import ast
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from mjlab_terrain.tile_cfg import TileCfg
from mjlab_terrain.types.boxes import FlatCfg, RandomBoxesCfg, RandomGridCfg, TiltedGridCfg
from mjlab_terrain.types.gaps import NarrowBeamsCfg, NestedRingsCfg, SteppingStonesCfg
from mjlab_terrain.types.heights import (
  DiscreteObstaclesCfg,
  PerlinNoiseCfg,
  PyramidSlopeCfg,
  RandomRoughCfg,
  WavesCfg,
)
from mjlab_terrain.types.stairs import OpenStairsCfg, PyramidStairsCfg, RandomStairsCfg


def all_types() -> dict[str, TileCfg]:
  """Return one of every type, by name, each from easy to hard for a robot with legs of half a metre."""
  return {
    "flat": FlatCfg(),
    "stairs_up": PyramidStairsCfg(),
    "stairs_down": PyramidStairsCfg(inverted=True),
    "open_stairs": OpenStairsCfg(),
    "random_stairs": RandomStairsCfg(),
    "random_grid": RandomGridCfg(),
    "random_boxes": RandomBoxesCfg(),
    "tilted_grid": TiltedGridCfg(tilt=(0.0, 20.0), height=(0.0, 0.3)),
    "stepping_stones": SteppingStonesCfg(size_variation=(0.0, 0.2)),
    "narrow_beams": NarrowBeamsCfg(),
    "nested_rings": NestedRingsCfg(),
    "slope_up": PyramidSlopeCfg(),
    "slope_down": PyramidSlopeCfg(inverted=True),
    "random_rough": RandomRoughCfg(),
    "waves": WavesCfg(),
    "discrete_obstacles": DiscreteObstaclesCfg(),
    "perlin_noise": PerlinNoiseCfg(),
  }


def walking_types() -> dict[str, TileCfg]:
  """Return a mix for learning to walk: level ground, stairs and slopes up and down, rough ground and waves."""
  return {
    "flat": FlatCfg(share=0.2),
    "stairs_up": PyramidStairsCfg(share=0.2),
    "stairs_down": PyramidStairsCfg(share=0.2, inverted=True),
    "slope_up": PyramidSlopeCfg(share=0.1),
    "slope_down": PyramidSlopeCfg(share=0.1, inverted=True),
    "random_rough": RandomRoughCfg(share=0.1),
    "waves": WavesCfg(share=0.1),
  }


def apply_settings(types: dict[str, TileCfg], assignments: Sequence[str]) -> None:
  """Change settings of `types`: "setting=value" of all types that have it, "type.setting=value" of one.

  Raises:
    ValueError: an assignment names a type or setting that does not exist, or its value cannot be read.
  """
  for assignment in assignments:
    target, _, text = assignment.partition("=")
    type_name, _, setting = target.rpartition(".")
    meant = [name for name in types if type_name in ("", name)]
    if not meant:
      raise ValueError(f"'{assignment}': there is no type '{type_name}' here. There are {', '.join(types)}.")
    known = sorted({setting for name in meant for setting in vars(types[name])})
    if setting not in known:
      raise ValueError(f"'{assignment}': there is no setting '{setting}'. There are {', '.join(known)}.")
    for name in meant:
      if setting in vars(types[name]):
        value = _read(text, getattr(types[name], setting), assignment)
        types[name] = replace(types[name], **{setting: value})


def _read(text: str, present: Any, assignment: str) -> Any:
  """Return the value of `text`, of the same kind as the present value."""
  try:
    value = ast.literal_eval(text)
  except (SyntaxError, ValueError):
    value = {"true": True, "yes": True, "false": False, "no": False}.get(text.lower(), text)
  # A setting that is None takes a number.
  if _kind(value) != _kind(0 if present is None else present):
    raise ValueError(f"'{assignment}': the value must be like {present!r}, without brackets.")
  return value


def _kind(value: object) -> object:
  return next((kind for kind in (bool, int | float, str, tuple) if isinstance(value, kind)), None)
