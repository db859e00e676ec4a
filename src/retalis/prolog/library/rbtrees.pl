% Balanced trees under the names of library(rbtrees): t (empty) and t(Size, Key, Value, Left, Right).
%
% They are balanced by weight: neither side has more than three times the keys of the other.
%
% defines: rb_new/1 rb_empty/1 rb_lookup/3 rb_insert/4 rb_insert_new/4 rb_update/4 rb_update/5 rb_apply/4
% defines: rb_delete/3 rb_delete/4 rb_del_min/4 rb_del_max/4 rb_min/3 rb_max/3 rb_next/4 rb_previous/4 rb_in/3
% defines: rb_visit/2 rb_keys/2 rb_map/2 rb_map/3 rb_partial_map/4 rb_fold/4 rb_clone/3 rb_size/2
% defines: list_to_rbtree/2 ord_list_to_rbtree/2 is_rbtree/1

rb_new(t).

rb_empty(t).

rb_size(t, 0).
rb_size(t(N, _, _, _, _), N).

rb_lookup(Key, Value, t(_, K, V, L, R)) :-
    compare(Order, Key, K),
    rb_lookup_(Order, Key, Value, V, L, R).

rb_lookup_(=, _, V, V, _, _).
rb_lookup_(<, Key, Value, _, L, _) :-
    rb_lookup(Key, Value, L).
rb_lookup_(>, Key, Value, _, _, R) :-
    rb_lookup(Key, Value, R).

% What a node with two sides becomes, one of which has changed by a key.

rb_node_(K, V, L, R, t(N, K, V, L, R)) :-
    rb_size(L, NL),
    rb_size(R, NR),
    N is NL + NR + 1.

rb_balance_(K, V, L, R, T) :-
    rb_size(L, NL),
    rb_size(R, NR),
    (   NL + NR < 2
    ->  rb_node_(K, V, L, R, T)
    ;   NR > 3 * NL
    ->  rb_left_(K, V, L, R, T)
    ;   NL > 3 * NR
    ->  rb_right_(K, V, L, R, T)
    ;   rb_node_(K, V, L, R, T)
    ).

rb_left_(K, V, L, t(_, K1, V1, RL, RR), T) :-
    rb_size(RL, NL),
    rb_size(RR, NR),
    (   NL < 2 * NR
    ->  rb_node_(K, V, L, RL, L1),
        rb_node_(K1, V1, L1, RR, T)
    ;   RL = t(_, K2, V2, LL, LR),
        rb_node_(K, V, L, LL, L1),
        rb_node_(K1, V1, LR, RR, R1),
        rb_node_(K2, V2, L1, R1, T)
    ).

rb_right_(K, V, t(_, K1, V1, LL, LR), R, T) :-
    rb_size(LL, NL),
    rb_size(LR, NR),
    (   NR < 2 * NL
    ->  rb_node_(K, V, LR, R, R1),
        rb_node_(K1, V1, LL, R1, T)
    ;   LR = t(_, K2, V2, ML, MR),
        rb_node_(K1, V1, LL, ML, L1),
        rb_node_(K, V, MR, R, R1),
        rb_node_(K2, V2, L1, R1, T)
    ).

rb_insert(t, Key, Value, t(1, Key, Value, t, t)).
rb_insert(t(N, K, V, L, R), Key, Value, T) :-
    compare(Order, Key, K),
    rb_insert_(Order, Key, Value, N, K, V, L, R, T).

rb_insert_(=, Key, Value, N, _, _, L, R, t(N, Key, Value, L, R)).
rb_insert_(<, Key, Value, _, K, V, L, R, T) :-
    rb_insert(L, Key, Value, L1),
    rb_balance_(K, V, L1, R, T).
rb_insert_(>, Key, Value, _, K, V, L, R, T) :-
    rb_insert(R, Key, Value, R1),
    rb_balance_(K, V, L, R1, T).

rb_insert_new(T0, Key, Value, T) :-
    \+ rb_lookup(Key, _, T0),
    rb_insert(T0, Key, Value, T).

rb_update(T0, Key, Value, T) :-
    rb_update(T0, Key, _, Value, T).

rb_update(t(N, K, V, L, R), Key, Old, New, T) :-
    compare(Order, Key, K),
    rb_update_(Order, Key, Old, New, N, K, V, L, R, T).

rb_update_(=, _, V, New, N, K, V, L, R, t(N, K, New, L, R)).
rb_update_(<, Key, Old, New, N, K, V, L, R, t(N, K, V, L1, R)) :-
    rb_update(L, Key, Old, New, L1).
rb_update_(>, Key, Old, New, N, K, V, L, R, t(N, K, V, L, R1)) :-
    rb_update(R, Key, Old, New, R1).

rb_apply(T0, Key, Goal, T) :-
    rb_lookup(Key, Old, T0),
    call(Goal, Old, New), !,
    rb_update(T0, Key, New, T).

rb_delete(T0, Key, T) :-
    rb_delete(T0, Key, _, T).

rb_delete(t(_, K, V, L, R), Key, Value, T) :-
    compare(Order, Key, K),
    rb_delete_(Order, Key, Value, K, V, L, R, T).

rb_delete_(=, _, V, _, V, L, R, T) :-
    rb_join_(L, R, T).
