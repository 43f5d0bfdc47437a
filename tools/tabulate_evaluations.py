"""Evaluations beside one another: a Markdown table of what `evaluate` wrote, one row each.

python tools/tabulate_evaluations.py "400 iterations=a/evaluation" "800 iterations=b/evaluation" --groups all
"""

import argparse
import json
from pathlib import Path


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("evaluations", nargs="+", metavar="NAME=FOLDER", help="folder with evaluation.json")
  parser.add_argument("--groups", nargs="*", help="rows of each evaluation; all by default")
  parser.add_argument("--metrics", nargs="*", help="columns; all by default")
  args = parser.parse_args()
  metrics: list[str] = []
  for number, item in enumerate(args.evaluations):
    name, folder = item.split("=", 1)
    data = json.loads((Path(folder) / "evaluation.json").read_text(encoding="utf-8"))
    if not number:
      metrics = args.metrics or list(next(iter(data["groups"].values())))
      units = [f" [{data['units'][metric]}]" if data["units"].get(metric) else "" for metric in metrics]
      heads = [metric.replace("_", " ") + unit for metric, unit in zip(metrics, units, strict=True)]
      print(f"| | {' | '.join(heads)} |\n|{'---|' * (len(heads) + 1)}")
    for group in args.groups or data["groups"]:
      values = [data["groups"][group][metric] for metric in metrics]
      cells = ["-" if v["mean"] is None else f"{v['mean']:.3g} ({v['low']:.3g} .. {v['high']:.3g})" for v in values]
      print(f"| {name if group == 'all' else f'{name}, {group}'} | {' | '.join(cells)} |")


if __name__ == "__main__":
  main()
