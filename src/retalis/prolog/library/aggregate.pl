% Aggregation over the solutions of a goal, for each binding of its free variables; conjunctions over solutions.
%
% defines: aggregate/3 aggregate/4 foreach/2 group_by/4

aggregate(Spec, Goal, Result) :-
    aggregate_template_(Spec, Template),
    bagof(Template, Goal, Found),
    aggregate_value_(Spec, Found, Result).

aggregate(Spec, Discriminator, Goal, Result) :-
    aggregate_template_(Spec, Template),
    setof(Discriminator-Template, Goal, Pairs),
    pairs_values(Pairs, Found),
    aggregate_value_(Spec, Found, Result).

% What is collected for each solution.

aggregate_template_(Spec, _) :-
    var(Spec), !,
    throw(error(instantiation_error, _)).
aggregate_template_(count, count) :- !.
aggregate_template_(count(Of), Of) :- !.
aggregate_template_(sum(Of), Of) :- !.
aggregate_template_(max(Of), Of) :- !.
aggregate_template_(min(Of), Of) :- !.
aggregate_template_(max(Of, Witness), Of-Witness) :- !.
aggregate_template_(min(Of, Witness), Of-Witness) :- !.
aggregate_template_(bag(Of), Of) :- !.
aggregate_template_(set(Of), Of) :- !.
aggregate_template_(Spec, Template) :-
    compound(Spec), !,
    Spec =.. [_|Specs],
    maplist(aggregate_template_, Specs, Templates),
    Template =.. [v|Templates].
aggregate_template_(Spec, _) :-
    throw(error(domain_error(aggregate_template, Spec), _)).

aggregate_value_(count, Found, Count) :- !,
    length(Found, Count).
aggregate_value_(count(_), Found, Count) :- !,
    length(Found, Count).
aggregate_value_(sum(_), Found, Sum) :- !,
    foldl(aggregate_sum_, Found, 0, Sum).
aggregate_value_(max(_), Found, Max) :- !,
    maplist(aggregate_number_, Found, Numbers),
    max_list(Numbers, Max).
aggregate_value_(min(_), Found, Min) :- !,
    maplist(aggregate_number_, Found, Numbers),
    min_list(Numbers, Min).
aggregate_value_(max(_, _), [First|Found], max(Max, Witness)) :- !,
    aggregate_pair_(First, Start),
    foldl(aggregate_greater_, Found, Start, Max-Witness).
aggregate_value_(min(_, _), [First|Found], min(Min, Witness)) :- !,
    aggregate_pair_(First, Start),
    foldl(aggregate_lesser_, Found, Start, Min-Witness).
aggregate_value_(bag(_), Found, Found) :- !.
aggregate_value_(set(_), Found, Set) :- !,
    sort(Found, Set).
aggregate_value_(Spec, Found, Result) :-
    Spec =.. [Name|Specs],
    aggregate_columns_(Specs, 1, Found, Results),
    Result =.. [Name|Results].

aggregate_columns_([], _, _, []).
aggregate_columns_([Spec|Specs], At, Found, [Result|Results]) :-
    maplist(arg(At), Found, Column),
    aggregate_value_(Spec, Column, Result),
    Next is At + 1,
    aggregate_columns_(Specs, Next, Found, Results).

aggregate_sum_(Of, Sum0, Sum) :-
    Sum is Sum0 + Of.

aggregate_number_(Of, Number) :-
    Number is Of.

aggregate_pair_(Of-Witness, Number-Witness) :-
    Number is Of.

aggregate_greater_(Of-Witness, Best0, Best) :-
    Number is Of,
    Best0 = Most-_,
    (   Number > Most
    ->  Best = Number-Witness
    ;   Best = Best0
    ).

aggregate_lesser_(Of-Witness, Best0, Best) :-
    Number is Of,
    Best0 = Least-_,
    (   Number < Least
    ->  Best = Number-Witness
    ;   Best = Best0
    ).

% The variables that generator and goal share are new ones for each solution; all others of the goal stay.

foreach(Generator, Goal) :-
    term_variables(Generator, Generated),
    term_variables(Goal, Variables),
    foreach_sort_(Variables, Generated, Shared, Kept),
    findall(Shared, Generator, Solutions),
    foreach_prove_(Solutions, Shared, Kept, Goal).

foreach_sort_([], _, [], []).
foreach_sort_([V|Vs], Generated, Shared, Kept) :-
    (   member(G, Generated), G == V
    ->  Shared = [V|Shared1], Kept = Kept1
    ;   Shared = Shared1, Kept = [V|Kept1]
    ),
    foreach_sort_(Vs, Generated, Shared1, Kept1).

foreach_prove_([], _, _, _).
foreach_prove_([Solution|Solutions], Shared, Kept, Goal) :-
    copy_term(Shared-Kept-Goal, Solution-Kept-Instance),
    call(Instance),
    foreach_prove_(Solutions, Shared, Kept, Goal).

group_by(By, Template, Goal, Bag) :-
    findall(By-Template, Goal, Pairs),
    Pairs \== [],
    keysort(Pairs, Sorted),
    group_pairs_by_key(Sorted, Groups),
    member(By-Bag, Groups).
