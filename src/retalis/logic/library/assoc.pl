% Association lists as AVL trees: t (empty) and t(Key,Value,Balance,Left,Right).
%
% defines: empty_assoc/1 put_assoc/4 get_assoc/3 list_to_assoc/2 ord_list_to_assoc/2 assoc_to_list/2 assoc_to_keys/2
% defines: assoc_to_values/2 max_assoc/3 min_assoc/3 del_assoc/4 map_assoc/2 map_assoc/3 gen_assoc/3

empty_assoc(t).

get_assoc(Key, t(K, V, _, L, R), Val) :-
    compare(Order, Key, K),
    get_assoc_(Order, Key, V, L, R, Val).

get_assoc_(=, _, Val, _, _, Val).
get_assoc_(<, Key, _, L, _, Val) :-
    get_assoc(Key, L, Val).
get_assoc_(>, Key, _, _, R, Val) :-
    get_assoc(Key, R, Val).

put_assoc(Key, A, Value, New) :-
    insert_assoc_(A, Key, Value, New, _).

insert_assoc_(t, Key, Val, t(Key, Val, <, t, t), yes).
insert_assoc_(t(K, V, B, L, R), Key, Val, New, Grown) :-
    compare(Order, Key, K),
    insert_assoc_(Order, K, V, B, L, R, Key, Val, New, Grown).

insert_assoc_(=, Key, _, B, L, R, Key, Val, t(Key, Val, B, L, R), no).
insert_assoc_(<, K, V, B, L, R, Key, Val, New, Grown) :-
    insert_assoc_(L, Key, Val, L1, LeftGrown),
    rebalance_(LeftGrown, left, K, V, B, L1, R, New, Grown).
insert_assoc_(>, K, V, B, L, R, Key, Val, New, Grown) :-
    insert_assoc_(R, Key, Val, R1, RightGrown),
    rebalance_(RightGrown, right, K, V, B, L, R1, New, Grown).

% Balance: '<' both sides the same, l and r the deeper side.

rebalance_(no, _, K, V, B, L, R, t(K, V, B, L, R), no).
rebalance_(yes, left, K, V, B, L, R, New, Grown) :-
    left_grown_(B, K, V, L, R, New, Grown).
rebalance_(yes, right, K, V, B, L, R, New, Grown) :-
    right_grown_(B, K, V, L, R, New, Grown).

left_grown_(<, K, V, L, R, t(K, V, l, L, R), yes).
left_grown_(r, K, V, L, R, t(K, V, <, L, R), no).
left_grown_(l, K, V, t(K1, V1, B1, L1, R1), R, New, no) :-
    rotate_right_(B1, K, V, K1, V1, L1, R1, R, New).

rotate_right_(l, K, V, K1, V1, L1, R1, R, t(K1, V1, <, L1, t(K, V, <, R1, R))).
rotate_right_(r, K, V, K1, V1, L1, t(K2, V2, B2, L2, R2), R,
              t(K2, V2, <, t(K1, V1, BL, L1, L2), t(K, V, BR, R2, R))) :-
    double_(B2, BL, BR).

right_grown_(<, K, V, L, R, t(K, V, r, L, R), yes).
right_grown_(l, K, V, L, R, t(K, V, <, L, R), no).
right_grown_(r, K, V, L, t(K1, V1, B1, L1, R1), New, no) :-
    rotate_left_(B1, K, V, K1, V1, L, L1, R1, New).

rotate_left_(r, K, V, K1, V1, L, L1, R1, t(K1, V1, <, t(K, V, <, L, L1), R1)).
rotate_left_(l, K, V, K1, V1, L, t(K2, V2, B2, L2, R2), R1,
             t(K2, V2, <, t(K, V, BL, L, L2), t(K1, V1, BR, R2, R1))) :-
    double_(B2, BL, BR).

double_(<, <, <).
double_(l, <, r).
double_(r, l, <).

list_to_assoc(List, Assoc) :-
    must_be(list, List),
    list_to_assoc_(List, t, Assoc).

list_to_assoc_([], A, A).
list_to_assoc_([Pair|T], A0, A) :-
    must_be(pair, Pair),
    Pair = K-V,
    (   get_assoc(K, A0, _)
    ->  throw(error(domain_error(unique_key_pairs, [Pair|T]), _))
    ;   put_assoc(K, A0, V, A1)
    ),
    list_to_assoc_(T, A1, A).

ord_list_to_assoc(List, Assoc) :-
    list_to_assoc(List, Assoc).

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

max_assoc(t(K, V, _, _, R), Key, Val) :-
    (   R == t
    ->  Key = K, Val = V
    ;   max_assoc(R, Key, Val)
    ).

min_assoc(t(K, V, _, L, _), Key, Val) :-
    (   L == t
    ->  Key = K, Val = V
    ;   min_assoc(L, Key, Val)
    ).

gen_assoc(Key, Assoc, Value) :-
    (   ground(Key)
    ->  get_assoc(Key, Assoc, Value)
    ;   assoc_to_list(Assoc, L),
        member(Key-Value, L)
    ).

del_assoc(Key, A0, Value, A) :-
    assoc_to_list(A0, L0),
    del_pair_(L0, Key, Value, L),
    list_to_assoc(L, A).

del_pair_([K-V|T], Key, Value, L) :-
    (   K == Key
    ->  Value = V, L = T
    ;   L = [K-V|R],
        del_pair_(T, Key, Value, R)
    ).

map_assoc(_, t).
map_assoc(G, t(_, V, _, L, R)) :-
    map_assoc(G, L),
    call(G, V),
    map_assoc(G, R).

map_assoc(_, t, t).
map_assoc(G, t(K, V, B, L0, R0), t(K, W, B, L1, R1)) :-
    map_assoc(G, L0, L1),
    call(G, V, W),
    map_assoc(G, R0, R1).
