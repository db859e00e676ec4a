% Finite domains: who takes which of the hours, nobody two, and the late ones not first.

:- module(shifts, [plan/2, earliest/3]).
:- use_module(library(clpfd)).

plan(Wishes, Hours) :-
    length(Wishes, Number),
    length(Hours, Number),
    Hours ins 8..12,
    all_different(Hours),
    maplist(wish, Wishes, Hours),
    sum(Hours, #=<, 40),
    labeling([ff], Hours).

wish(at(Hour), Hour).
wish(after(Early), Hour) :- Hour #> Early.
wish(any, _).

earliest(From, Step, Time) :-
    Time #>= From,
    Time #=< From + Step,
    Time mod Step #= 0,
    once(labeling([min(Time)], [Time])).
