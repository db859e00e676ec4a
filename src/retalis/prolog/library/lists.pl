% List predicates that are short in Prolog or call goals of the program.
%
% defines: append/3 append/2 member/2 select/3 select/4 selectchk/3 permutation/2 delete/3
% defines: exclude/3 include/3 partition/4 partition/5 maplist/2 maplist/3 maplist/4 maplist/5 maplist/6 maplist/7
% defines: foldl/4 foldl/5 foldl/6 foldl/7 convlist/3 predsort/3
% defines: flatten/2 nextto/3 same_length/2 prefix/2 nth0/4 nth1/4 is_set/1
% defines: ord_subtract/3 ord_memberchk/2 ord_insert/3 ord_intersection/3 ord_subset/2
% defines: ord_add_element/3 ord_del_element/3 transpose_pairs/2 map_list_to_pairs/3 clumped/2 subseq/3
% defines: proper_length/2 pairs_keys_values/3 pairs_keys/2 pairs_values/2 $last/2 $reverse/2

append([], L, L).
append([H|T], L, [H|R]) :-
    append(T, L, R).

append(Lists, List) :-
    must_be(list, Lists),
    append_(Lists, List).

append_([], []).
append_([L|Ls], As) :-
    append(L, Ws, As),
    append_(Ls, Ws).

member(X, [Y|Ys]) :-
    member_(Ys, X, Y).

member_(_, X, X).
member_([Y|Ys], X, _) :-
    member_(Ys, X, Y).

select(X, [H|T], R) :-
    select_(T, H, X, R).

select_(T, X, X, T).
select_([H|T], Y, X, [Y|R]) :-
    select_(T, H, X, R).

selectchk(X, L, R) :-
    select(X, L, R), !.

select(X, Xs, Y, Ys) :-
    select4_(Xs, X, Y, Ys).

select4_([X|T], X, Y, [Y|T]).
select4_([H|T], X, Y, [H|T2]) :-
    select4_(T, X, Y, T2).

delete([], _, []).
delete([E|T], D, R) :-
    (   E \= D
    ->  R = [E|R1],
        delete(T, D, R1)
    ;   delete(T, D, R)
    ).

permutation(Xs, Ys) :-
    (   is_list(Xs)
    ->  length(Xs, N), length(Ys, N)
    ;   is_list_or_partial(Xs), is_list_or_partial(Ys)
    ->  length(Ys, N), length(Xs, N)
    ;   must_be(list, Xs)
    ),
    permutation_(Xs, Ys).

is_list_or_partial(L) :-
    is_of_type(list_or_partial, L).

permutation_([], []).
permutation_(L, [F|R]) :-
    select(F, L, L1),
    permutation_(L1, R).

flatten(L, F) :-
    flatten_(L, [], F0), !,
    F = F0.

flatten_(V, T, [V|T]) :-
    var(V), !.
flatten_([], T, T) :- !.
flatten_([H|R], T, F) :- !,
    flatten_(H, F1, F),
    flatten_(R, T, F1).
flatten_(A, T, [A|T]).

nextto(X, Y, [X,Y|_]).
nextto(X, Y, [_|T]) :-
    nextto(X, Y, T).

same_length([], []).
same_length([_|T], [_|T2]) :-
    same_length(T, T2).

prefix([], _).
prefix([E|T], [E|T2]) :-
    prefix(T, T2).

nth0(I, L, E, R) :-
    var(I), !,
    nth_gen_(L, E, R, 0, I).
nth0(I, L, E, R) :-
    must_be(nonneg, I),
    nth_del_(I, L, E, R).

nth1(I, L, E, R) :-
    var(I), !,
    nth_gen_(L, E, R, 1, I).
nth1(I, L, E, R) :-
    must_be(positive_integer, I),
    I0 is I - 1,
    nth_del_(I0, L, E, R).

nth_del_(0, [E|R], E, R) :- !.
nth_del_(N, [H|T], E, [H|R]) :-
    M is N - 1,
    nth_del_(M, T, E, R).

% The index may be in the lists: as an item it is a number then, as the end of a list no number fits it.

nth_gen_([E|R], E, R, B, B).
nth_gen_([H|T], E, [H|R], B, I) :-
    (   var(I)
    ->  true
    ;   integer(I),
        I > B
    ),
    B1 is B + 1,
    nth_gen_(T, E, R, B1, I).

is_set(S) :-
    is_list(S),
    length(S, N),
    sort(S, T),
    length(T, N).

proper_length(L, N) :-
    is_list(L),
    length(L, M),
    N = M.

% Goals on lists

maplist(G, L) :-
    maplist_(L, G).

maplist_([], _).
maplist_([A|As], G) :-
    call(G, A),
    maplist_(As, G).

maplist(G, L1, L2) :-
    maplist_(L1, L2, G).

maplist_([], [], _).
maplist_([A|As], [B|Bs], G) :-
    call(G, A, B),
    maplist_(As, Bs, G).

maplist(G, L1, L2, L3) :-
    maplist_(L1, L2, L3, G).

