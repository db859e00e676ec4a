% Association lists as AVL trees: t (empty) and t(Key,Value,Balance,Left,Right), of balance <, - or >.
%
% defines: empty_assoc/1 list_to_assoc/2 ord_list_to_assoc/2 max_assoc/3
% defines: min_assoc/3 map_assoc/2 map_assoc/3 gen_assoc/3
% defines: is_assoc/1

empty_assoc(t).

is_assoc(A) :-
    assoc_depth_(A, _),
    assoc_to_keys(A, Keys),
    sort(Keys, Keys).

assoc_depth_(A, D) :-
    (   A == t
    ->  D = 0
    ;   nonvar(A),
        A = t(_, _, B, L, R),
        assoc_depth_(L, DL),
        assoc_depth_(R, DR),
        assoc_balance_(DL, DR, B0),
        B == B0,
        D is max(DL, DR) + 1
    ).

assoc_balance_(D, D, -) :- !.
assoc_balance_(DL, DR, <) :-
    DL =:= DR + 1, !.
assoc_balance_(DL, DR, >) :-
    DR =:= DL + 1.

% get_assoc/3, put_assoc/4, del_assoc/4, assoc_to_list/2 and similar ones, and '$pairs_to_assoc'/2 are implemented in Python.

list_to_assoc(List, Assoc) :-
    must_be(list, List),
    must_be(list(pair), List),
    keysort(List, Sorted),
    (   '$pairs_to_assoc'(Sorted, Built)
    ->  Assoc = Built
    ;   throw(error(domain_error(unique_key_pairs, List), _))
    ).

ord_list_to_assoc(List, Assoc) :-
    (   is_of_type(list_or_partial, List)
    ->  must_be(list, List)
    ;   true
    ),
    (   is_of_type(list(pair), List), '$pairs_to_assoc'(List, Built)
    ->  Assoc = Built
    ;   throw(error(domain_error(key_ordered_pairs, List), _))
    ).

max_assoc(A, Key, Val) :-
    (   nonvar(A), A = t(K, V, _, _, R)
    ->  (   R == t
        ->  Key = K, Val = V
        ;   max_assoc(R, Key, Val)
        )
    ;   A \== t,
        '$no_rule'(assoc, max_assoc(A, Key, Val))
    ).

min_assoc(A, Key, Val) :-
    (   nonvar(A), A = t(K, V, _, L, _)
    ->  (   L == t
        ->  Key = K, Val = V
        ;   min_assoc(L, Key, Val)
        )
    ;   A \== t,
        '$no_rule'(assoc, min_assoc(A, Key, Val))
    ).

gen_assoc(Key, A, Value) :-
    (   ground(Key)
    ->  get_assoc(Key, A, Value)
    ;   gen_assoc_(A, Key, Value)
    ).

gen_assoc_(A, Key, Value) :-
    (   nonvar(A), A = t(K, V, _, L, R)
    ->  (   gen_assoc_(L, Key, Value)
        ;   Key = K, Value = V
        ;   gen_assoc_(R, Key, Value)
        )
    ;   A \== t,
        '$no_rule'(assoc, gen_assoc_(Key, A, Value))
    ).

map_assoc(G, A) :-
    (   nonvar(A), A = t(_, V, _, L, R)
    ->  map_assoc(G, L),
        call(G, V),
        map_assoc(G, R)
    ;   A == t
    ->  true
    ;   '$no_rule'(assoc, map_assoc_(A, user:G))
    ).

map_assoc(G, A, B) :-
    (   nonvar(A), A = t(K, V, S, L0, R0)
    ->  B = t(K, W, S, L1, R1),
        map_assoc(G, L0, L1),
        call(G, V, W),
        map_assoc(G, R0, R1)
    ;   A == t
    ->  B = t
    ;   '$no_rule'(assoc, map_assoc_(A, user:G, B))
    ).
