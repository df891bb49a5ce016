"""Starting processes while the server that they are forked from ends."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from benchmark.runner import backends


@pytest.fixture
def starting(monkeypatch):
    """A backend whose starts fail ``failures`` times, the tries, and how long was waited between them."""
    state = SimpleNamespace(failures=0, error=ConnectionRefusedError(111, "Connection refused"), tries=0, pauses=[])

    def once(self, job):
        state.tries += 1
        if state.tries <= state.failures:
            raise state.error
        return job

    monkeypatch.setattr(backends.Processes, "_start_once", once)
    monkeypatch.setattr(backends.time, "sleep", state.pauses.append)
    return state


@pytest.mark.parametrize("error", [ConnectionRefusedError(), BrokenPipeError(), EOFError()])
def test_a_start_waits_for_the_next_server(starting, error):
    starting.failures, starting.error = 5, error
    assert backends.Processes()._start("job") == "job"
    assert starting.tries == 6 and 1.0 <= sum(starting.pauses) <= 5.0
    assert starting.pauses == sorted(starting.pauses)


def test_a_start_that_succeeds_waits_for_nothing(starting):
    assert backends.Processes()._start("job") == "job"
    assert starting.pauses == []


def test_a_server_that_never_comes_is_an_error(starting):
    starting.failures = 99
    with pytest.raises(ConnectionRefusedError):
        backends.Processes()._start("job")
    assert starting.tries == 7
