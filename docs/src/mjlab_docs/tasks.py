"""Pages of all registered tasks: observations, actions, rewards with weights, and every other term."""

import dataclasses
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from mjlab.registry import load_task, task_entries

from mjlab_docs import results
from mjlab_docs.pages import Site


def write(site: Site, homes: Mapping[str, str]) -> None:
  """Write `reference/tasks/TASK.md` for each task, and an index.

  Args:
    site: The site.
    homes: Module that documents each object, by the path of the object's definition.
  """
  rows = []
  for entry in task_entries():
    summary = re.sub(r"^Return (?:the )?(?:task of )?", "", _first(entry.load()))
    summary = f"{summary[:1].upper()}{summary[1:]}."
    rows.append((f"[{entry.name}]({entry.name}.md)", summary, f"[{entry.package}]({_family(entry.package)})"))
    site.write(f"reference/tasks/{entry.name}.md", "\n".join(_page(entry.name, entry.package, summary, homes)) + "\n")
  shown = [f"[![{task}](../../{film})]({task}.md)" for task, (_, film) in results.films().items()]
  index = ["# Tasks\n", *shown, "\nThese pages are generated from the registry.\n"]
  index += _table(("task", "subject", "package"), rows)
  site.write("reference/tasks/index.md", "\n".join([*index, "\n```{toctree}\n:hidden:\n:glob:\n\nMjlab*\n```\n"]))


def _family(package: str) -> str:
  return f"../packages/{package.removeprefix('mjlab-')}.md"


def _page(name: str, package: str, summary: str, homes: Mapping[str, str]) -> Iterator[str]:
  task = load_task(name)
  env = task.env
  yield f"# {name}\n\n{summary}\n"
  yield from results.write(name)
  yield f"```bash\nuv run train {name}\n```\n"
  yield f"[{package}]({_family(package)}) describes the tasks of this family, with curves and results.\n"
  yield from _table(
    ("figure", "value"),
    [
      ("environment step", f"{env.decimation} x {env.sim.timestep:g} s = {env.decimation * env.sim.timestep:g} s"),
      ("episode", f"{env.episode_length_s:g} s"),
      ("entities", ", ".join(f"`{entity}`" for entity in env.scene.entities)),
      ("sensors", ", ".join(f"`{sensor}`" for sensor in env.scene.sensors) or "none"),
      ("terrain", _code(env.scene.terrain) if env.scene.terrain is not None else "none"),
    ],
  )
  yield "\n## Observations\n"
  for group, cfg in env.observations.items():
    if cfg is not None:
      yield f"### Group {group}\n"
      yield from _terms(cfg.terms, homes, "noise")
      yield ""
  yield "## Actions\n"
  yield from _configs(env.actions, homes)
  if any(cfg is not None for cfg in env.commands.values()):
    yield "\n## Commands\n"
    yield from _configs(env.commands, homes)
  for title, terms, columns in (
    ("Rewards", env.rewards, ("weight",)),
    ("Terminations", env.terminations, ("time_out",)),
    ("Events", env.events, ("mode",)),
    ("Curriculum", env.curriculum, ()),
    ("Metrics", env.metrics, ()),
  ):
    if any(term is not None for term in terms.values()):
      yield f"\n## {title}\n"
      yield from _terms(terms, homes, *columns)
  yield "\n## Learner\n"
  rows = [(f"`{field.name}`", _code(getattr(task.agent, field.name))) for field in dataclasses.fields(task.agent)]
  yield from _table(("field", "value"), rows)


def _terms(terms: Mapping[str, Any], homes: Mapping[str, str], *columns: str) -> list[str]:
  """Return the table of terms: name, columns, function with its meaning, and parameters."""
  rows = [
    (
      f"`{name}`",
      *(_code(getattr(term, column)) for column in columns),
      f"{_reference(term.func, homes)}: {_cell(_first(term.func))}",
      ", ".join(f"{key} = {_short(value)}".join("``") for key, value in term.params.items()).replace("|", "\\|"),
    )
    for name, term in terms.items()
    if term is not None
  ]
  return _table(("term", *(column.replace("_", " ") for column in columns), "function", "parameters"), rows)


def _configs(terms: Mapping[str, Any], homes: Mapping[str, str]) -> list[str]:
  """Return the table of terms whose configs have a class each."""
  rows = [
    (f"`{name}`", f"{_reference(type(term), homes)}: {_cell(_first(type(term)))}", _code(term))
    for name, term in terms.items()
    if term is not None
  ]
  return _table(("term", "config", "values that differ from the defaults"), rows)


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
  lines = [heads, ["---"] * len(heads), *rows]
  return [f"| {' | '.join(line)} |" for line in lines]


def _reference(func: Any, homes: Mapping[str, str]) -> str:
  func = getattr(func, "func", func)  # of a partial
  home = homes.get(f"{func.__module__}.{func.__qualname__}")
  name = func.__name__
  return f"{{py:obj}}`{name} <{home}.{name}>`" if home else f"`{name}`"


def _first(documented: Any) -> str:
  """Return the first sentence of a docstring."""
  text = " ".join((getattr(documented, "func", documented).__doc__ or "").split("\n\n")[0].split())
  return text.split(". ")[0].rstrip(".")


def _cell(text: str) -> str:
  return text.replace("|", "\\|")


def _code(value: Any) -> str:
  text = _short(value)
  return _cell(f"`{text}`") if text else ""


def _short(value: Any) -> str:
  """Return a value in few words: numbers rounded, configs with what differs from their defaults."""
  if isinstance(value, float):
    return f"{value:.4g}"
  if isinstance(value, Mapping):
    return "{" + ", ".join(f"{key}: {_short(item)}" for key, item in value.items()) + "}"
  if isinstance(value, list | tuple):
    return "(" + ", ".join(map(_short, value)) + ")"
  if dataclasses.is_dataclass(value) and not isinstance(value, type):
    fields = [
      f"{field.name}={_short(item)}"
      for field in dataclasses.fields(value)
      if not _is_default(field, item := getattr(value, field.name))
    ]
    return f"{type(value).__name__}({', '.join(fields)})"
  if callable(value):
    return getattr(value, "__name__", type(value).__name__)
  return str(value)


def _is_default(field: dataclasses.Field[Any], value: Any) -> bool:
  if field.default is not dataclasses.MISSING:
    return value == field.default
  return field.default_factory is not dataclasses.MISSING and value == field.default_factory()
