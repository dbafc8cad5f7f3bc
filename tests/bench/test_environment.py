"""Environment of processes that compute: what is set already keeps its say."""

import pytest

from bench.execution.environment import OPTIONS, xla_flags


@pytest.mark.parametrize("name", sorted(OPTIONS))
def test_an_option_that_is_set_is_not_set_again(monkeypatch, name):
    monkeypatch.setenv("XLA_FLAGS", f"--{name}=mine")
    flags = xla_flags().split()
    assert [flag for flag in flags if name in flag] == [f"--{name}=mine"]
    assert set(flags) - {f"--{name}=mine"} == {v for k, v in OPTIONS.items() if k != name}


def test_without_any_all_options_are_set(monkeypatch):
    monkeypatch.delenv("XLA_FLAGS", raising=False)
    assert xla_flags().split() == list(OPTIONS.values())
