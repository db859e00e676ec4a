% Tests in units: what stands between begin_tests and end_tests, and is run by run_tests. Reports go to user_error.
%
% defines: run_tests/0 run_tests/1 run_tests/2 set_test_options/1

run_tests :-
    findall(Unit, current_test_unit(Unit, _), Units),
    run_units_(Units).

run_tests(Specs) :-
    (   is_list(Specs)
    ->  run_units_(Specs)
    ;   run_units_([Specs])
    ).

run_tests(Specs, _) :-
    run_tests(Specs).

set_test_options(_).

run_units_(Specs) :-
    foldl(run_unit_, Specs, counts(0, 0, 0, 0), Counts),
    report_counts_(Counts),
    Counts = counts(_, 0, _, _).

% counts(Passed, Failed, Blocked, Fixme)

run_unit_(Spec, Counts0, Counts) :-
    must_be(nonvar, Spec),
    unit_and_name_(Spec, Unit, Name),
    (   '$unit'(Unit, Options, Tests)
    ->  true
    ;   '$no_unit'(Unit)
    ),
    Counts0 = counts(_, Failed0, _, _),
    unit_says_("% PL-Unit: ~q ", [Spec]),
    (   member(blocked(Reason), Options)
    ->  unit_says_("blocked: ~w", [Reason]),
        Counts = Counts0
    ;   member(condition(Condition), Options),
        \+ catch(Condition, _, fail)
    ->  unit_says_("not run: its condition does not hold", []),
        Counts = Counts0
    ;   option_goal_(setup, Options, "unit"),
        include(named_test_(Name), Tests, Chosen),
        foldl(run_test_, Chosen, Counts0, Counts),
        option_goal_(cleanup, Options, "unit")
    ->  Counts = counts(_, Failed, _, _),
        (   Failed =:= Failed0
        ->  unit_says_(" passed", [])
        ;   unit_says_(" **FAILED", [])
        )
    ;   Counts0 = counts(P, F, B, X),
        F1 is F + 1,
        Counts = counts(P, F1, B, X)
    ),
    unit_says_("~n", []).

unit_and_name_(Spec, Unit, Name) :-
    (   Spec = Unit0:Name0
    ->  Unit = Unit0,
        Name = Name0
    ;   Unit = Spec,
        Name = _
    ).

named_test_(Name, test(_, Head, _)) :-
    arg(1, Head, Own),
    (   is_list(Name)
    ->  member(One, Name),
        subsumes_term(One, Own)
    ;   subsumes_term(Name, Own)
    ), !.

unit_says_(Format, Arguments) :-
    format(user_error, Format, Arguments).

option_goal_(Kind, Options, What) :-
    Option =.. [Kind, Goal],
    (   member(Option, Options)
    ->  (   catch(Goal, Error, true)
        ->  (   var(Error)
            ->  true
            ;   unit_says_("~n\t~s: ~w raised ~p", [What, Kind, Error]),
                fail
            )
        ;   unit_says_("~n\t~s: ~w failed", [What, Kind]),
            fail
        )
    ;   true
    ).

% A test, once for each solution of what forall/1 of its options asks.

run_test_(test(Place, Head, Body), Counts0, Counts) :-
    test_options_(Head, Name, Options),
    (   member(blocked(_), Options)
    ->  add_count_(blocked, Counts0, Counts)
    ;   member(condition(Condition), Options),
        \+ catch(Condition, _, fail)
    ->  Counts = Counts0
    ;   member(forall(Generator), Options)
    ->  term_variables(Generator, Variables),
        findall(Variables-(Options-Body), Generator, Instances),
        foldl(run_instance_(Place, Name), Instances, Counts0, Counts)
    ;   run_once_(Place, Name, none, Options, Body, Counts0, Counts)
    ).

run_instance_(Place, Name, Values-(Options-Body), Counts0, Counts) :-
    run_once_(Place, Name, Values, Options, Body, Counts0, Counts).

test_options_(Head, Name, Options) :-
    (   Head = test(Name)
    ->  Options = []
    ;   Head = test(Name, Given),
        (   is_list(Given)
        ->  Options = Given
        ;   Options = [Given]
        )
    ).

run_once_(Place, Name, Values, Options, Body, Counts0, Counts) :-
    (   \+ option_goal_(setup, Options, "test")
    ->  Outcome = failed("setup", [])
    ;   test_outcome_(Options, Body, Outcome),
        ignore(option_goal_(cleanup, Options, "test"))
    ),
    (   member(fixme(_), Options)
    ->  add_count_(fixme, Counts0, Counts)
    ;   report_(Outcome, Place, Name, Values),
        outcome_count_(Outcome, Count),
        add_count_(Count, Counts0, Counts)
    ).

outcome_count_(passed, passed).
outcome_count_(choices, passed).
outcome_count_(failed(_, _), failed).

add_count_(passed, counts(P0, F, B, X), counts(P, F, B, X)) :-
    P is P0 + 1.
add_count_(failed, counts(P, F0, B, X), counts(P, F, B, X)) :-
    F is F0 + 1.
add_count_(blocked, counts(P, F, B0, X), counts(P, F, B, X)) :-
    B is B0 + 1.
