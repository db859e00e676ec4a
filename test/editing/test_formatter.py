"""Formatter: layout of clauses, comments, and texts that are left alone."""

from textwrap import dedent

import pytest

from retalis import ProgramErrors
from retalis.editing.formatter import format_goals, format_rules


def formatted(text: str, line_length: int = 60) -> str:
    return format_rules(dedent(text).lstrip("\n"), "rules", line_length)


def assert_layout(text: str, expected: str, line_length: int = 60) -> None:
    expected = dedent(expected).lstrip("\n")
    assert formatted(text, line_length) == expected
    assert formatted(expected, line_length) == expected


def test_spaces_are_normalized() -> None:
    assert_layout("a(X,Y)<-b( X ) seq c(Y)where X>Y .\n", "a(X, Y) <- b(X) seq c(Y) where X > Y.\n")


@pytest.mark.parametrize(
    "clause",
    [
        "p(X) :- X is A+B*2, Y is A + B.",
        "p(K-V, a/2, m:g) :- \\+ q(- 1, -1, - (1), -(1), 2 - -1).",
        "p([H|T], [A, B | C], {x, y}) :- -X =.. [F|As].",
        "p :- X = (:-), Y = [-], Z = + .",
        "h <- sensor_msgs__0__Imu{linear: {x: X}, list: [{k: 1}, {k: 'a b'}]}.",
        "h(pkg__0__T{ON}) <- pkg__0__T{x: {OFF}, list: [{A}, {b}]} where X > pkg__0__T{ON}.",
        "label : head(A) <- tick(A).",
        "label([property(ttl, 3)]) : null do g(A) <- tick(A).",
        ":- dynamic f/1, g/2.",
        "tell do (a, b) <- c.",
        "p --> [a], {g(X)}, q.",
        "p(0'a, 0xff, 1_000, 1.0e10, \"text\", `codes`, 'it''s').",
        "p(-, *) :- (a, b ; c -> d).",
        "h <- (a and b) cnot c within 5.",
        ":- event near(robot:atom, distance:float).",
    ],
)
def test_clause_is_laid_out_already(clause: str) -> None:
    assert formatted(clause + "\n", 120) == clause + "\n"


def test_line_breaks_of_author_stay() -> None:
    assert_layout(
        """
        far(R) <-
             at(R, X, Y)
               where X > 3.
        p(X) :- q(X),
          r(X).
        """,
        """
        far(R)
          <- at(R, X, Y)
             where X > 3.
        p(X) :- q(X),
            r(X).
        """,
    )


def test_commas_and_operators_move_to_line_end_and_start() -> None:
    assert_layout(
        """
        p(X) :-
            q(X)
          , X = [1
                ,2] or
            r.
        """,
        """
        p(X) :-
            q(X),
            X = [1,
                 2]
            or r.
        """,
    )


def test_alternatives_over_several_lines_are_in_columns() -> None:
    assert_layout(
        """
        p(X) :-
            ( X > 1 -> a, b
            ; c(
                 d) ),
            e.
        """,
        """
        p(X) :-
            (   X > 1
            ->  a, b
            ;   c(
                    d)
            ),
            e.
        """,
    )


def test_long_rule_is_broken_at_arrow_and_operators() -> None:
    assert_layout(
        "near(A, B) <- (at(A, X1) and at(B, X2)) within 0.5 where (A @< B, abs(X1 - X2) < 1.0).\n",
        """
        near(A, B)
          <- (at(A, X1) and at(B, X2)) within 0.5
             where (A @< B, abs(X1 - X2) < 1.0).
        """,
        50,
    )


def test_long_body_has_one_goal_on_each_line() -> None:
    assert_layout(
        "pose(T, P) :- prev(a, V1, T1, _, T), next(a, V2, T2, _, T), mean(V1, V2, P).\n",
        """
        pose(T, P) :-
            prev(a, V1, T1, _, T),
            next(a, V2, T2, _, T),
            mean(V1, V2, P).
        """,
    )


def test_long_arguments_fill_lines() -> None:
    assert_layout(
        "p(aaaaaaaaaa, bbbbbbbbbb, cccccccccc, dddddddddd, eeeeeeeeee).\n",
        """
        p(aaaaaaaaaa, bbbbbbbbbb,
          cccccccccc, dddddddddd,
          eeeeeeeeee).
        """,
        25,
    )


def test_arguments_far_to_the_right_are_indented_from_start() -> None:
    assert_layout(
        "long_predicate_name(long_functor_name(aaaaaaaaaa, bbbbbbbbbb)).\n",
        """
        long_predicate_name(
            long_functor_name(
                aaaaaaaaaa, bbbbbbbbbb)).
        """,
        34,
    )


