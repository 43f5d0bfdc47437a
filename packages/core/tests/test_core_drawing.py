"""What a viewer offers is described well enough to be offered by anybody."""

import inspect

import pytest
from mjlab_core import DebugDraw

METHODS = {name: member for name, member in vars(DebugDraw).items() if not name.startswith("_") and callable(member)}
ROWS = {"color": "(n, 4)", "quaternion": "(n, 4)", "radius": "(n,)"}


@pytest.mark.parametrize("name", METHODS)
def test_every_method_says_the_shape_of_all_it_takes(name: str) -> None:
  text = f"{inspect.getdoc(METHODS[name])}\n{inspect.getdoc(DebugDraw)}"
  arguments = [argument for argument in inspect.signature(METHODS[name]).parameters if argument != "self"]
  assert arguments
  for argument in arguments:
    assert argument in text
    if argument not in ("mesh_name", "size"):
      assert ROWS.get(argument, "(n, 3)") in text
