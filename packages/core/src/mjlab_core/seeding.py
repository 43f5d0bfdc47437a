"""Seeds: one call for the process, and generators that belong to one owner."""

from __future__ import annotations

import random
import secrets

import numpy as np
import torch


def draw_seed() -> int:
  """A seed from the operating system, in [0, 2^31)."""
  return secrets.randbelow(2**31)


def seed_everything(seed: int | None = None) -> int:
  """Seeds the global generators of Python, NumPy and torch (all devices); returns the seed used, drawn if None.

  Raises:
    ValueError: It does not fit into 64 bits.
  """
  seed = draw_seed() if seed is None else _checked(seed)
  random.seed(seed)
  # The legacy call is meant: libraries that draw from NumPy's global state are the ones to be reached.
  np.random.seed(seed % 2**32)  # noqa: NPY002
  torch.manual_seed(seed)
  return seed


def make_generator(device: torch.device | str, seed: int) -> torch.Generator:
  """A generator on `device` that starts from `seed`.

  Raises:
    ValueError: The seed does not fit into 64 bits.
  """
  return torch.Generator(device=device).manual_seed(_checked(seed))


def _checked(seed: int) -> int:
  if not -(2**63) <= seed < 2**64:
    raise ValueError(f"seed {seed} does not fit into 64 bits")
  return seed
