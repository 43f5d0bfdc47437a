"""Report of an identification: one HTML file with tables and pictures inside, which needs no network."""

import base64
import io
from html import escape
from pathlib import Path

import numpy as np
from mjlab_core.io.figures import figure
from mjlab_core.io.files import AtomicWrite

from mjlab_sysid.identified import Identified, Trace
from mjlab_sysid.motors.motor_fit import require_matplotlib

_MAX_ROWS = 1000
_STYLE = "body{font:14px sans-serif;max-width:1100px;margin:2em auto}pre{background:#f4f6f8;padding:1em;overflow:auto}"


def write_report(found: Identified, path: str | Path) -> None:
  """Write a report as HTML; a file of that name is replaced whole.

  Raises:
    ModuleNotFoundError: matplotlib is not installed; the message says how to get it.
  """
  require_matplotlib()
  records = dict.fromkeys(trace.record for trace in found.traces)
  parts = [f"<h1>Identification</h1><pre>{escape(found.summary())}</pre>", _correlations(found)]
  parts += [_motion(record, [t for t in found.traces if t.record == record], found.period) for record in records]
  text = f'<!doctype html><meta charset="utf-8"><title>Identification</title><style>{_STYLE}</style>{"".join(parts)}\n'
  with AtomicWrite(path) as temporary:
    temporary.write_text(text, encoding="utf-8")


def _motion(record: str, traces: list[Trace], period: float) -> str:
  picture = io.BytesIO()
  with figure(picture, (11.0, 1.8 * len(traces)), package="mjlab-sysid", dpi=90) as drawn:
    axes = drawn.subplots(len(traces), 2, squeeze=False, sharex=True)
    for (motion, residual), trace in zip(axes, traces, strict=True):
      time = period * np.arange(len(trace.measured))[:_MAX_ROWS]
      shown = slice(0, _MAX_ROWS)
      motion.plot(time, trace.measured[shown], label="measured", color="lightgray", linewidth=3.0)
      for name, values in (("before", trace.before), ("after", trace.after)):
        motion.plot(time, values[shown], label=name, linewidth=0.8)
        residual.plot(time, (values - trace.measured)[shown], label=name, linewidth=0.8)
      motion.set_ylabel(trace.joint)
    axes[0, 0].legend(loc="upper right")
    axes[0, 0].set_title("position [rad or m]")
    axes[0, 1].set_title("predicted minus measured [rad or m]")
    for axis in axes[-1]:
      axis.set_xlabel("time in windows [s]")
  return f"<h2>{escape(record)}</h2>{_image(picture)}"


def _correlations(found: Identified) -> str:
  information, count = found.information, len(found.estimates)
  picture = io.BytesIO()
  with figure(picture, (11.0, 3.0 + 0.25 * count), package="mjlab-sysid", dpi=90) as drawn:
    matrix, values = drawn.subplots(1, 2)
    names = [estimate.parameter.name for estimate in found.estimates]
    shades = matrix.imshow(information.correlation, vmin=-1.0, vmax=1.0, cmap="RdBu")
    matrix.set_yticks(range(count), names, fontsize=7)
    matrix.set_xticks(range(count), names, fontsize=7, rotation=90)
    matrix.set_title("correlation of fitted values")
    drawn.colorbar(shades, ax=matrix)
    values.semilogy(
      np.arange(1, 1 + len(information.singular_values)), np.maximum(information.singular_values, 1e-12), "o-"
    )
    values.set_title("singular values of the Jacobian")
    values.set_ylabel("residuals in units of noise, per half width of bounds")
    values.set_xlabel("direction")
  return f"<h2>Identifiability</h2>{_image(picture)}"


def _image(picture: io.BytesIO) -> str:
  return f'<img src="data:image/png;base64,{base64.b64encode(picture.getvalue()).decode()}">'
