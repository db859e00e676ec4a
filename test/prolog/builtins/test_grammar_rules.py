"""Grammar rules and ``phrase``."""

from prolog.goal_answers import answers, first, prolog

GRAMMAR = r"""
greeting --> [hello], name_of(_), !, {true}.
name_of(world) --> [world].
anbn --> [].
anbn --> [a], anbn, [b].
digits([D|T]) --> digit(D), digits(T).
digits([D]) --> digit(D).
digit(D) --> [D], { code_type(D, digit) }.
"""


def test_phrase_parses_lists() -> None:
    logic = prolog(GRAMMAR)
    assert answers(logic, "phrase(greeting, [hello,world])") == [{}]
    assert answers(logic, "phrase(greeting, [hello,moon])") == []
    assert answers(logic, "phrase(anbn, [a,a,b,b])") == [{}]
    assert first(logic, "phrase(digits(_), `12a`, R)") == "[97]"
    assert answers(logic, "phrase(anbn, x)") == ["type_error(list,x)"]
    assert answers(logic, "phrase(_, [])") == ["instantiation_error"]
    assert answers(logic, 'phrase(("ab", \\+ [0\'d], [X]), `abc`)') == [{"X": "99"}]