rb_delete_(<, Key, Value, K, V, L, R, T) :-
    rb_delete(L, Key, Value, L1),
    rb_balance_(K, V, L1, R, T).
rb_delete_(>, Key, Value, K, V, L, R, T) :-
    rb_delete(R, Key, Value, R1),
    rb_balance_(K, V, L, R1, T).

rb_join_(t, R, R) :- !.
rb_join_(L, t, L) :- !.
rb_join_(L, R, T) :-
    rb_del_min(R, K, V, R1),
    rb_balance_(K, V, L, R1, T).

rb_del_min(t(_, K, V, L, R), Key, Value, T) :-
    (   L == t
    ->  Key = K, Value = V, T = R
    ;   rb_del_min(L, Key, Value, L1),
        rb_balance_(K, V, L1, R, T)
    ).

rb_del_max(t(_, K, V, L, R), Key, Value, T) :-
    (   R == t
    ->  Key = K, Value = V, T = L
    ;   rb_del_max(R, Key, Value, R1),
        rb_balance_(K, V, L, R1, T)
    ).

rb_min(t(_, K, V, L, _), Key, Value) :-
    (   L == t
    ->  Key = K, Value = V
    ;   rb_min(L, Key, Value)
    ).

rb_max(t(_, K, V, _, R), Key, Value) :-
    (   R == t
    ->  Key = K, Value = V
    ;   rb_max(R, Key, Value)
    ).

% The least key above one, and the greatest below; the key itself need not be there.

rb_next(T, Key, Next, Value) :-
    rb_above_(T, Key, none, Next-Value).

rb_above_(t, _, Found, Found).
rb_above_(t(_, K, V, L, R), Key, Best, Found) :-
    (   K @> Key
    ->  rb_above_(L, Key, K-V, Found)
    ;   rb_above_(R, Key, Best, Found)
    ).

rb_previous(T, Key, Previous, Value) :-
    rb_below_(T, Key, none, Previous-Value).

rb_below_(t, _, Found, Found).
rb_below_(t(_, K, V, L, R), Key, Best, Found) :-
    (   K @< Key
    ->  rb_below_(R, Key, K-V, Found)
    ;   rb_below_(L, Key, Best, Found)
    ).

rb_in(Key, Value, T) :-
    (   ground(Key)
    ->  rb_lookup(Key, Value, T)
    ;   rb_member_(T, Key, Value)
    ).

rb_member_(t(_, K, V, L, R), Key, Value) :-
    (   rb_member_(L, Key, Value)
    ;   Key = K, Value = V
    ;   rb_member_(R, Key, Value)
    ).

rb_visit(T, Pairs) :-
    rb_visit_(T, Pairs, []).

rb_visit_(t, Pairs, Pairs).
rb_visit_(t(_, K, V, L, R), Pairs, Rest) :-
    rb_visit_(L, Pairs, [K-V|More]),
    rb_visit_(R, More, Rest).

rb_keys(T, Keys) :-
    rb_visit(T, Pairs),
    pairs_keys(Pairs, Keys).

rb_map(T, Goal) :-
    rb_each_(T, Goal).

rb_each_(t, _).
rb_each_(t(_, _, V, L, R), Goal) :-
    rb_each_(L, Goal),
    call(Goal, V), !,
    rb_each_(R, Goal).

rb_map(T0, Goal, T) :-
    rb_map_(T0, Goal, T).

rb_map_(t, _, t).
rb_map_(t(N, K, V, L, R), Goal, t(N, K, V1, L1, R1)) :-
    rb_map_(L, Goal, L1),
    call(Goal, V, V1), !,
    rb_map_(R, Goal, R1).

rb_partial_map(T, [], _, T).
rb_partial_map(T0, [Key|Keys], Goal, T) :-
    (   rb_apply(T0, Key, Goal, T1)
    ->  true
    ;   \+ rb_lookup(Key, _, T0),
        T1 = T0
    ),
    rb_partial_map(T1, Keys, Goal, T).

rb_fold(Goal, T, State0, State) :-
    rb_visit(T, Pairs),
    foldl(Goal, Pairs, State0, State).

rb_clone(T0, T, Pairs) :-
    rb_clone_(T0, T, Pairs, []).

rb_clone_(t, t, Pairs, Pairs).
rb_clone_(t(N, K, _, L0, R0), t(N, K, V, L, R), Pairs, Rest) :-
    rb_clone_(L0, L, Pairs, [K-V|More]),
    rb_clone_(R0, R, More, Rest).

list_to_rbtree(Pairs, T) :-
    must_be(list, Pairs),
    rb_fill_(Pairs, t, T).

rb_fill_([], T, T).
rb_fill_([K-V|Pairs], T0, T) :-
    rb_insert(T0, K, V, T1),
    rb_fill_(Pairs, T1, T).

ord_list_to_rbtree(Pairs, T) :-
    list_to_rbtree(Pairs, T).

is_rbtree(T) :-
    nonvar(T),
    rb_checked_(T, _),
    rb_keys(T, Keys),
    sort(Keys, Keys).

rb_checked_(T, N) :-
    (   T == t
    ->  N = 0
    ;   nonvar(T),
        T = t(N, _, _, L, R),
        rb_checked_(L, NL),
        rb_checked_(R, NR),
        N =:= NL + NR + 1
    ).