maplist_([], [], [], _).
maplist_([A|As], [B|Bs], [C|Cs], G) :-
    call(G, A, B, C),
    maplist_(As, Bs, Cs, G).

maplist(G, L1, L2, L3, L4) :-
    maplist_(L1, L2, L3, L4, G).

maplist_([], [], [], [], _).
maplist_([A|As], [B|Bs], [C|Cs], [D|Ds], G) :-
    call(G, A, B, C, D),
    maplist_(As, Bs, Cs, Ds, G).

maplist(G, L1, L2, L3, L4, L5) :-
    maplist_(L1, L2, L3, L4, L5, G).

maplist_([], [], [], [], [], _).
maplist_([A|As], [B|Bs], [C|Cs], [D|Ds], [E|Es], G) :-
    call(G, A, B, C, D, E),
    maplist_(As, Bs, Cs, Ds, Es, G).

maplist(G, L1, L2, L3, L4, L5, L6) :-
    maplist_(L1, L2, L3, L4, L5, L6, G).

maplist_([], [], [], [], [], [], _).
maplist_([A|As], [B|Bs], [C|Cs], [D|Ds], [E|Es], [F|Fs], G) :-
    call(G, A, B, C, D, E, F),
    maplist_(As, Bs, Cs, Ds, Es, Fs, G).

foldl(G, L, V0, V) :-
    foldl_(L, G, V0, V).

foldl_([], _, V, V).
foldl_([X|Xs], G, V0, V) :-
    call(G, X, V0, V1),
    foldl_(Xs, G, V1, V).

foldl(G, L1, L2, V0, V) :-
    foldl_(L1, L2, G, V0, V).

foldl_([], [], _, V, V).
foldl_([X|Xs], [Y|Ys], G, V0, V) :-
    call(G, X, Y, V0, V1),
    foldl_(Xs, Ys, G, V1, V).

foldl(G, L1, L2, L3, V0, V) :-
    foldl_(L1, L2, L3, G, V0, V).

foldl_([], [], [], _, V, V).
foldl_([X|Xs], [Y|Ys], [Z|Zs], G, V0, V) :-
    call(G, X, Y, Z, V0, V1),
    foldl_(Xs, Ys, Zs, G, V1, V).

foldl(G, L1, L2, L3, L4, V0, V) :-
    foldl_(L1, L2, L3, L4, G, V0, V).

foldl_([], [], [], [], _, V, V).
foldl_([X|Xs], [Y|Ys], [Z|Zs], [U|Us], G, V0, V) :-
    call(G, X, Y, Z, U, V0, V1),
    foldl_(Xs, Ys, Zs, Us, G, V1, V).

include(G, L, R) :-
    include_(L, G, R).

include_([], _, []).
include_([X|Xs], G, R) :-
    (   call(G, X)
    ->  R = [X|R1]
    ;   R = R1
    ),
    include_(Xs, G, R1).

exclude(G, L, R) :-
    exclude_(L, G, R).

exclude_([], _, []).
exclude_([X|Xs], G, R) :-
    (   call(G, X)
    ->  R = R1
    ;   R = [X|R1]
    ),
    exclude_(Xs, G, R1).

partition(G, L, I, E) :-
    partition_(L, G, I, E).

partition_([], _, [], []).
partition_([X|Xs], G, I, E) :-
    (   call(G, X)
    ->  I = [X|I1], E = E1
    ;   I = I1, E = [X|E1]
    ),
    partition_(Xs, G, I1, E1).

partition(G, List, L, E, H) :-
    partition_(List, G, L, E, H).

partition_([], _, [], [], []).
partition_([X|Xs], G, L, E, H) :-
    call(G, X, O),
    partition_(O, G, X, Xs, L, E, H).

partition_(O, G, X, Xs, L, E, H) :-
    (   O = (<)
    ->  L = [X|L1],
        partition_(Xs, G, L1, E, H)
    ;   O = (=)
    ->  E = [X|E1],
        partition_(Xs, G, L, E1, H)
    ;   O = (>)
    ->  H = [X|H1],
        partition_(Xs, G, L, E, H1)
    ;   throw(error(type_error(oneof([<,=,>]), O), _))
    ).

convlist(G, L, R) :-
    convlist_(L, G, R).

convlist_([], _, []).
convlist_([X|Xs], G, R) :-
    (   call(G, X, Y)
    ->  R = [Y|R1]
    ;   R = R1
    ),
    convlist_(Xs, G, R1).

predsort(P, L, Sorted) :-
    (   is_list(L)
    ->  length(L, N)
    ;   nonvar(L)
    ->  throw(error(existence_error(type, L), _))
    ;   must_be(list, L)
    ),
    predsort_(P, N, L, _, Sorted).

predsort_(P, 2, [X1,X2|L], L, R) :- !,
    call(P, Delta, X1, X2),
    predsort_2(Delta, X1, X2, R).
predsort_(_, 1, [X|L], L, [X]) :- !.
predsort_(_, 0, L, L, []) :- !.
predsort_(P, N, L1, L3, R) :-
    N1 is N // 2,
    N2 is N - N1,
    predsort_(P, N1, L1, L2, R1),
    predsort_(P, N2, L2, L3, R2),
    '$predmerge'(P, R1, R2, R).

