"""Directives of other Prologs as goals, and expansion of terms."""

from typing import Any, List

import pytest

from retalis import Engine


@pytest.mark.parametrize(
    "goal",
    [
        "style_check(-singleton)",
        "initialization(true)",
        "\\+ initialization(fail)",
        "initialization(fail, main)",
        "catch(initialization(true, soon), error(domain_error(initialization_type, soon), _), true)",
        "catch(style_check(_), error(instantiation_error, _), true)",
        "dcg_translate_rule((a --> [b]), (a(S0, S) :- S0 = [b|S]))",
        "expand_term((a --> b), (a(X, Y) :- b(X, Y)))",
        "expand_term(p(1), p(1))",
        "assertz(term_expansion(p(X), q(X))), expand_term(p(1), q(1)), expand_term(r, r)",
        "set_prolog_flag(no_flag_of_ours, f(x)), current_prolog_flag(no_flag_of_ours, f(x))",
        "assertz(q(1)), abolish(q/1), catch(q(_), error(existence_error(procedure, q/1), _), true)",
        'catch(number_codes(_, "3/**/"), error(syntax_error(_), _), true)',
        'catch(number_codes(_, "3%x"), error(syntax_error(_), _), true)',
        'number_codes(X, "0\'%"), X =:= 37',
    ],
)
def test_directive_or_expansion_succeeds(goal: str) -> None:
    assert Engine().call(goal)


def test_unknown_flag_decides_undefined_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    engine = Engine()
    messages: List[Any] = []
    monkeypatch.setattr(engine.logic, "message", lambda kind, text: messages.append((kind, text)))
    engine.load(rules="p :- nope(1). q(L) :- findall(X, nope(X), L).")
    assert engine.call("unknown(error, warning), \\+ p, \\+ p, q([])")
    assert messages == [("warning", "Unknown procedure: nope/1")]
    assert engine.call("set_prolog_flag(unknown, fail), \\+ p, \\+ other(1)")
    assert len(messages) == 1
    assert engine.call(
        "unknown(X, error), X == fail, catch(p, error(existence_error(procedure, nope/1), _), true)"
    )
