"""One family of errors: what it carries, and that callers can catch it as the built-in errors they know."""

import pickle

import pytest
from mjlab_core import ConfigError, MjlabError, UnknownNameError, errors


def test_every_error_is_an_mjlab_error_and_a_value_error() -> None:
  family = [cls for cls in vars(errors).values() if isinstance(cls, type)]
  assert len(family) == 7
  assert all(issubclass(cls, MjlabError) and issubclass(cls, ValueError) for cls in family)


def test_config_error_lists_all_problems_and_survives_pickling() -> None:
  error = pickle.loads(pickle.dumps(ConfigError("rewards: term 'a': x", "scene: y")))
  assert error.problems == ("rewards: term 'a': x", "scene: y")
  assert str(error) == "2 problems:\nrewards: term 'a': x\nscene: y"
  assert str(ConfigError("one")) == "one"


def test_an_unknown_name_is_a_key_error_whose_message_is_not_quoted() -> None:
  with pytest.raises(KeyError) as caught:
    raise UnknownNameError("'robt' does not exist")
  assert str(caught.value) == "'robt' does not exist"
