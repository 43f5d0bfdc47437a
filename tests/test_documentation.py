"""The documentation site: pages, links and forms for language models."""

import re
from pathlib import Path
from types import SimpleNamespace

import griffe
import overview
import pytest
import torch
from mjlab.registry import list_tasks
from mjlab_docs import check, llms, pages, results, sources
from mjlab_rl import RslRlOnPolicyRunnerCfg
from mjlab_rl.offpolicy import fastsac, flashsac

DOCS = pages.ROOT / "docs"
BLOCK = re.compile(r"```python\n(.*?)```", re.DOTALL)
# Other tests run the code of these pages.
RUN_ELSEWHERE = {DOCS / name for name in ("architecture.md", "extending.md", "own_robot.md")}
RUN_ELSEWHERE |= set(DOCS.glob("tutorials/*.md"))


@pytest.mark.parametrize(
  "page",
  [
    str(path.relative_to(DOCS))
    for path in sorted(DOCS.rglob("*.md"))
    if path not in RUN_ELSEWHERE and BLOCK.search(path.read_text(encoding="utf-8"))
  ],
)
def test_code_of_a_page_runs(page: str) -> None:
  env = SimpleNamespace(num_envs=2, device="cpu", rng=torch.Generator())
  for code in BLOCK.findall((DOCS / page).read_text(encoding="utf-8")):
    exec(compile(code, page, "exec"), {"env": env})


def test_links_between_files_lead_between_pages(tmp_path: Path) -> None:
  site = pages.Site(tmp_path)
  text = "[a](../packages/rl#run-directories)\n```\n[c](../packages/rl)\n```\n![d](pictures/g1.png)"
  assert site.linked(text, "docs/architecture.md", "architecture.md") == (
    "[a](reference/packages/rl.md#run-directories)\n```\n[c](../packages/rl)\n```\n![d](pictures/g1.png)"
  )


def test_a_file_without_a_page_becomes_one(tmp_path: Path) -> None:
  site = pages.Site(tmp_path)
  assert site.linked("[script](../.ci/run)", "docs/faq.md", "faq.md") == "[script](source/.ci/run.md)"
  site.lay_out()
  assert "uv sync" in (tmp_path / "source/.ci/run.md").read_text(encoding="utf-8")


def test_numbers_are_files_to_download(tmp_path: Path) -> None:
  site = pages.Site(tmp_path)
  curve = "docs/benchmarks/go1_flat_gpu.csv"
  assert site.linked("[c](go1_flat_gpu.csv)", "docs/benchmarks/a.md", "benchmarks/a.md") == f"[c](../source/{curve})"
  site.lay_out()
  assert (tmp_path / "source" / curve).read_bytes() == (pages.ROOT / curve).read_bytes()


def test_a_name_that_a_package_exports_leads_to_the_lines_that_define_it() -> None:
  code = "class A:\n  b = 1\n\n  def c(self):\n    pass\n"
  with griffe.temporary_visited_module(code, module_name="inner") as module:
    sources.remember({"package.A": module})
    assert sources.defining_module(None, "package", "A.c") == "inner"
    found, tags = sources.code_and_tags(None, "inner")
  assert found.splitlines() == code.splitlines()
  assert tags == {"A": ("class", 1, 5), "A.c": ("def", 4, 5)}


def test_wrong_links_and_files_of_other_hosts_are_found(tmp_path: Path) -> None:
  (tmp_path / "a.html").write_text(
    '<h1 id="top">A</h1><a href="b.html#below">b</a><a href="https://x.org">x</a>', "utf-8"
  )
  (tmp_path / "b.html").write_text(
    '<a href="a.html#top">a</a><a href="c.html">c</a><script src="https://x.org/s.js"></script>', "utf-8"
  )
  assert check.problems(tmp_path) == [
    "a.html: b.html#below has no such anchor",
    "b.html: loads https://x.org/s.js",
    "b.html: c.html does not exist",
  ]


@pytest.mark.parametrize("task", list(results.RESULTS))
def test_tasks_have_the_curve_and_the_scores_that_their_page_shows(task: str) -> None:
  curve, page, row = results.RESULTS[task]
  assert task in list_tasks()
  assert (results.BENCHMARKS / curve).is_file()
  if page is not None:
    head, _, *rows = results.scores(page, row)
    assert rows
    assert all(line.count("|") == head.count("|") for line in rows)


def test_every_film_is_shown_and_under_a_megabyte() -> None:
  films = {str(path.relative_to(DOCS)): path.stat().st_size for path in DOCS.glob("pictures/films/*")}
  assert max(films.values()) < 1_000_000
  pages = "".join(page.read_text(encoding="utf-8") for page in DOCS.glob("*.md"))
  named = set(re.findall(r"\]\((pictures/films/[\w-]+\.webp)\)", pages))
  assert set(films) == named | {film for _, film in results.films().values()}


def test_the_table_of_learners_has_the_numbers_of_the_presets() -> None:
  lines = (DOCS / "learners.md").read_text(encoding="utf-8").splitlines()
  rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("| `")]
  compared = []
  for cells in rows:
    for preset, text in zip((fastsac, flashsac), cells[2:], strict=False):
      settings = preset(RslRlOnPolicyRunnerCfg()).algorithm
      if re.fullmatch(r"[\d., ]+", text) and "target_entropy" not in cells[0]:
        names = re.findall(r"`(\w+)`", cells[0])
        assert [float(number) for number in text.split(", ")] == [getattr(settings, name) for name in names]
        compared += names
  assert len(compared) == 18


def test_a_page_for_language_models_is_markdown() -> None:
  page = (
    '# T\n\n::::{py:class} A(x)\n:module: m\n\nText {py:obj}`B <m.B>`.\n\n:::{py:attribute} b\n:type: "int"\n\nBit.\n'
  )
  page += ":::\n::::\n\n```{toctree}\nother\n```\n\n```python\nx: int\n```\n"
  assert llms.plain(page) == (
    "# T\n\n### class `A(x)`\n\nText `B`.\n\n#### attribute `b`\n- type: `int`\n\nBit.\n\n```python\nx: int\n```\n"
  )


def test_the_table_that_opens_the_benchmarks_has_the_figures_of_their_files() -> None:
  text = overview.PAGE.read_text(encoding="utf-8")
  assert text == overview.section(text, overview.table(overview.figures())), "run tools/overview.py"
  assert "**421 k**" in overview.Figure("", overview.OURS, 420944, "H200", True, "a.md").cell(overview.RATE)
