"""Picture of what the pseudo-inertia randomiser does to a body: `python tools/picture_inertia.py`.

Marginals of mass, centre of mass and principal moments for three sizes of perturbation, from a box of 0.3 x 0.2 x
0.1 m and 4 kg whose frame is at one of its ends.
"""

import argparse
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import torch
from mjlab_dr import perturb_inertia

SIZES = (0.1, 0.2, 0.4)
COLOURS = ("#1b6ca8", "#d9822b", "#6a994e")
MASS, COM = 4.0, (0.15, 0.0, 0.0)
LENGTHS = (0.3, 0.2, 0.1)
SAMPLES = 200_000


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("--output", type=Path, default=Path(__file__).parents[1] / "docs/pictures/pseudo_inertia.png")
  output: Path = parser.parse_args().output
  second = MASS / 12.0 * torch.tensor(LENGTHS, dtype=torch.float64).square()
  inertia = second.sum() - second
  figure, axes = plt.subplots(2, 4, figsize=(15, 6.4), layout="constrained")
  panels = axes.ravel()
  for size, colour in zip(SIZES, COLOURS, strict=True):
    generator = torch.Generator().manual_seed(0)
    draw = size * (2.0 * torch.rand(SAMPLES, 10, generator=generator, dtype=torch.float64) - 1.0)
    draw[:, 7:] *= 0.1
    before = torch.tensor(MASS), torch.tensor(COM), inertia, torch.tensor([1.0, 0.0, 0.0, 0.0])
    mass, com, moments, quat = perturb_inertia(*before, draw)
    turn = torch.rad2deg(2.0 * quat[:, 0].abs().clamp(max=1.0).acos())
    columns = [
      ("mass [kg]", mass, MASS),
      *((f"centre of mass {axis} [m]", com[:, i], COM[i]) for i, axis in enumerate("xyz")),
      *((f"principal moment {i + 1} [kg m²]", moments[:, i], float(inertia[i])) for i in range(3)),
      ("turn of the principal axes [deg]", turn, 0.0),
    ]
    for panel, (name, values, default) in zip(panels, columns, strict=True):
      panel.hist(
        values.numpy(), bins=120, density=True, histtype="step", color=colour, label=f"±{size:g}", linewidth=1.4
      )
      panel.axvline(default, color="0.5", linewidth=0.8, linestyle=":")
      panel.set_xlabel(name)
      panel.set_yticks([])
      panel.spines[["top", "right", "left"]].set_visible(False)
  panels[0].legend(frameon=False, title="alpha, d, s; t a tenth in m")
  figure.suptitle(
    "pseudo_inertia: what uniform draws of the ten parameters make of a box of 0.3 x 0.2 x 0.1 m, 4 kg", y=1.04
  )
  figure.savefig(output, dpi=110, bbox_inches="tight")
  print(f"wrote {output}")


if __name__ == "__main__":
  main()
