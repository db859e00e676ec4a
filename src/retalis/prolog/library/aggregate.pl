% Aggregation over the solutions of a goal, for each binding of its free variables; conjunctions over solutions.
%
% defines: aggregate/3 aggregate/4 foreach/2 group_by/4

aggregate(Spec, Goal, Result) :-
    aggregate_template_(Spec, Template),
    bagof(Template, Goal, Values),
    aggregate_value_(Spec, Values, Result).

aggregate(Spec, Discriminator, Goal, Result) :-
    aggregate_template_(Spec, Template),
    setof(Discriminator-Template, Goal, Pairs),
    pairs_values(Pairs, Values),
    aggregate_value_(Spec, Values, Result).

% The template that is collected for each solution.

aggregate_template_(Spec, _) :-
    var(Spec), !,
    throw(error(instantiation_error, _)).
aggregate_template_(count, count) :- !.
aggregate_template_(count(Expression), Expression) :- !.
aggregate_template_(sum(Expression), Expression) :- !.
aggregate_template_(max(Expression), Expression) :- !.
aggregate_template_(min(Expression), Expression) :- !.
aggregate_template_(max(Expression, Witness), Expression-Witness) :- !.
aggregate_template_(min(Expression, Witness), Expression-Witness) :- !.
aggregate_template_(bag(Expression), Expression) :- !.
aggregate_template_(set(Expression), Expression) :- !.
aggregate_template_(Spec, Template) :-
    compound(Spec), !,
    Spec =.. [_|Specs],
    maplist(aggregate_template_, Specs, Templates),
    Template =.. [v|Templates].
aggregate_template_(Spec, _) :-
    throw(error(domain_error(aggregate_template, Spec), _)).

aggregate_value_(count, Values, Count) :- !,
    length(Values, Count).
aggregate_value_(count(_), Values, Count) :- !,
    length(Values, Count).
aggregate_value_(sum(_), Values, Sum) :- !,
    foldl(aggregate_sum_, Values, 0, Sum).
aggregate_value_(max(_), Values, Max) :- !,
    maplist(aggregate_number_, Values, Numbers),
    max_list(Numbers, Max).
aggregate_value_(min(_), Values, Min) :- !,
    maplist(aggregate_number_, Values, Numbers),
    min_list(Numbers, Min).
aggregate_value_(max(_, _), [First|Values], max(Max, Witness)) :- !,
    aggregate_pair_(First, Start),
    foldl(aggregate_greater_, Values, Start, Max-Witness).
aggregate_value_(min(_, _), [First|Values], min(Min, Witness)) :- !,
    aggregate_pair_(First, Start),
    foldl(aggregate_lesser_, Values, Start, Min-Witness).
aggregate_value_(bag(_), Values, Values) :- !.
aggregate_value_(set(_), Values, Set) :- !,
    sort(Values, Set).
aggregate_value_(Spec, Values, Result) :-
    Spec =.. [Name|Specs],
    aggregate_columns_(Specs, 1, Values, Results),
    Result =.. [Name|Results].

aggregate_columns_([], _, _, []).
aggregate_columns_([Spec|Specs], Index, Values, [Result|Results]) :-
    maplist(arg(Index), Values, Column),
    aggregate_value_(Spec, Column, Result),
    Next is Index + 1,
    aggregate_columns_(Specs, Next, Values, Results).

aggregate_sum_(Expression, Sum0, Sum) :-
    Sum is Sum0 + Expression.

aggregate_number_(Expression, Number) :-
    Number is Expression.

aggregate_pair_(Expression-Witness, Number-Witness) :-
    Number is Expression.

aggregate_greater_(Expression-Witness, Best0, Best) :-
    Number is Expression,
    Best0 = Max-_,
    (   Number > Max
    ->  Best = Number-Witness
    ;   Best = Best0
    ).

aggregate_lesser_(Expression-Witness, Best0, Best) :-
    Number is Expression,
    Best0 = Min-_,
    (   Number < Min
    ->  Best = Number-Witness
    ;   Best = Best0
    ).

% Variables that generator and goal share are renamed for each solution; the other variables of the goal are not.

foreach(Generator, Goal) :-
    term_variables(Generator, Generated),
    term_variables(Goal, Variables),
    foreach_sort_(Variables, Generated, Shared, Global),
    findall(Shared, Generator, Solutions),
    foreach_prove_(Solutions, Shared, Global, Goal).

foreach_sort_([], _, [], []).
foreach_sort_([V|Vs], Generated, Shared, Global) :-
    (   member(G, Generated), G == V
    ->  Shared = [V|Shared1], Global = Global1
    ;   Shared = Shared1, Global = [V|Global1]
    ),
    foreach_sort_(Vs, Generated, Shared1, Global1).

foreach_prove_([], _, _, _).
foreach_prove_([Solution|Solutions], Shared, Global, Goal) :-
    copy_term(Shared-Global-Goal, Solution-Global-Instance),
    call(Instance),
    foreach_prove_(Solutions, Shared, Global, Goal).

group_by(By, Template, Goal, Bag) :-
    findall(By-Template, Goal, Pairs),
    Pairs \== [],
    keysort(Pairs, Sorted),
    group_pairs_by_key(Sorted, Groups),
    member(By-Bag, Groups).
