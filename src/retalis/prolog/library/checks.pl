% Assertions of a program.
%
% defines: assertion/1

assertion(G) :-
    \+ \+ catch(G, E, assertion_failed_(E, G)), !.
assertion(G) :-
    assertion_failed_(fail, G).

% A resource error does not tell whether the goal holds, so it is thrown again.
assertion_failed_(E, _) :-
    nonvar(E),
    E = error(resource_error(_), _), !,
    throw(E).
assertion_failed_(Reason, G) :-
    throw(error(assertion_error(Reason, user:G), _)).
