% Ordered sets, pairs, folds and ordered solutions.
%
% defines: ord_empty/1 ord_symdiff/3 ord_seteq/2 ord_disjoint/2 ord_intersect/2 ord_selectchk/3
% defines: is_ordset/1 ord_intersection/2 ord_intersection/4 ord_union/4 ord_product/3
% defines: group_pairs_by_key/2 max_member/3 min_member/3 selectchk/4 foldr/4 scanl/4 scanl/5 scanl/6 scanl/7
% defines: get_assoc/5 del_min_assoc/4 del_max_assoc/4 order_by/2

ord_empty([]).

is_ordset(Set) :-
    is_list(Set),
    sort(Set, Sorted),
    Sorted == Set.

ord_seteq(Set1, Set2) :-
    Set1 == Set2.

ord_symdiff(Set1, Set2, Difference) :-
    ord_subtract(Set1, Set2, Only1),
    ord_subtract(Set2, Set1, Only2),
    ord_union(Only1, Only2, Difference).

ord_disjoint(Set1, Set2) :-
    ord_intersection(Set1, Set2, []).

ord_intersect(Set1, Set2) :-
    \+ ord_disjoint(Set1, Set2).

ord_intersection([First|Sets], Common) :-
    foldl(ord_intersection, Sets, First, Common).

ord_intersection(Set1, Set2, Common, Rest) :-
    ord_intersection(Set1, Set2, Common),
    ord_subtract(Set2, Set1, Rest).

ord_union(Set1, Set2, Union, New) :-
    ord_subtract(Set2, Set1, New),
    ord_union(Set1, New, Union).

ord_selectchk(Element, Set, Rest) :-
    ord_memberchk(Element, Set),
    ord_del_element(Set, Element, Rest).

ord_product(Set1, Set2, Product) :-
    findall(A-B, (member(A, Set1), member(B, Set2)), Product).

group_pairs_by_key([], []).
group_pairs_by_key([K-V|Pairs], [K-[V|Vs]|Groups]) :-
    group_values_(Pairs, K, Vs, Rest),
    group_pairs_by_key(Rest, Groups).

group_values_([K1-V|Pairs], K, [V|Vs], Rest) :-
    K1 == K, !,
    group_values_(Pairs, K, Vs, Rest).
group_values_(Rest, _, [], Rest).

% The goal has to be an order like @=</2. Of items that are equal by it, the first one is returned.

max_member(Goal, Max, List) :-
    best_member_(List, max_member, greater_member_(Goal), Goal, Max).

best_member_(List, Name, Step, Goal, Best) :-
    (   is_list(List)
    ->  List = [First|Items],
        foldl(Step, Items, First, Best)
    ;   Call =.. [Name, user:Goal, Best, List],
        '$no_rule'(lists, Call)
    ).

greater_member_(Goal, Item, Max0, Max) :-
    (   call(Goal, Item, Max0)
    ->  Max = Max0
    ;   Max = Item
    ).

min_member(Goal, Min, List) :-
    best_member_(List, min_member, lesser_member_(Goal), Goal, Min).

lesser_member_(Goal, Item, Min0, Min) :-
    (   call(Goal, Min0, Item)
    ->  Min = Min0
    ;   Min = Item
    ).

selectchk(X, Xs, Y, Ys) :-
    select(X, Xs, Y, Ys), !.

foldr(Goal, List, V0, V) :-
    foldr_(List, Goal, V0, V).

foldr_([], _, V, V).
foldr_([X|Xs], Goal, V0, V) :-
    foldr_(Xs, Goal, V0, V1),
    call(Goal, X, V1, V).

scanl(Goal, List, V, [V|Vs]) :-
    scanl_(List, Goal, V, Vs).

scanl_([], _, _, []).
scanl_([X|Xs], Goal, V0, [V|Vs]) :-
    call(Goal, X, V0, V),
    scanl_(Xs, Goal, V, Vs).

scanl(Goal, L1, L2, V, [V|Vs]) :-
    scanl_(L1, L2, Goal, V, Vs).

scanl_([], [], _, _, []).
scanl_([X|Xs], [Y|Ys], Goal, V0, [V|Vs]) :-
    call(Goal, X, Y, V0, V),
    scanl_(Xs, Ys, Goal, V, Vs).

scanl(Goal, L1, L2, L3, V, [V|Vs]) :-
    scanl_(L1, L2, L3, Goal, V, Vs).

scanl_([], [], [], _, _, []).
scanl_([X|Xs], [Y|Ys], [Z|Zs], Goal, V0, [V|Vs]) :-
    call(Goal, X, Y, Z, V0, V),
    scanl_(Xs, Ys, Zs, Goal, V, Vs).

scanl(Goal, L1, L2, L3, L4, V, [V|Vs]) :-
    scanl_(L1, L2, L3, L4, Goal, V, Vs).

scanl_([], [], [], [], _, _, []).
scanl_([X|Xs], [Y|Ys], [Z|Zs], [U|Us], Goal, V0, [V|Vs]) :-
    call(Goal, X, Y, Z, U, V0, V),
    scanl_(Xs, Ys, Zs, Us, Goal, V, Vs).

% Association lists

get_assoc(Key, Assoc0, Old, Assoc, New) :-
    get_assoc(Key, Assoc0, Old),
    put_assoc(Key, Assoc0, New, Assoc).

del_min_assoc(Assoc0, Key, Value, Assoc) :-
    min_assoc(Assoc0, MinKey, _),
    del_assoc(MinKey, Assoc0, Value, Assoc),
    Key = MinKey.

del_max_assoc(Assoc0, Key, Value, Assoc) :-
    max_assoc(Assoc0, MaxKey, _),
    del_assoc(MaxKey, Assoc0, Value, Assoc),
    Key = MaxKey.

% Solutions in the order of asc(Term) and desc(Term) specifications; the first specification is the primary key.

order_by(Specs, Goal) :-
    must_be(list, Specs),
    term_variables(Goal, Variables),
    findall(Specs-Variables, Goal, Solutions),
    length(Specs, Count),
    order_keys_(Count, Specs, Solutions, Sorted),
    member(Specs-Variables, Sorted).

order_keys_(0, _, Sorted, Sorted) :- !.
order_keys_(N, Specs, Solutions, Sorted) :-
    nth1(N, Specs, Spec),
    must_be(nonvar, Spec),
    maplist(order_key_(N), Solutions, Keyed),
    order_sort_(Spec, Keyed, Ordered),
    pairs_values(Ordered, Solutions1),
    M is N - 1,
    order_keys_(M, Specs, Solutions1, Sorted).

order_key_(N, Specs-Variables, Key-(Specs-Variables)) :-
    nth1(N, Specs, Spec),
    arg(1, Spec, Key).

order_sort_(asc(_), Keyed, Ordered) :- !,
    sort(1, @=<, Keyed, Ordered).
order_sort_(desc(_), Keyed, Ordered) :- !,
    sort(1, @>=, Keyed, Ordered).
order_sort_(Spec, _, _) :-
    throw(error(domain_error(order_specifier, Spec), _)).
