% Terms and their parts; clauses' bodies as lists; variables that were numbered.
%
% defines: subsumes/2 subsumes_chk/2 variant/2 term_size/2 mapargs/3 mapsubterms/3 foldsubterms/4 foldsubterms/5
% defines: same_functor/2 same_functor/3 same_functor/4 unifiable/3 nonground/2
% defines: sub_term/2 sub_var/2 contains_term/2 contains_var/2 free_of_term/2 free_of_var/2
% defines: occurrences_of_term/3 occurrences_of_var/3 term_singletons/2 numbervars/4 copy_term/3 term_attvars/2
% defines: varnumbers/2 varnumbers/3 max_var_number/3
% defines: comma_list/2 semicolon_list/2 mkconj/3 mkdisj/3 pi_head/2 head_name_arity/3 most_general_goal/2
% defines: extend_goal/3 is_control_goal/1 is_lambda/1 concat_atom/2 concat_atom/3 concat/3
% defines: same_term/2 is_callable/1 is_most_general_term/1

subsumes(General, Specific) :-
    subsumes_term(General, Specific),
    General = Specific.

subsumes_chk(General, Specific) :-
    subsumes_term(General, Specific).

variant(One, Other) :-
    One =@= Other.

unifiable(One, Other, Unifier) :-
    term_variables(One-Other, Variables),
    copy_term(Variables-One-Other, Copies-One1-Other1),
    One1 = Other1,
    unifiable_(Variables, Copies, Pairs, Seen),
    Seen = Copies,
    reverse(Pairs, Unifier).

% A variable whose copy is bound is in the unifier; one whose copy has become that of another variable, too.

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
    term_variables(Term, [Found|_]),
    Variable = Found.

term_size(Term, Size) :-
    (   compound(Term)
    ->  Term =.. [_|Args],
        maplist(term_size, Args, Sizes),
        sum_list(Sizes, Sum),
        length(Args, Arity),
        Size is Sum + Arity + 1
    ;   Size = 0
    ).

mapargs(Goal, Term1, Term2) :-
    (   compound(Term1)
    ->  Term1 =.. [Name|Args1],
        maplist(Goal, Args1, Args2),
        Term2 =.. [Name|Args2]
    ;   Term2 = Term1
    ).

mapsubterms(Goal, Term1, Term2) :-
    (   call(Goal, Term1, Term)
    ->  Term2 = Term
    ;   mapargs(mapsubterms(Goal), Term1, Term2)
    ).

foldsubterms(Goal, Term, State0, State) :-
    (   call(Goal, Term, State0, State1)
    ->  State = State1
    ;   compound(Term)
    ->  Term =.. [_|Args],
        foldl(foldsubterms(Goal), Args, State0, State)
    ;   State = State0
    ).

foldsubterms(Goal, Term1, Term2, State0, State) :-
    (   call(Goal, Term1, Term, State0, State1)
    ->  Term2 = Term,
        State = State1
    ;   compound(Term1)
    ->  Term1 =.. [Name|Args1],
        foldl(foldsubterms(Goal), Args1, Args2, State0, State),
        Term2 =.. [Name|Args2]
    ;   Term2 = Term1,
        State = State0
    ).

same_functor(One, Other) :-
    same_functor(One, Other, _, _).

same_functor(One, Other, Arity) :-
    same_functor(One, Other, _, Arity).

same_functor(One, Other, Name, Arity) :-
    (   nonvar(One)
    ->  functor(One, Name, Arity),
        functor(Other, Name, Arity)
    ;   functor(Other, Name, Arity),
        functor(One, Name, Arity)
    ).

same_term(One, Other) :-
    One == Other.

is_callable(Term) :-
    callable(Term).

is_most_general_term(Term) :-
    (   is_list(Term)
    ->  Args = Term
    ;   callable(Term),
        Term =.. [_|Args]
    ),
    maplist(var, Args),
    term_variables(Args, Variables),
    length(Args, Count),
    length(Variables, Count).

% Parts

sub_term(Part, Term) :-
    (   Part = Term
    ;   compound(Term),
        Term =.. [_|Args],
        member(Arg, Args),
        sub_term(Part, Arg)
    ).

sub_var(Variable, Term) :-
    sub_same_(Term, Variable).

sub_same_(Term, Part) :-
    (   Term == Part
    ->  true
    ;   compound(Term),
        Term =.. [_|Args],
        member(Arg, Args),
        sub_same_(Arg, Part)
    ->  true
    ).

contains_term(Part, Term) :-
    \+ free_of_term(Part, Term).

contains_var(Variable, Term) :-
    sub_same_(Term, Variable).

free_of_term(Part, Term) :-
    \+ ( sub_term(Sub, Term), Sub = Part ).

free_of_var(Variable, Term) :-
    \+ sub_same_(Term, Variable).

occurrences_of_term(Part, Term, Count) :-
    findall(x, (sub_term(Sub, Term), subsumes_term(Part, Sub)), Found),
    length(Found, Count).

