"""Result of an identification: values, covariance, what was told, and the file that tasks read."""

import json
import math
import re
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mjlab_core.files import AtomicWrite
from mjlab_core.tables import table
from mjlab_dr import FIELDS, FieldRandomizer, Operation, randomize_field

from mjlab_sysid.parameters import Parameter


@dataclass(frozen=True, kw_only=True)
class Score:
  """Error of the predicted positions of one joint in one record, over windows."""

  record: str
  """Source of the record."""
  joint: str
  """Name of the joint."""
  before: float
  """Root mean square with the compiled parameters [rad or m]."""
  after: float
  """Root mean square with the fitted parameters [rad or m]."""
  is_held_out: bool
  """True if the record was not fitted to."""


@dataclass(frozen=True, kw_only=True)
class Trace:
  """Positions of one joint in one record: window after window, each from its measured state."""

  record: str
  """Source of the record."""
  joint: str
  """Name of the joint."""
  measured: np.ndarray
  """Measured positions, (rows,) [rad or m]."""
  before: np.ndarray
  """Positions with the compiled parameters, (rows,) [rad or m]."""
  after: np.ndarray
  """Positions with the fitted parameters, (rows,) [rad or m]."""


@dataclass(frozen=True, kw_only=True)
class Identified:
  """Fitted parameters of a robot."""

  parameters: tuple[Parameter, ...]
  """The parameters, in the order of all arrays."""
  numbers: np.ndarray
  """Fitted numbers, (parameters,); the prior where the records cannot tell."""
  covariance: np.ndarray
  """Covariance of the numbers, (parameters, parameters); that of the prior where the records cannot tell."""
  told: np.ndarray
  """True where the records tell, bool (parameters,)."""
  reasons: tuple[str, ...]
  """Reason why the records cannot tell a parameter; empty where they can."""
  singular_values: np.ndarray
  """Singular values of the Jacobian in units of noise, of numbers in units of half their bounds, falling."""
  scores: tuple[Score, ...]
  """Errors by record and joint."""
  traces: tuple[Trace, ...] = field(repr=False)
  """Positions by record and joint."""
  period: float
  """Time between two rows of a trace [s]."""
  sources: tuple[str, ...]
  """Records that were fitted to."""
  overlay: dict[str, Any] = field(default_factory=dict, repr=False)
  """Physical values of what the records tell: `model`, `actuators`, `delay`, `encoder_bias`, `timestep`."""
  stopped: bool = False
  """True if the fit was ended before it converged."""

  def value(self, name: str) -> float:
    """Return the physical value of a parameter."""
    index = [parameter.name for parameter in self.parameters].index(name)
    return self.parameters[index].value(float(self.numbers[index]))

  @property
  def spread(self) -> np.ndarray:
    """Standard deviations of the numbers, (parameters,)."""
    return np.sqrt(np.diag(self.covariance))

  @property
  def correlation(self) -> np.ndarray:
    """Correlations of the numbers, (parameters, parameters)."""
    return self.covariance / np.outer(self.spread, self.spread)

  def randomizers(self, width: float = 2.0) -> list[FieldRandomizer]:
    """Return randomisers that draw each told parameter uniformly, so many standard deviations about its value.

    They are for a robot with the overlay, whose defaults are the fitted values. Delays, which are drawn in whole
    timesteps, are left out.
    """
    out = []
    for parameter, number, spread, told in zip(self.parameters, self.numbers, self.spread, self.told, strict=True):
      if not told or parameter.field == "delay":
        continue
      reach = width * float(spread)
      middle = 0.0 if parameter.operation == "add" else parameter.value(float(number))
      reach *= abs(parameter.default) if parameter.operation == "scale" else 1.0
      row = FIELDS[parameter.field]
      low = max(middle - reach, row.minimum[0] if len(row.minimum) == 1 else -math.inf)
      operation: Operation = "add" if parameter.operation == "add" else "absolute"
      if row.kind == "target":
        operation, low, middle, reach = "scale", low / middle, 1.0, reach / middle
      values = {parameter.axis: (low, middle + reach)} if parameter.axis else (low, middle + reach)
      out.append(
        randomize_field(
          parameter.field,
          [re.escape(element) for element in parameter.elements],
          values,
          operation=operation,
          shared=len(parameter.elements) > 1,
        )
      )
    return out

  def summary(self) -> str:
    """Return a table of the parameters, and one of the errors."""
    rows = []
    for parameter, number, spread, told, reason in zip(
      self.parameters, self.numbers, self.spread, self.told, self.reasons, strict=True
    ):
      low, high = sorted(parameter.value(number + sign * spread) for sign in (-1.0, 1.0))
      shown = f"{parameter.value(number):.4g}"
      rows.append(
        (
          parameter.name,
          f"{parameter.value(parameter.start):.4g}",
          shown if told else "-",
          f"{0.5 * (high - low):.2g}" if told else "-",
          reason,
        )
      )
    errors = [
      (
        score.record + (" (held out)" if score.is_held_out else ""),
        score.joint,
        f"{score.before:.4g}",
        f"{score.after:.4g}",
      )
      for score in self.scores
    ]
    return "\n\n".join(
      (
        table(("parameter", "prior", "fitted", "std", "not told, because"), rows),
        table(("record", "joint", "error before [rad or m]", "after"), errors),
      )
    )

  def save(self, path: str | Path) -> None:
    """Write the overlay file; a file of that name is replaced whole."""
    content: dict[str, Any] = {
      "format": "mjlab overlay 1",
      "records": list(self.sources),
      **self.overlay,
      "parameters": [
        {
          "name": parameter.name,
          "field": parameter.field,
          "axis": parameter.axis,
          "elements": list(parameter.elements),
          "operation": parameter.operation,
          "number": float(number),
          "std": float(spread),
          "bounds": [parameter.lo, parameter.hi],
          "told": bool(told),
          "reason": reason,
        }
        for parameter, number, spread, told, reason in zip(
          self.parameters, self.numbers, self.spread, self.told, self.reasons, strict=True
        )
      ],
      "covariance": self.covariance.tolist(),
      "singular_values": self.singular_values.tolist(),
      "scores": [asdict(score) for score in self.scores],
    }
    with AtomicWrite(path) as temporary:
      temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
