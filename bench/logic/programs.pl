% Classic programs for bench/logic.py; each bench_NAME(N) does its work N times.

repeat_goal(0, _) :- !.
repeat_goal(N, G) :-
    \+ \+ call(G),
    M is N - 1,
    repeat_goal(M, G).

% Naive reverse of 30 elements: 496 inferences.

app([], L, L).
app([H|T], L, [H|R]) :- app(T, L, R).

nrev([], []).
nrev([H|T], R) :- nrev(T, RT), app(RT, [H], R).

bench_nrev(N) :-
    numbers(30, [], L),
    nrevs(N, L).

nrevs(0, _) :- !.
nrevs(N, L) :- nrev(L, _), M is N - 1, nrevs(M, L).

numbers(0, L, L) :- !.
numbers(N, T, L) :- M is N - 1, numbers(M, [N|T], L).

% Takeuchi.

tak(X, Y, Z, A) :- X =< Y, !, Z = A.
tak(X, Y, Z, A) :-
    X1 is X - 1, Y1 is Y - 1, Z1 is Z - 1,
    tak(X1, Y, Z, A1), tak(Y1, Z, X, A2), tak(Z1, X, Y, A3),
    tak(A1, A2, A3, A).

bench_tak(N) :- repeat_goal(N, tak(18, 12, 6, _)).

% Eight queens, all solutions.

queens(N, Qs) :- numbers(N, [], Ns), place(Ns, [], Qs).

place([], Qs, Qs).
place(Free, Safe, Qs) :-
    pick(Q, Free, Rest),
    \+ attacks(Q, 1, Safe),
    place(Rest, [Q|Safe], Qs).

pick(X, [X|Xs], Xs).
pick(X, [Y|Ys], [Y|Zs]) :- pick(X, Ys, Zs).

attacks(X, N, [Y|_]) :- X is Y + N.
attacks(X, N, [Y|_]) :- X is Y - N.
attacks(X, N, [_|Ys]) :- M is N + 1, attacks(X, M, Ys).

bench_queens(0) :- !.
bench_queens(N) :- findall(Q, queens(6, Q), _), M is N - 1, bench_queens(M).

% Zebra.

right_of(X, Y, [Y,X|_]).
right_of(X, Y, [_|T]) :- right_of(X, Y, T).

next_to(X, Y, L) :- right_of(X, Y, L).
next_to(X, Y, L) :- right_of(Y, X, L).

mem(X, [X|_]).
mem(X, [_|T]) :- mem(X, T).

zebra(Owner) :-
    Hs = [h(_, norwegian, _, _, _), _, h(_, _, _, milk, _), _, _],
    mem(h(red, english, _, _, _), Hs),
    mem(h(green, _, _, coffee, _), Hs),
    mem(h(_, spanish, dog, _, _), Hs),
    mem(h(_, ukrainian, _, tea, _), Hs),
    right_of(h(green, _, _, _, _), h(ivory, _, _, _, _), Hs),
    mem(h(_, _, snails, _, winston), Hs),
    mem(h(yellow, _, _, _, kools), Hs),
    next_to(h(_, _, _, _, chesterfield), h(_, _, fox, _, _), Hs),
    next_to(h(_, _, _, _, kools), h(_, _, horse, _, _), Hs),
    mem(h(_, _, _, juice, lucky), Hs),
    mem(h(_, japanese, _, _, parliament), Hs),
    next_to(h(_, norwegian, _, _, _), h(blue, _, _, _, _), Hs),
    mem(h(_, Owner, zebra, _, _), Hs).

bench_zebra(N) :- repeat_goal(N, zebra(_)).

% Symbolic derivation.

d(U + V, X, DU + DV) :- !, d(U, X, DU), d(V, X, DV).
d(U - V, X, DU - DV) :- !, d(U, X, DU), d(V, X, DV).
d(U * V, X, DU * V + U * DV) :- !, d(U, X, DU), d(V, X, DV).
d(U / V, X, (DU * V - U * DV) / (V ^ 2)) :- !, d(U, X, DU), d(V, X, DV).
d(U ^ N, X, DU * N * U ^ N1) :- !, integer(N), N1 is N - 1, d(U, X, DU).
d(- U, X, - DU) :- !, d(U, X, DU).
d(exp(U), X, exp(U) * DU) :- !, d(U, X, DU).
d(log(U), X, DU / U) :- !, d(U, X, DU).
d(X, X, 1) :- !.
d(_, _, 0).

