% Unifiers, subterms and variables of terms.
%
% defines: unifiable/3 nonground/2 same_term/2 sub_term/2 occurrences_of_term/3 occurrences_of_var/3
% defines: term_singletons/2 numbervars/4 copy_term/3 term_attvars/2

unifiable(Term1, Term2, Unifier) :-
    term_variables(Term1-Term2, Variables),
    copy_term(Variables-Term1-Term2, Copies-Copy1-Copy2),
    Copy1 = Copy2,
    unifiable_(Variables, Copies, Pairs, Copied),
    Copied = Copies,
    reverse(Pairs, Unifier).

% The unifier has each variable whose copy is bound or has become the copy of another variable.

unifiable_(Variables, Copies, Pairs, Copies) :-
    unifiable_free_(Copies, Variables, [], Free),
    unifiable_pairs_(Variables, Copies, Free, Pairs).

unifiable_free_([], [], Free, Free).
unifiable_free_([C|Cs], [V|Vs], Free0, Free) :-
    (   var(C),
        \+ ( member(D-_, Free0), D == C )
    ->  unifiable_free_(Cs, Vs, [C-V|Free0], Free)
    ;   unifiable_free_(Cs, Vs, Free0, Free)
    ).

unifiable_pairs_([], [], _, []).
unifiable_pairs_([V|Vs], [C|Cs], Free, Pairs) :-
    unifiable_back_(Free, C, Value),
    (   Value == V
    ->  Pairs = Pairs1
    ;   Pairs = [V=Value|Pairs1]
    ),
    unifiable_pairs_(Vs, Cs, Free, Pairs1).

unifiable_back_(Free, C, Value) :-
    pairs_keys_values(Free, Keys, Originals),
    copy_term(Keys-C, Originals-Value).

nonground(Term, Variable) :-
    term_variables(Term, [First|_]),
    Variable = First.

same_term(Term1, Term2) :-
    Term1 == Term2.

% Subterms

sub_term(Part, Term) :-
    (   Part = Term
    ;   compound(Term),
        Term =.. [_|Args],
        member(Arg, Args),
        sub_term(Part, Arg)
    ).

occurrences_of_term(Part, Term, Count) :-
    findall(x, (sub_term(Sub, Term), subsumes_term(Part, Sub)), Occurrences),
    length(Occurrences, Count).

occurrences_of_var(Variable, Term, Count) :-
    findall(x, (sub_term(Sub, Term), Sub == Variable), Occurrences),
    length(Occurrences, Count).

% Variables

term_singletons(Term, Singletons) :-
    term_variables(Term, Variables),
    include(once_in_(Term), Variables, Singletons).

once_in_(Term, Variable) :-
    occurrences_of_var(Variable, Term, 1).

numbervars(Term, Start, End, Options) :-
    option(singletons(Singletons), Options, false),
    option(functor_name(Name), Options, '$VAR'),
    (   Singletons == true
    ->  term_singletons(Term, Single),
        maplist(=('$VAR'('_')), Single)
    ;   true
    ),
    term_variables(Term, Variables),
    foldl(number_variable_(Name), Variables, Start, End).

number_variable_(Name, Variable, N, M) :-
    Variable =.. [Name, N],
    M is N + 1.

% No variable has attributes.

copy_term(Term, Copy, []) :-
    copy_term(Term, Copy).

term_attvars(_, []).
