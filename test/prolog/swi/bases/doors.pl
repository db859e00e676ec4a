% Rules for constraints: what is known of ways between rooms, the shortest ones kept.

:- module(doors, [ways/3, shut/2]).
:- use_module(library(chr)).

:- chr_constraint door(+, +, +int), way(+, +, +int).

longer @ way(A, B, M) \ way(A, B, N) <=> M =< N | true.
first  @ door(A, B, N) ==> way(A, B, N).
then   @ way(A, B, M), door(B, C, N) ==> A \== C | K is M + N, way(A, C, K).

ways(From, Doors, Found) :-
    maplist([door(A, B, N)]>>door(A, B, N), Doors),
    findall(To-Far, find_chr_constraint(way(From, To, Far)), Unsorted),
    sort(Unsorted, Found).

shut(A, B) :-
    \+ find_chr_constraint(door(A, B, _)).