bench_deriv(0) :- !.
bench_deriv(N) :-
    d(((((x * x) * x) * x) * x) / (log(log(x)) + exp(x ^ 3)), x, _),
    M is N - 1,
    bench_deriv(M).

% Primes below 98 by sieve.

primes(N, Ps) :- ints(2, N, Is), sift(Is, Ps).

ints(I, N, [I|T]) :- I =< N, !, J is I + 1, ints(J, N, T).
ints(_, _, []).

sift([], []).
sift([I|Is], [I|Ps]) :- strike(I, Is, New), sift(New, Ps).

strike(_, [], []).
strike(P, [I|Is], Nis) :- 0 is I mod P, !, strike(P, Is, Nis).
strike(P, [I|Is], [I|Nis]) :- strike(P, Is, Nis).

bench_primes(N) :- repeat_goal(N, primes(98, _)).

% A multiplication puzzle with even and odd digits: OEE * EE = EOEE + EOE0 = OOEE.

crypt :-
    odd(A), even(B), even(C), even(E),
    mult([C, B, A], E, [I, H, G, F | X]), lefteven(F), odd(G), even(H), even(I), zero(X), lefteven(D),
    mult([C, B, A], D, [L, K, J | Y]), lefteven(J), odd(K), even(L), zero(Y),
    mult2([C, B, A], [E, D], [P, O, N, M | Z]), odd(M), odd(N), even(O), even(P), zero(Z).

mult(AL, D, BL) :- mult(AL, D, 0, BL).
mult([A|As], D, Carry, [B|Bs]) :- X is A * D + Carry, B is X mod 10, C is X // 10, mult(As, D, C, Bs).
mult([], _, Carry, [C, Cend]) :- C is Carry mod 10, Cend is Carry // 10.

mult2(As, [E, D], Ps) :- mult(As, E, P1), mult(As, D, P2), sum2(P1, [0|P2], Ps).

sum2(As, Bs, Cs) :- sum2(As, Bs, 0, Cs).
sum2([A|As], [B|Bs], Carry, [C|Cs]) :- !, X is A + B + Carry, C is X mod 10, N is X // 10, sum2(As, Bs, N, Cs).
sum2([], Bs, 0, Bs) :- !.
sum2(As, [], 0, As) :- !.
sum2([], [B|Bs], Carry, [C|Cs]) :- X is B + Carry, N is X // 10, C is X mod 10, sum2([], Bs, N, Cs).
sum2([A|As], [], Carry, [C|Cs]) :- X is A + Carry, N is X // 10, C is X mod 10, sum2([], As, N, Cs).
sum2([], [], Carry, [Carry]).

zero([]).
zero([0|L]) :- zero(L).

odd(1). odd(3). odd(5). odd(7). odd(9).
even(0). even(2). even(4). even(6). even(8).
lefteven(2). lefteven(4). lefteven(6). lefteven(8).

bench_crypt(N) :- repeat_goal(N, once(crypt)).

% A join over 10,000 facts.

:- dynamic edge/2.

fill(0) :- !.
fill(N) :- A is N mod 1000, B is (N * 7) mod 1009, assertz(edge(A, B)), M is N - 1, fill(M).

:- initialization(fill(10000)).

bench_join(N) :- repeat_goal(N, join).

join :- edge(3, X), edge(X, Y), edge(Y, _), fail.
join.

% Assert, look up, retract.

:- dynamic fact/2.

bench_assert(0) :- !.
bench_assert(N) :-
    K is N mod 100,
    assertz(fact(K, N)),
    fact(K, V),
    retract(fact(K, V)),
    M is N - 1,
    bench_assert(M).

% Findall and lists of 200.

bench_findall(N) :- repeat_goal(N, all_pairs).

all_pairs :-
    findall(X-Y, (between(1, 200, X), Y is X * X), Ps),
    findall(Y, member(_-Y, Ps), Ys),
    sum_list(Ys, 2686700).

% Like the split of a tf message: take a message term apart, make an event, recurse.

:- dynamic seen/1.

split([]).
split([T|Ts]) :-
    T = stamped(header(_, [Sec, NSec], Parent), Child, transform(vector3(X, Y, Z), quaternion(QX, QY, QZ, QW))),
    event(tf(Parent, Child, [X, Y, Z], [QX, QY, QZ, QW]), Sec, NSec),
    split(Ts).

