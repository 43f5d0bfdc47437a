"""Runs of the tests beside busy loops: `uv run python tools/repeat_tests.py --times 10 --busy 4 -- packages/viewer`.

Each run has its own cores, on which its busy loops run too, so that tests get only a share of them. A test that
depends on how fast the machine is fails here. `--parallel` starts several runs at once, each on cores of its own. The
exit code is 0 if every run passed.
"""

import argparse
import os
import queue
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path


def run(index: int, cores: list[int], busy: int, shards: list[list[str]], output: Path) -> str:
  """Run the tests once beside busy loops; return the last line of each process, and how it failed if it did."""
  pin = ["taskset", "--cpu-list", ",".join(map(str, cores))]
  loops = [subprocess.Popen([*pin, sys.executable, "-c", "while True: pass"]) for _ in range(busy)]
  logs = [output / f"run_{index}_{shard}.log" for shard in range(len(shards))]
  try:
    running = []
    for log, arguments in zip(logs, shards, strict=True):
      command = [*pin, sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *arguments]
      with log.open("w") as file:
        running.append(subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT))
    codes = [process.wait() for process in running]
  finally:
    for process in loops:
      process.kill()
      process.wait()
  last = [(log.read_text().rstrip().splitlines() or ["no output"])[-1] for log in logs]
  return "; ".join(line if code == 0 else f"exit {code}: {line}" for code, line in zip(codes, last, strict=True))


def split(arguments: list[str], shards: int) -> list[list[str]]:
  """Spread test files over processes, the largest first."""
  if shards == 1:
    return [arguments]
  folders = [Path(argument) for argument in arguments if Path(argument).exists()]
  options = [argument for argument in arguments if not Path(argument).exists()]
  files = {file for folder in folders for file in ([folder] if folder.is_file() else folder.rglob("test_*.py"))}
  result: list[list[str]] = [[*options] for _ in range(shards)]
  for place, file in enumerate(sorted(files, key=lambda file: -file.stat().st_size)):
    result[place % shards].append(str(file))
  return result


def main() -> int:
  parser = argparse.ArgumentParser(description=__doc__)
  parser.add_argument("--times", type=int, default=10, help="number of runs")
  parser.add_argument("--busy", type=int, default=4, help="busy loops beside each run")
  parser.add_argument("--cores", type=int, default=2, help="cores of each run, shared with its busy loops")
  parser.add_argument("--shards", type=int, default=1, help="processes that a run is split into")
  parser.add_argument("--parallel", type=int, default=1, help="runs at once")
  parser.add_argument("--output", type=Path, default=Path("logs/repeat_tests"), help="folder of the logs")
  parser.add_argument("arguments", nargs="*", help="arguments of pytest, after --")
  args = parser.parse_args()
  args.output.mkdir(parents=True, exist_ok=True)
  available = sorted(os.sched_getaffinity(0))
  if args.parallel * args.cores > len(available):
    parser.error(f"{args.parallel} runs of {args.cores} cores need more than the {len(available)} cores here")

  places: queue.SimpleQueue[int] = queue.SimpleQueue()
  for place in range(args.parallel):
    places.put(place * args.cores)

  shards = split(args.arguments, args.shards)

  def one(index: int) -> bool:
    first = places.get()
    start = time.monotonic()
    result = run(index, available[first : first + args.cores], args.busy, shards, args.output)
    places.put(first)
    print(f"| {index + 1} | {time.monotonic() - start:.0f} s | {result} |", flush=True)
    return "exit" not in result

  print(f"{args.times} runs, each on {args.cores} cores beside {args.busy} busy loops\n")
  print("| run | time | pytest |\n|---|---|---|")
  with ThreadPoolExecutor(args.parallel) as pool:
    passed = list(pool.map(one, range(args.times)))
  return int(not all(passed))


if __name__ == "__main__":
  sys.exit(main())
