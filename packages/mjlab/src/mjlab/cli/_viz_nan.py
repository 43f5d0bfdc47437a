"""`viz-nan FILE`: what a NaN dump says, and whether MuJoCo C diverges from there too."""

from mjlab.cli._errors import UsageError

_HELP = """\
usage: viz-nan FILE

Says of each world in a NaN dump what was first not finite, and runs its last steps anew in MuJoCo C from the states of
the dump, to tell whether it diverges there too.
"""


def run(arguments: list[str]) -> int:
  """Print a report on every world of the file."""
  if "-h" in arguments or "--help" in arguments:
    print(_HELP, end="")
    return 0
  if options := [argument for argument in arguments if argument.startswith("-")]:
    raise UsageError(f"{options[0]}: no such option. usage: viz-nan FILE")
  if len(arguments) != 1:
    raise UsageError("viz-nan takes one FILE")
  from mjlab_sim import NanDump

  dump = NanDump.load(arguments[0])
  print(f"{arguments[0]}: {dump.engine} engine, {dump.decimation} physics steps per environment step")
  for world in dump.worlds:
    replay = world.replay()
    print(f"\nworld {world.index}, environment step {world.env_step}, {world.num_steps} physics steps stored")
    print(f"  {world.describe_first()}")
    if replay.diverged_at is None:
      print(f"  MuJoCo C stays finite over these steps; its positions differ by {replay.error:.2g} at most")
    else:
      print(f"  MuJoCo C diverges too, in physics step {replay.diverged_at + 1} of {world.num_steps}")
    if world.model_fields:
      print(f"  the world had its own {', '.join(sorted(world.model_fields))}")
  return 0