occurrences_of_var(Variable, Term, Count) :-
    findall(x, (sub_term(Sub, Term), Sub == Variable), Found),
    length(Found, Count).

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

varnumbers(Term, Variables) :-
    varnumbers(Term, 0, Variables).

varnumbers(Term, Start, Copy) :-
    End0 is Start - 1,
    max_var_number(Term, End0, End),
    Count is End - Start + 1,
    length(Variables, Count),
    copy_term(Term, Copied),
    varnumbers_(Copied, Start, Variables, Copy).

varnumbers_(Term, Start, Variables, Copy) :-
    (   nonvar(Term),
        Term = '$VAR'(N),
        integer(N),
        N >= Start
    ->  At is N - Start,
        nth0(At, Variables, Copy)
    ;   compound(Term)
    ->  Term =.. [Name|Args],
        varnumbers_args_(Args, Start, Variables, Copies),
        Copy =.. [Name|Copies]
    ;   Copy = Term
    ).

varnumbers_args_([], _, _, []).
varnumbers_args_([Arg|Args], Start, Variables, [Copy|Copies]) :-
    varnumbers_(Arg, Start, Variables, Copy),
    varnumbers_args_(Args, Start, Variables, Copies).

max_var_number(Term, Start, Max) :-
    findall(N, (sub_term(Sub, Term), nonvar(Sub), Sub = '$VAR'(N), integer(N)), Ns),
    max_list([Start|Ns], Max).

% Bodies

comma_list(Conjunction, List) :-
    body_list_(',', Conjunction, List).

semicolon_list(Disjunction, List) :-
    body_list_(;, Disjunction, List).

body_list_(Name, Body, List) :-
    phrase(body_items_(Body, Name), List).

% An unknown body takes all items of a known list, and ever more of an unknown one.

body_items_(Body, Name, List, Rest) :-
    (   var(Body)
    ->  List = [Item|Items],
        body_of_(Items, Item, Name, Body, Rest)
    ;   Body =.. [Name, Left, Right]
    ->  body_items_(Left, Name, List, List1),
        body_items_(Right, Name, List1, Rest)
    ;   List = [Body|Rest]
    ).

body_of_(Items, Item, Name, Body, Rest) :-
    (   var(Items)
    ->  (   Body = Item,
            Rest = Items
        ;   Body =.. [Name, Item, Body1],
            body_items_(Body1, Name, Items, Rest)
        )
    ;   Items = [_|_]
    ->  body_items_(Body1, Name, Items, Rest),
        Body =.. [Name, Item, Body1]
    ;   Body = Item,
        Rest = Items
    ).

mkconj(One, Other, Conjunction) :-
    (   One == true
    ->  Conjunction = Other
    ;   Other == true
    ->  Conjunction = One
    ;   Conjunction = (One, Other)
    ).

mkdisj(One, Other, Disjunction) :-
    (   One == false
    ->  Disjunction = Other
    ;   Other == false
    ->  Disjunction = One
    ;   Disjunction = (One ; Other)
    ).

pi_head(Indicator, Head) :-
    (   nonvar(Head)
    ->  indicator_of_(Head, Indicator)
    ;   head_of_(Indicator, Head)
    ).

indicator_of_(Head, Indicator) :-
    (   Head = Module:Head1
    ->  Indicator = Module:Indicator1,
        indicator_of_(Head1, Indicator1)
    ;   Indicator = Name/Arity,
        functor(Head, Name, Arity)
    ).

head_of_(Indicator, Head) :-
    must_be(nonvar, Indicator),
    (   Indicator = Module:Indicator1
    ->  Head = Module:Head1,
        head_of_(Indicator1, Head1)
    ;   Indicator = Name/Arity
    ->  functor(Head, Name, Arity)
    ;   Indicator = Name//Arity0,
        Arity is Arity0 + 2,
        functor(Head, Name, Arity)
    ).

head_name_arity(Head, Name, Arity) :-
    functor(Head, Name, Arity).

most_general_goal(Goal, General) :-
    (   nonvar(Goal), Goal = Module:Goal1
    ->  General = Module:General1,
        most_general_goal(Goal1, General1)
    ;   functor(Goal, Name, Arity),
        functor(General, Name, Arity)
    ).

extend_goal(Goal, Extra, Extended) :-
    (   Extra == []
    ->  Extended = Goal
    ;   Goal =.. List0,
        append(List0, Extra, List),
        Extended =.. List
    ).

is_control_goal(Goal) :-
    nonvar(Goal),
    memberchk(Goal, [(_, _), (_ ; _), (_ -> _), (_ *-> _), \+ _]).

is_lambda(Term) :-
    nonvar(Term),
    (   Term = (_ >> _)
    ;   Term = _ / Lambda,
        nonvar(Lambda),
        Lambda = (_ >> _)
    ), !.

% Atoms

concat_atom(List, Atom) :-
    atomic_list_concat(List, Atom).

concat_atom(List, Separator, Atom) :-
    atomic_list_concat(List, Separator, Atom).

concat(One, Other, Atom) :-
    atomic_list_concat([One, Other], Atom).
