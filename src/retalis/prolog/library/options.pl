% Options: lists of Name(Value) and Name = Value.
%
% defines: option/2 option/3 select_option/3 select_option/4 merge_options/3 meta_options/3

option(Option, Options) :-
    option_named_(Options, Option, Selected), !,
    Selected = Option.

option(Option, Options, Default) :-
    (   option_named_(Options, Option, Selected)
    ->  Selected = Option
    ;   arg(1, Option, Default)
    ).

% The first Name(Value) of the name that is asked for, else the first Name = Value.

option_named_(Options, Option, Selected) :-
    option_selected_(Options, Option, Selected, _).

select_option(Option, Options, Rest) :-
    option_selected_(Options, Option, Selected, Rest1),
    Selected = Option,
    Rest = Rest1.

select_option(Option, Options, Rest, Default) :-
    (   option_selected_(Options, Option, Selected, Rest1)
    ->  Selected = Option,
        Rest = Rest1
    ;   arg(1, Option, Default),
        Rest = Options
    ).

option_selected_(Options, Option, Selected, Rest1) :-
    must_be(list, Options),
    must_be(nonvar, Option),
    functor(Option, Name, Arity),
    (   functor(Selected, Name, Arity),
        option_taken_(Options, Selected, Rest1)
    ->  true
    ;   Arity =:= 1,
        option_taken_(Options, Name=Value, Rest1)
    ->  Selected =.. [Name, Value]
    ).

option_taken_(Options, Option, Rest1) :-
    select(Item, Options, Rest1),
    nonvar(Item),
    Item = Option, !.

% Both sorted by name; of two options of one name the new one counts.

merge_options(New, Old, Merged) :-
    option_pairs_(New, NewPairs),
    option_pairs_(Old, OldPairs),
    option_merge_(NewPairs, OldPairs, Pairs),
    pairs_values(Pairs, Merged).

option_pairs_(Options, Pairs) :-
    must_be(list, Options),
    maplist(option_pair_, Options, Keyed),
    sort(1, @<, Keyed, Pairs).

option_pair_(Item, Key-Option) :-
    must_be(nonvar, Item),
    (   Item = (Name=Value)
    ->  Option =.. [Name, Value]
    ;   Option = Item
    ),
    functor(Option, Name1, Arity),
    Key = Name1/Arity.

option_merge_([], Old, Old) :- !.
option_merge_(New, [], New) :- !.
option_merge_([K1-V1|New], [K2-V2|Old], Merged) :-
    compare(Order, K1, K2),
    option_merge_(Order, K1-V1, New, K2-V2, Old, Merged).

option_merge_(<, N, New, O, Old, [N|Merged]) :-
    option_merge_(New, [O|Old], Merged).
option_merge_(=, N, New, _, Old, [N|Merged]) :-
    option_merge_(New, Old, Merged).
option_merge_(>, N, New, O, Old, [O|Merged]) :-
    option_merge_([N|New], Old, Merged).

% Goals in options are not qualified with modules.

meta_options(_, Options, Options).
