% Association lists as AVL trees: t (empty) and t(Key,Value,Balance,Left,Right), of balance <, - or >.
%
% defines: empty_assoc/1 put_assoc/4 get_assoc/3 list_to_assoc/2 ord_list_to_assoc/2 assoc_to_list/2 assoc_to_keys/2
% defines: assoc_to_values/2 max_assoc/3 min_assoc/3 del_assoc/4 map_assoc/2 map_assoc/3 gen_assoc/3
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

get_assoc(Key, A, Val) :-
    (   nonvar(A), A = t(K, V, _, L, R)
    ->  compare(Order, Key, K),
        get_assoc_(Order, Key, V, L, R, Val)
    ;   A \== t,
        no_tree_(A)
    ).

no_tree_(A) :-
    (   var(A)
    ->  throw(error(instantiation_error, _))
    ;   throw(error(type_error(btree, A), _))
    ).

get_assoc_(=, _, Val, _, _, Val).
get_assoc_(<, Key, _, L, _, Val) :-
    get_below_(L, Key, Val).
get_assoc_(>, Key, _, _, R, Val) :-
    get_below_(R, Key, Val).

get_below_(A, Key, Val) :-
    nonvar(A),
    A = t(K, V, _, L, R),
    compare(Order, Key, K),
    get_assoc_(Order, Key, V, L, R, Val).

put_assoc(Key, A, Value, New) :-
    insert_assoc_(A, Key, Value, New, _).

insert_assoc_(A, Key, Val, New, Grown) :-
    (   A == t
    ->  New = t(Key, Val, -, t, t),
        Grown = yes
    ;   nonvar(A), A = t(K, V, B, L, R)
    ->  compare(Order, Key, K),
        insert_assoc_(Order, K, V, B, L, R, Key, Val, New, Grown)
    ;   '$no_rule'(assoc, insert(A, Key, Val, New, Grown))
    ).

insert_assoc_(=, Key, _, B, L, R, Key, Val, t(Key, Val, B, L, R), no).
insert_assoc_(<, K, V, B, L, R, Key, Val, New, Grown) :-
    insert_assoc_(L, Key, Val, L1, LeftGrown),
    rebalance_(LeftGrown, left, K, V, B, L1, R, New, Grown).
insert_assoc_(>, K, V, B, L, R, Key, Val, New, Grown) :-
    insert_assoc_(R, Key, Val, R1, RightGrown),
    rebalance_(RightGrown, right, K, V, B, L, R1, New, Grown).

% Balance: - both sides the same, < and > the deeper side.

rebalance_(no, _, K, V, B, L, R, t(K, V, B, L, R), no).
rebalance_(yes, left, K, V, B, L, R, New, Grown) :-
    left_grown_(B, K, V, L, R, New, Grown).
rebalance_(yes, right, K, V, B, L, R, New, Grown) :-
    right_grown_(B, K, V, L, R, New, Grown).

left_grown_(-, K, V, L, R, t(K, V, <, L, R), yes).
left_grown_(>, K, V, L, R, t(K, V, -, L, R), no).
left_grown_(<, K, V, t(K1, V1, B1, L1, R1), R, New, no) :-
    rotate_right_(B1, K, V, K1, V1, L1, R1, R, New).

rotate_right_(<, K, V, K1, V1, L1, R1, R, t(K1, V1, -, L1, t(K, V, -, R1, R))).
rotate_right_(>, K, V, K1, V1, L1, t(K2, V2, B2, L2, R2), R,
              t(K2, V2, -, t(K1, V1, BL, L1, L2), t(K, V, BR, R2, R))) :-
    double_(B2, BL, BR).

right_grown_(-, K, V, L, R, t(K, V, >, L, R), yes).
right_grown_(<, K, V, L, R, t(K, V, -, L, R), no).
right_grown_(>, K, V, L, t(K1, V1, B1, L1, R1), New, no) :-
    rotate_left_(B1, K, V, K1, V1, L, L1, R1, New).

rotate_left_(>, K, V, K1, V1, L, L1, R1, t(K1, V1, -, t(K, V, -, L, L1), R1)).
rotate_left_(<, K, V, K1, V1, L, t(K2, V2, B2, L2, R2), R1,
             t(K2, V2, -, t(K, V, BL, L, L2), t(K1, V1, BR, R2, R1))) :-
    double_(B2, BL, BR).

double_(-, -, -).
double_(<, -, >).
double_(>, <, -).

list_to_assoc(List, Assoc) :-
    must_be(list, List),
    must_be(list(pair), List),
    keysort(List, Sorted),
    (   increasing_(Sorted)
    ->  sorted_to_assoc_(Sorted, Assoc)
    ;   throw(error(domain_error(unique_key_pairs, List), _))
    ).

ord_list_to_assoc(List, Assoc) :-
    (   is_of_type(list_or_partial, List)
    ->  must_be(list, List)
    ;   true
    ),
    (   is_of_type(list(pair), List), increasing_(List)
    ->  sorted_to_assoc_(List, Assoc)
    ;   throw(error(domain_error(key_ordered_pairs, List), _))
    ).

increasing_([]).
increasing_([K-_|T]) :-
    increasing_(T, K).

increasing_([], _).
increasing_([K-_|T], K0) :-
    K0 @< K,
    increasing_(T, K).

sorted_to_assoc_(List, Assoc) :-
    length(List, N),
    balanced_(N, List, [], Assoc, _).

% balanced_(N, Pairs, Rest, Tree, Depth): the first N pairs as a tree, the left side as large or by one larger.

balanced_(0, Rest, Rest, t, 0) :- !.
balanced_(N, Pairs, Rest, t(K, V, B, L, R), D) :-
    NL is N // 2,
    NR is N - NL - 1,
    balanced_(NL, Pairs, [K-V|Pairs1], L, DL),
    balanced_(NR, Pairs1, Rest, R, DR),
    assoc_balance_(DL, DR, B),
    D is DL + 1.

assoc_to_list(A, L) :-
    assoc_to_list_(A, L, []).

assoc_to_list_(t, L, L).
assoc_to_list_(t(K, V, _, L, R), List, Rest) :-
    assoc_to_list_(L, List, [K-V|More]),
    assoc_to_list_(R, More, Rest).

assoc_to_keys(A, Ks) :-
    assoc_to_list(A, L),
    pairs_keys(L, Ks).

assoc_to_values(A, Vs) :-
    assoc_to_list(A, L),
    pairs_values(L, Vs).

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

del_assoc(Key, A0, Value, A) :-
    (   nonvar(A0), ( A0 = t ; A0 = t(_, _, _, _, _) )
    ->  true
    ;   '$no_rule'(assoc, delete(A0, Key, Value, A, _))
    ),
    assoc_to_list(A0, L0),
    del_pair_(L0, Key, Value, L),
    sorted_to_assoc_(L, A).

del_pair_([K-V|T], Key, Value, L) :-
    (   K == Key
    ->  Value = V, L = T
    ;   L = [K-V|R],
        del_pair_(T, Key, Value, R)
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
