"""Result of an identification: estimates, their information, and the file that tasks read."""

import json
import math
import re
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mjlab_core.io.files import AtomicWrite
from mjlab_core.io.tables import table
from mjlab_dr import FIELDS, FieldRandomizer, randomize_field

from mjlab_sysid.parameters import Parameter


class Information(NamedTuple):
  """Information of records about parameters."""

  singular_values: np.ndarray
  """Singular values of the Jacobian in units of noise, of numbers in units of half their bounds, falling."""
  covariance: np.ndarray
  """Covariance of the numbers, (parameters, parameters); that of the prior where a parameter is not identifiable."""

  @property
  def std(self) -> np.ndarray:
    """Standard deviations of the numbers, (parameters,)."""
    return np.sqrt(np.diag(self.covariance))

  @property
  def correlation(self) -> np.ndarray:
    """Correlations of the numbers, (parameters, parameters)."""
    return self.covariance / np.outer(self.std, self.std)


class Estimate(NamedTuple):
  """Estimate of one parameter."""

  parameter: Parameter
  """The parameter."""
  number: float
  """Fitted number; the prior if the parameter is not identifiable."""
  std: float
  """Standard deviation of the number."""
  reason: str
  """Reason why the records do not identify the parameter; empty if they do."""

  @property
  def identifiable(self) -> bool:
    """True if the records identify the parameter."""
    return not self.reason

  @property
  def value(self) -> float:
    """Physical value."""
    return self.parameter.value(self.number)


class Trace(NamedTuple):
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
  is_held_out: bool
  """True if the record was not fitted to."""

  @property
  def errors(self) -> tuple[float, float]:
    """Root mean square errors of the positions before and after the fit [rad or m]."""
    before, after = np.sqrt(np.nanmean(np.square(np.stack((self.before, self.after)) - self.measured), 1)).tolist()
    return before, after


@dataclass(frozen=True, kw_only=True)
class Identified:
  """Fitted parameters of a robot."""

  estimates: tuple[Estimate, ...]
  """Estimates of the parameters."""
  information: Information
  """Information of the records, with the parameters in the order of `estimates`."""
  traces: tuple[Trace, ...] = field(repr=False)
  """Positions by record and joint."""
  period: float
  """Time between two rows of a trace [s]."""
  sources: tuple[str, ...]
  """Records that were fitted to."""
  overlay: dict[str, Any] = field(default_factory=dict, repr=False)
  """Physical values of identifiable parameters: `model`, `actuators`, `delay`, `encoder_bias`, `timestep`."""
  stopped: bool = False
  """True if the fit was ended before it converged."""

  @property
  def numbers(self) -> np.ndarray:
    """Fitted numbers, (parameters,)."""
    return np.array([estimate.number for estimate in self.estimates])

  def value(self, name: str) -> float:
    """Return the physical value of a parameter."""
    return next(estimate.value for estimate in self.estimates if estimate.parameter.name == name)

  def randomizers(self, width: float = 2.0) -> list[FieldRandomizer]:
    """Return randomisers that draw each identifiable parameter uniformly, `width` standard deviations about its value.

    They are for a robot with the overlay, whose defaults are the fitted values. Delays, which are drawn in whole
    timesteps, are left out.
    """
    out = []
    for estimate in self.estimates:
      parameter, operation = estimate.parameter, estimate.parameter.operation
      if not estimate.identifiable or parameter.field == "delay":
        continue
      reach = width * estimate.std
      middle = 0.0 if operation == "add" else estimate.value
      if operation == "scale":
        reach, operation = reach * abs(parameter.defaults[0]), "absolute"
      row = FIELDS[parameter.field]
      low = max(middle - reach, row.minimum[0] if len(row.minimum) == 1 else -math.inf)
      if row.kind == "target":
        operation, low, middle, reach = "scale", low / middle, 1.0, reach / middle
      out.append(
        randomize_field(
          parameter.field,
          [re.escape(element) for element in parameter.elements],
          {parameter.axis: (low, middle + reach)},
          operation=operation,
          shared=len(parameter.elements) > 1,
        )
      )
    return out

  def summary(self) -> str:
    """Return a table of the parameters, and one of the errors."""
    rows = []
    for estimate in self.estimates:
      parameter, shown = estimate.parameter, ("-", "-")
      if estimate.identifiable:
        low, high = sorted(parameter.value(estimate.number + sign * estimate.std) for sign in (-1.0, 1.0))
        shown = f"{estimate.value:.4g}", f"{0.5 * (high - low):.2g}"
      rows.append((parameter.name, f"{parameter.value(parameter.start):.4g}", *shown, estimate.reason))
    errors = [
      (trace.record + trace.is_held_out * " (held out)", trace.joint, *(f"{error:.4g}" for error in trace.errors))
      for trace in self.traces
    ]
    parameters = table(("parameter", "prior", "fitted", "std", "not identifiable, because"), rows)
    return f"{parameters}\n\n{table(('record', 'joint', 'error before [rad or m]', 'after'), errors)}"

  def save(self, path: str | Path) -> None:
    """Write the overlay file; a file of that name is replaced whole."""
    content: dict[str, Any] = {
      "format": "mjlab overlay 1",
      "records": self.sources,
      **self.overlay,
      "parameters": [
        asdict(estimate.parameter)
        | {
          "number": estimate.number,
          "std": estimate.std,
          "identifiable": estimate.identifiable,
          "reason": estimate.reason,
        }
        for estimate in self.estimates
      ],
      "covariance": self.information.covariance.tolist(),
      "singular_values": self.information.singular_values.tolist(),
      "scores": [
        {
          "record": trace.record,
          "joint": trace.joint,
          "before": trace.errors[0],
          "after": trace.errors[1],
          "is_held_out": trace.is_held_out,
        }
        for trace in self.traces
      ],
    }
    with AtomicWrite(path) as temporary:
      temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