event(tf(_, _, _, _), S, N) :- S >= 0, N >= 0.

bench_split(0) :- !.
bench_split(N) :-
    split([stamped(header(1, [10, 20], a), b, transform(vector3(1.0, 2.0, 3.0), quaternion(0.0, 0.0, 0.0, 1.0)))]),
    M is N - 1,
    bench_split(M).

bench_count(N) :- count(0, N).

count(N, N) :- !.
count(I, N) :- I < N, J is I + 1, count(J, N).

% Takeuchi with a table, which is how ProbLog's engine runs it.

:- table tabled/4.

tabled(X, Y, Z, A) :- X =< Y, !, Z = A.
tabled(X, Y, Z, A) :-
    X1 is X - 1, Y1 is Y - 1, Z1 is Z - 1,
    tabled(X1, Y, Z, A1), tabled(Y1, Z, X, A2), tabled(Z1, X, Y, A3),
    tabled(A1, A2, A3, A).

bench_tabled(N) :- repeat_goal(N, (abolish_all_tables, tabled(18, 12, 6, _))).

% Lists of 100,000: findall, sorting, association lists. The numbers are the same in every run.

mixed(0, _, []) :- !.
mixed(N, S, [S|T]) :- S1 is (S * 1103515245 + 12345) mod 2147483648, M is N - 1, mixed(M, S1, T).

mixed_atoms(N, As) :- mixed(N, 42, Ns), findall(A, (member(X, Ns), atom_concat(key_, X, A)), As).

mixed_pairs(N, Ps) :- mixed(N, 42, Ns), findall(X-v(X), member(X, Ns), Ps).

mixed_terms(N, Ts) :-
    mixed(N, 42, Ns),
    findall(T, (member(X, Ns), K is X mod 5, mixed_term(K, X, T)), Ts).

mixed_term(0, X, X).
mixed_term(1, X, F) :- F is X / 7.0.
mixed_term(2, X, A) :- atom_concat(key_, X, A).
mixed_term(3, X, p(Y, X)) :- Y is X mod 100.
mixed_term(4, X, "text"-X).

bench_findall_numbers(N) :- repeat_goal(N, findall(X, between(1, 100000, X), _)).

bench_findall_pairs(N) :- mixed_pairs(100000, Ps), repeat_goal(N, findall(V-K, member(K-V, Ps), _)).

bench_findall_member(N) :- mixed_pairs(100000, Ps), repeat_goal(N, findall(P, member(P, Ps), _)).

bench_findall_test(N) :-
    mixed_pairs(100000, Ps), repeat_goal(N, findall(K, (member(K-_, Ps), K > 1000000000), _)).

bench_bagof(N) :- mixed_pairs(100000, Ps), repeat_goal(N, bagof(K, V^member(K-V, Ps), _)).

bench_sort_numbers(N) :- mixed(100000, 42, L), repeat_goal(N, sort(L, _)).
bench_sort_atoms(N) :- mixed_atoms(100000, L), repeat_goal(N, msort(L, _)).
bench_sort_pairs(N) :- mixed_pairs(100000, L), repeat_goal(N, msort(L, _)).
bench_sort_mixed(N) :- mixed_terms(100000, L), repeat_goal(N, msort(L, _)).
bench_keysort(N) :- mixed_pairs(100000, L), repeat_goal(N, keysort(L, _)).
bench_predsort(N) :- mixed(10000, 42, L), repeat_goal(N, predsort(compare, L, _)).

bench_list_to_assoc(N) :- mixed_pairs(100000, L), repeat_goal(N, list_to_assoc(L, _)).

bench_put_assoc(N) :- mixed_pairs(10000, L), repeat_goal(N, (empty_assoc(A), put_all(L, A, _))).

put_all([], A, A).
put_all([K-V|T], A0, A) :- put_assoc(K, A0, V, A1), put_all(T, A1, A).

bench_get_assoc(N) :-
    mixed_pairs(10000, L), pairs_keys(L, Ks), list_to_assoc(L, A),
    repeat_goal(N, get_all(Ks, A)).

get_all([], _).
get_all([K|Ks], A) :- get_assoc(K, A, _), get_all(Ks, A).

bench_assoc_to_list(N) :- mixed_pairs(100000, L), list_to_assoc(L, A), repeat_goal(N, assoc_to_list(A, _)).