predsort_2(<, X1, X2, [X1,X2]).
predsort_2(=, X1, _, [X1]).
predsort_2(>, X1, X2, [X2,X1]).

% Ordered sets; ord_union is implemented in Python.

ord_subtract(A, B, C) :-
    (   nonvar(A), A = [H|T]
    ->  ord_left_(B, H, T, C)
    ;   A == []
    ->  C = []
    ;   '$no_rule'(ordsets, ord_subtract(A, B, C))
    ).

% ord_left_(Others, First, Rest, Left), ord_kept_(Set, Other, Others, Left)

ord_left_([], H, T, [H|T]).
ord_left_([O|Os], H, T, C) :-
    compare(Order, H, O),
    ord_left_(Order, H, T, O, Os, C).

ord_left_(<, H, T, O, Os, [H|C]) :-
    ord_kept_(T, O, Os, C).
ord_left_(=, _, T, _, Os, C) :-
    ord_rest_(Os, T, C).
ord_left_(>, H, T, _, Os, C) :-
    ord_left_(Os, H, T, C).

ord_kept_([], _, _, []).
ord_kept_([H|T], O, Os, C) :-
    compare(Order, H, O),
    ord_left_(Order, H, T, O, Os, C).

ord_rest_([], T, T).
ord_rest_([O|Os], T, C) :-
    ord_kept_(T, O, Os, C).

ord_intersection([], _, []).
ord_intersection([H|T], Os, C) :-
    ord_common_(Os, H, T, C).

ord_common_([], _, _, []).
ord_common_([O|Os], H, T, C) :-
    compare(Order, H, O),
    ord_common_(Order, H, T, O, Os, C).

ord_common_(<, _, T, O, Os, C) :-
    ord_common_(T, O, Os, C).
ord_common_(=, H, T, _, Os, [H|C]) :-
    ord_intersection(T, Os, C).
ord_common_(>, H, T, _, Os, C) :-
    ord_common_(Os, H, T, C).

ord_memberchk(X, [Y|T]) :-
    compare(O, X, Y),
    (   O = (=)
    ->  true
    ;   O = (>),
        ord_memberchk(X, T)
    ).

ord_subset([], _).
ord_subset([H|T], B) :-
    ord_left_(B, H, T, []).

ord_insert(S, E, S2) :-
    ord_add_element(S, E, S2).

ord_add_element([], E, [E]).
ord_add_element([H|T], E, S) :-
    compare(Order, E, H),
    ord_add_(Order, E, H, T, S).

ord_add_(<, E, H, T, [E,H|T]).
ord_add_(=, _, H, T, [H|T]).
ord_add_(>, E, H, T, [H|S]) :-
    ord_add_element(T, E, S).

ord_del_element([], _, []).
ord_del_element([H|T], E, S) :-
    compare(Order, E, H),
    ord_del_(Order, E, H, T, S).

ord_del_(<, _, H, T, [H|T]).
ord_del_(=, _, _, T, T).
ord_del_(>, E, H, T, [H|S]) :-
    ord_del_element(T, E, S).

% Partial lists; proper lists are handled in Python.

'$last'([X|Xs], Last) :-
    last_(Xs, X, Last).

last_([], Last, Last).
last_([X|Xs], _, Last) :-
    last_(Xs, X, Last).

'$reverse'(Xs, Ys) :-
    reverse_(Xs, [], Ys, Ys).

reverse_([], Ys, Ys, []).
reverse_([X|Xs], Rs, Ys, [_|Bound]) :-
    reverse_(Xs, [X|Rs], Ys, Bound).

% Pairs

pairs_keys_values([], [], []).
pairs_keys_values([K-V|T], [K|Ks], [V|Vs]) :-
    pairs_keys_values(T, Ks, Vs).

pairs_keys([], []).
pairs_keys([K-_|T], [K|Ks]) :-
    pairs_keys(T, Ks).

pairs_values([], []).
pairs_values([_-V|T], [V|Vs]) :-
    pairs_values(T, Vs).

transpose_pairs(Pairs, Transposed) :-
    flip_(Pairs, Flipped),
    keysort(Flipped, Transposed).

flip_([], []).
flip_([K-V|T], [V-K|R]) :-
    flip_(T, R).

map_list_to_pairs(G, L, Pairs) :-
    map_pairs_(L, G, Pairs).

map_pairs_([], _, []).
map_pairs_([H|T], G, [K-H|R]) :-
    call(G, H, K),
    map_pairs_(T, G, R).

clumped([], []).
clumped([H|T], [H-C|R]) :-
    clump_(T, H, 1, C, Rest),
    clumped(Rest, R).

clump_([H|T], E, C0, C, Rest) :-
    E == H, !,
    C1 is C0 + 1,
    clump_(T, E, C1, C, Rest).
clump_(L, _, C, C, L).

subseq([], [], []).
subseq([H|T], S, R) :-
    subseq_(T, H, S, R).

subseq_(T, H, S, [H|R]) :-
    subseq(T, S, R).
subseq_(T, H, [H|S], R) :-
    subseq(T, S, R).
