% The programs of programs.pl as ProbLog's engine can run them: guards instead of cuts and conditions.
% edge/2 is added by bench/others.py.

app([], L, L).
app([H|T], L, [H|R]) :- app(T, L, R).
nrev([], []).
nrev([H|T], R) :- nrev(T, RT), app(RT, [H], R).
case_nrev :- nrev([1,2,3,4,5,6,7,8,9,10,11,12,13,14,15,16,17,18,19,20,21,22,23,24,25,26,27,28,29,30], _).

tak(X, Y, Z, Z) :- X =< Y.
tak(X, Y, Z, A) :-
    X > Y, X1 is X - 1, Y1 is Y - 1, Z1 is Z - 1,
    tak(X1, Y, Z, A1), tak(Y1, Z, X, A2), tak(Z1, X, Y, A3),
    tak(A1, A2, A3, A).
case_tabled :- tak(18,12,6,_).

queens(Ns, Qs) :- place(Ns, [], Qs).
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
case_queens :- findall(Q, queens([1,2,3,4,5,6], Q), Qs).

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
case_zebra :- zebra(_).

primes(N, Ps) :- ints(2, N, Is), sift(Is, Ps).
ints(I, N, [I|T]) :- I =< N, J is I + 1, ints(J, N, T).
ints(I, N, []) :- I > N.
sift([], []).
sift([I|Is], [I|Ps]) :- strike(I, Is, New), sift(New, Ps).
strike(_, [], []).
strike(P, [I|Is], Nis) :- 0 is I mod P, strike(P, Is, Nis).
strike(P, [I|Is], [I|Nis]) :- R is I mod P, R > 0, strike(P, Is, Nis).
case_primes :- primes(98,_).

d(U + V, X, DU + DV) :- d(U, X, DU), d(V, X, DV).
d(U - V, X, DU - DV) :- d(U, X, DU), d(V, X, DV).
d(U * V, X, DU * V + U * DV) :- d(U, X, DU), d(V, X, DV).
d(U / V, X, (DU * V - U * DV) / (V ** 2)) :- d(U, X, DU), d(V, X, DV).
d(U ** N, X, DU * N * U ** N1) :- integer(N), N1 is N - 1, d(U, X, DU).
d(exp(U), X, exp(U) * DU) :- d(U, X, DU).
d(log(U), X, DU / U) :- d(U, X, DU).
d(X, X, 1) :- atom(X).
case_deriv :- d(((((x * x) * x) * x) * x) / (log(log(x)) + exp(x ** 3)), x, _).

all_pairs(S) :-
    findall(X-Y, square(X,Y), Ps),
    findall(Y, mem(Q-Y, Ps), Ys),
    total(Ys, 0, S).
square(X,Y) :- between(1, 200, X), Y is X * X.
total([], S, S).
total([X|Xs], S0, S) :- S1 is S0+X, total(Xs, S1, S).
case_findall :- all_pairs(2686700).

join(Z) :- edge(3, X), edge(X, Y), edge(Y, Z).
case_join :- findall(Z, join(Z), Zs).
split([]).
split([T|Ts]) :-
    T = stamped(header(_, [Sec, NSec], Parent), Child, transform(vector3(X, Y, Z), quaternion(QX, QY, QZ, QW))),
    event(tf(Parent, Child, [X, Y, Z], [QX, QY, QZ, QW]), Sec, NSec),
    split(Ts).
event(tf(_, _, _, _), S, N) :- S >= 0, N >= 0.
case_split :- split([stamped(header(1, [10, 20], a), b, transform(vector3(1.0, 2.0, 3.0), quaternion(0.0, 0.0, 0.0, 1.0)))]).
count(N, N).
count(I, N) :- I < N, J is I + 1, count(J, N).
case_count :- count(0, 1000).   % a thousand turns

odd(1). odd(3). odd(5). odd(7). odd(9).
even(0). even(2). even(4). even(6). even(8).
lefteven(2). lefteven(4). lefteven(6). lefteven(8).
zero([]).
zero([0|L]) :- zero(L).
mult(AL, D, BL) :- mult(AL, D, 0, BL).
mult([A|As], D, Carry, [B|Bs]) :- X is A * D + Carry, B is X mod 10, C is X // 10, mult(As, D, C, Bs).
mult([], _, Carry, [C, Cend]) :- C is Carry mod 10, Cend is Carry // 10.
mult2(As, [E, D], Ps) :- mult(As, E, P1), mult(As, D, P2), sum2(P1, [0|P2], Ps).
sum2(As, Bs, Cs) :- sum2(As, Bs, 0, Cs).
sum2([A|As], [B|Bs], Carry, [C|Cs]) :- X is A + B + Carry, C is X mod 10, N is X // 10, sum2(As, Bs, N, Cs).
sum2([], Bs, 0, Bs).
sum2([A|As], [], 0, [A|As]).
sum2([], [B|Bs], Carry, [C|Cs]) :- Carry > 0, X is B + Carry, N is X // 10, C is X mod 10, sum2([], Bs, N, Cs).
sum2([A|As], [], Carry, [C|Cs]) :- Carry > 0, X is A + Carry, N is X // 10, C is X mod 10, sum2([], As, N, Cs).
sum2([], [], Carry, [Carry]) :- Carry > 0.
case_crypt :- 
    odd(A), even(B), even(C), even(E),
    mult([C, B, A], E, [I, H, G, F | X]), lefteven(F), odd(G), even(H), even(I), zero(X), lefteven(D),
    mult([C, B, A], D, [L, K, J | Y]), lefteven(J), odd(K), even(L), zero(Y),
    mult2([C, B, A], [E, D], [P, O, N, M | Z]), odd(M), odd(N), even(O), even(P), zero(Z).
