"""Bounded time of the search for similar names."""

from retalis import functor
from retalis.events.checks import program_model
from retalis.events.checks.program_model import FunctorSuggestions


def test_of_the_same_name_is_taken_before_others_that_are_like_it():
    keys = [functor("hot", 1), functor("hot", 4), functor("hit", 2)]
    assert FunctorSuggestions().suggest(functor("hot", 3), keys) == "hot/4"
    assert FunctorSuggestions().suggest(functor("hut", 1), keys) in ("hot/1", "hit/2")
    assert FunctorSuggestions().suggest(functor("cold", 1), keys) == ""


def test_many_unknown_names_among_many_known_ones_are_not_all_compared(monkeypatch):
    compared = []
    monkeypatch.setattr(
        program_model, "closest_name", lambda name, names, alike=0.66: compared.append(len(names)) or ""
    )
    nearby, keys = FunctorSuggestions(), [functor(f"known_{at}", 1) for at in range(400)]
    for at in range(400):
        nearby.suggest(functor(f"unknown_{at}", 1), keys)
    assert 0 < sum(compared) <= program_model.MAX_COMPARISONS
    assert nearby.suggest(functor("known_7", 2), keys) == "known_7/1"