def test_line_with_suppressed_finding_is_not_broken() -> None:
    line = "near(A, B) <- at(A, X) and at(B, X) within 0.5 where A @< B.  % retalis: ignore=RT1203\n"
    assert formatted(line, 40) == line


def test_comments_stay_at_their_clauses() -> None:
    assert_layout(
        """


        %  Title

          % about a
        a(1).% one
        /* block
             of lines */
        b :- % why
            c % first
            , /* inner */ d. /* last */ e(
            % alone
            1
            % end
            ).



        % end of file
        """,
        """
        %  Title

        % about a
        a(1).  % one
        /* block
             of lines */
        b :-  % why
            c,  % first
            /* inner */ d.  /* last */
        e(
            % alone
            1
            % end
        ).

        % end of file
        """,
    )


def test_aligned_facts_and_comments_stay_aligned() -> None:
    assert_layout(
        """
        gate(gps,     16.27,  3).   % first
        gate(compass, 1,      20).  % second
        """,
        """
        gate(gps,     16.27, 3).   % first
        gate(compass, 1,     20).  % second
        """,
    )


def test_facts_that_are_not_aligned_are_not_aligned() -> None:
    assert_layout("f(a,    1).\nf(bb,  1).\n", "f(a, 1).\nf(bb, 1).\n")


def test_operators_of_directives_apply() -> None:
    assert_layout(
        ":- op(700,xfx,near).\np:-a near b.\n:- use_module(library(clpfd)).\nq:-X#=Y.\n",
        ":- op(700, xfx, near).\np :- a near b.\n:- use_module(library(clpfd)).\nq :- X #= Y.\n",
    )


def test_rest_after_end_of_file_is_verbatim() -> None:
    assert formatted("a:-b.\nend_of_file.\n  anything ( at all\n") == (
        "a :- b.\nend_of_file.\n  anything ( at all\n"
    )


def test_interpreter_line_and_byte_order_mark_stay() -> None:
    assert formatted("#!/usr/bin/env swipl\na:-b.\n") == "#!/usr/bin/env swipl\na :- b.\n"
    assert formatted("\ufeffa:-b.\n") == "\ufeffa :- b.\n"


def test_line_ends_stay() -> None:
    text = "a :- b.  % c\r\n\r\n/* d\r\ne */\r\nf('x\\\r\ny').\r\n"
    assert formatted(text.replace(" :- ", ":-")) == text


@pytest.mark.parametrize("text", ["", "\n\n", "% only a comment\n"])
def test_file_without_clauses(text: str) -> None:
    assert formatted(text) == text.strip("\n") + ("\n" if text.strip() else "")


def test_all_syntax_errors_are_reported_with_places() -> None:
    with pytest.raises(ProgramErrors) as caught:
        formatted("a :- (b.\nc(1).\nd(.\n")
    assert [(error.place.line, error.place.column) for error in caught.value.errors if error.place] == [
        (1, 8),
        (3, 3),
    ]


def test_goals_stay_on_their_lines() -> None:
    text = (
        "\n% goals\ncompile_event_file( 'a' )\n\n\n  memorize(a(X),[],\n X, m, 10 ).\n"
        "subscribe(a(X),[],_,t,s)% sent\n"
    )
    expected = (
        "% goals\ncompile_event_file('a')\n\nmemorize(a(X), [],\n         X, m, 10).\n"
        "subscribe(a(X), [], _, t, s)  % sent\n"
    )
    assert format_goals(text, "goals", 40) == expected
    assert format_goals(expected, "goals", 40) == expected


def test_goal_without_full_stop_is_not_broken() -> None:
    goal = "subscribe(aaaaaaaaaaaaaaaaaaaaaaaa, bbbbbbbbbbbbbbbbbbbbbbb)\n"
    assert format_goals(goal, "goals", 30) == goal


def test_goal_whose_first_line_would_be_goal_is_verbatim() -> None:
    text = "p(1) ->\n   q(2).\n"
    assert format_goals(text, "goals") == text


def test_error_in_goal_has_place() -> None:
    with pytest.raises(ProgramErrors) as caught:
        format_goals("a(1)\nb(\n", "goals")
    assert [error.place.line for error in caught.value.errors if error.place] == [2]


def test_spaces_after_end_of_file_remain() -> None:
    text = "a.\nend_of_file.\nfoo  \n  bar\n"
    assert format_rules(text, "rules") == text


def test_goals_with_declared_operators_are_formatted() -> None:
    text = "op(700, xfx, ===>)\nassertz(f(a===>b,c)).\n"
    assert format_goals(text, "goals") == "op(700, xfx, ===>)\nassertz(f(a ===> b, c)).\n"