add_count_(fixme, counts(P, F, B, X0), counts(P, F, B, X)) :-
    X is X0 + 1.

% What the options expect: one solution, all of them, none, or an error.

test_outcome_(Options, Body, Outcome) :-
    (   test_expects_(Options, Expected)
    ->  true
    ;   Expected = true(true)
    ),
    test_runs_(Expected, Options, Body, Outcome).

test_expects_(Options, Expected) :-
    member(Option, Options),
    nonvar(Option),
    test_expected_(Option, Expected), !.

test_expected_(true, true(true)).
test_expected_(true(Goal), true(Goal)).
test_expected_(fail, fail).
test_expected_(false, fail).
test_expected_(error(Formal), throws(error(Formal, _))).
test_expected_(error(Formal, Context), throws(error(Formal, Context))).
test_expected_(throws(Ball), throws(Ball)).
test_expected_(exception(Ball), throws(Ball)).
test_expected_(all(Goal), all(Goal)).
test_expected_(bag(Goal), bag(Goal)).
test_expected_(set(Goal), set(Goal)).
test_expected_(Goal, true(Goal)) :-
    compound(Goal),
    functor(Goal, Operator, 2),
    memberchk(Operator, [==, =, =:=, =@=, \==, \=, =\=, <, >, =<, >=, @<, @>, @=<, @>=, is, =.., \=@=]).

test_runs_(true(Goal), Options, Body, Outcome) :-
    (   catch(call_cleanup(Body, Last = true), Error, true)
    ->  (   nonvar(Error)
        ->  Outcome = failed("raised ~p", [Error])
        ;   catch(Goal, Error1, true)
        ->  (   nonvar(Error1)
            ->  Outcome = failed("~p raised ~p", [Goal, Error1])
            ;   Last == true
            ->  Outcome = passed
            ;   member(nondet, Options)
            ->  Outcome = passed
            ;   Outcome = choices
            )
        ;   Outcome = failed("wrong answer: ~p does not hold", [Goal])
        )
    ;   Outcome = failed("failed", [])
    ).
test_runs_(fail, _, Body, Outcome) :-
    (   catch(Body, Error, true)
    ->  (   nonvar(Error)
        ->  Outcome = failed("raised ~p", [Error])
        ;   Outcome = failed("must fail, but succeeded", [])
        )
    ;   Outcome = passed
    ).
test_runs_(throws(Expected), _, Body, Outcome) :-
    (   catch(Body, Error, true)
    ->  (   var(Error)
        ->  Outcome = failed("must raise ~p, but succeeded", [Expected])
        ;   subsumes_term(Expected, Error)
        ->  Outcome = passed
        ;   Outcome = failed("must raise ~p, but raised ~p", [Expected, Error])
        )
    ;   Outcome = failed("must raise ~p, but failed", [Expected])
    ).
test_runs_(all(Goal), _, Body, Outcome) :-
    test_collects_(Goal, Body, (=), Outcome).
test_runs_(bag(Goal), _, Body, Outcome) :-
    test_collects_(Goal, Body, msort, Outcome).
test_runs_(set(Goal), _, Body, Outcome) :-
    test_collects_(Goal, Body, sort, Outcome).

test_collects_(Goal, Body, Order, Outcome) :-
    Goal =.. [Operator, Template, Expected],
    catch(findall(Template, Body, Found), Error, true),
    (   nonvar(Error)
    ->  Outcome = failed("raised ~p", [Error])
    ;   call(Order, Found, Ordered),
        call(Order, Expected, Wanted),
        call(Operator, Ordered, Wanted)
    ->  Outcome = passed
    ;   Outcome = failed("expected the solutions ~p, found ~p", [Expected, Found])
    ).

% Reports

report_(passed, _, _, _) :-
    unit_says_(".", []).
report_(choices, Place, Name, _) :-
    report_place_("Warning", Place, Name, none),
    unit_says_("succeeded with choicepoint~n", []).
report_(failed(Format, Arguments), Place, Name, Values) :-
    report_place_("ERROR", Place, Name, Values),
    unit_says_(Format, Arguments),
    unit_says_("~n", []).

report_place_(Kind, Place, Name, Values) :-
    (   Place = File:Line
    ->  unit_says_("~n~s: ~w:~w:~n\ttest ~p", [Kind, File, Line, Name])
    ;   unit_says_("~n~s: test ~p", [Kind, Name])
    ),
    (   Values == none
    ->  true
    ;   unit_says_(" (forall bindings = ~p)", [Values])
    ),
    unit_says_(": ", []).

report_counts_(counts(Passed, Failed, Blocked, Fixme)) :-
    report_number_(Blocked, "blocked"),
    report_number_(Fixme, "to be fixed"),
    (   Failed =:= 0
    ->  (   Passed =:= 0
        ->  unit_says_("% No tests to run~n", [])
        ;   Passed =:= 1
        ->  unit_says_("% test passed~n", [])
        ;   unit_says_("% All ~d tests passed~n", [Passed])
        )
    ;   unit_says_("% ~d tests failed~n% ~d tests passed~n", [Failed, Passed])
    ).

report_number_(Number, What) :-
    (   Number =:= 0
    ->  true
    ;   unit_says_("% ~d tests are ~s~n", [Number, What])
    ).
