% Grammars over lists of character codes: white space, digits, numbers, strings; sequences.
%
% defines: white/2 whites/2 blank/2 blanks/2 blanks_to_nl/2 nonblank/3 nonblanks/3 string/3 string_without/4
% defines: alpha_to_lower/3 digit/3 digits/3 integer/3 float/3 number/3 xdigit/3 xdigits/3 xinteger/3
% defines: eol/2 eos/2 remainder/3 prolog_var_name/3 csym/3 csyms/3 prolog_symbol/3 atom/3
% defines: sequence/4 sequence/5 sequence/7 optional/4 foreach/4 foreach/5

white -->
    [C],
    { nonvar(C), code_type(C, white) }.

whites -->
    white, !,
    whites.
whites -->
    [].

blank -->
    [C],
    { nonvar(C), code_type(C, space) }.

blanks -->
    blank, !,
    blanks.
blanks -->
    [].

blanks_to_nl -->
    [C],
    { nonvar(C), C \== 10, code_type(C, space) }, !,
    blanks_to_nl.
blanks_to_nl -->
    "\n", !.
blanks_to_nl, [] -->
    eos.

nonblank(C) -->
    [C],
    { code_type(C, graph) }.

nonblanks([C|Cs]) -->
    [C],
    { code_type(C, graph) }, !,
    nonblanks(Cs).
nonblanks([]) -->
    [].

% Strings in order of length.

string([]) -->
    [].
string([C|Cs]) -->
    [C],
    string(Cs).

string_without(End, Codes) -->
    { basics_codes_(End, EndCodes) },
    basics_without_(EndCodes, Codes).

basics_codes_(End, Codes) :-
    (   string(End)
    ->  string_codes(End, Codes)
    ;   Codes = End
    ).

basics_without_(EndCodes, [C|Cs]) -->
    [C],
    { \+ memberchk(C, EndCodes) }, !,
    basics_without_(EndCodes, Cs).
basics_without_(_, []) -->
    [].

alpha_to_lower(Lower) -->
    [C],
    {   nonvar(C)
    ->  code_type(C, alpha),
        code_type(C, to_upper(Upper)),
        Lower = Upper
    ;   Lower = C
    }.

% Numbers: parsed from the codes, or written to them if the number is bound.

digit(C) -->
    [C],
    { code_type(C, digit) }.

digits([H|T]) -->
    digit(H), !,
    digits(T).
digits([]) -->
    [].

basics_digits_([H|T]) -->
    digit(H),
    digits(T).

integer(I, Head, Tail) :-
    nonvar(I), !,
    must_be(integer, I),
    number_codes(I, Codes),
    append(Codes, Tail, Head).
integer(I) -->
    basics_int_(Codes),
    { number_codes(I, Codes) }.

basics_int_([0'-|Codes]) -->
    "-", !,
    basics_digits_(Codes).
basics_int_(Codes) -->
    (   "+"
    ->  []
    ;   []
    ),
    basics_digits_(Codes).

float(F, Head, Tail) :-
    nonvar(F), !,
    Number is float(F),
    number_codes(Number, Codes),
    append(Codes, Tail, Head).
float(F) -->
    number(Number),
    { F is float(Number) }.

number(N, Head, Tail) :-
    nonvar(N), !,
    must_be(number, N),
    number_codes(N, Codes),
    append(Codes, Tail, Head).
number(N) -->
    basics_int_(Int),
    (   basics_fraction_(Fraction)
    ->  []
    ;   { Fraction = [] }
    ),
    (   basics_exponent_(Exponent)
    ->  []
    ;   { Exponent = [] }
    ),
    { basics_number_(Int, Fraction, Exponent, N) }.

basics_fraction_([0'.|Digits]) -->
    ".",
    basics_digits_(Digits).

basics_exponent_([0'e|Codes]) -->
    ( "e" ; "E" ),
    basics_int_(Codes).

basics_number_(Int, [], [], N) :- !,
    number_codes(N, Int).
basics_number_(Int, [], Exponent, N) :- !,
    append([Int, [0'., 0'0], Exponent], Codes),
    number_codes(N, Codes).
basics_number_(Int, Fraction, Exponent, N) :-
    append([Int, Fraction, Exponent], Codes),
    number_codes(N, Codes).

xdigit(Weight) -->
    [C],
    { nonvar(C), code_type(C, xdigit(Weight)) }.

xdigits([H|T]) -->
    xdigit(H), !,
    xdigits(T).
xdigits([]) -->
    [].

xinteger(Value, Head, Tail) :-
    nonvar(Value), !,
    must_be(integer, Value),
    format(codes(Codes), "~16r", [Value]),
    append(Codes, Tail, Head).
xinteger(Value) -->
    xdigit(First),
    xdigits(Weights),
    { foldl(basics_hex_, Weights, First, Value) }.

basics_hex_(Weight, Value0, Value) :-
    Value is Value0 * 16 + Weight.

% Ends

eos([], []).

eol -->
    "\n", !.
eol -->
    "\r\n", !.
eol -->
    eos.

remainder(Rest, Rest, []).

% Tokens

prolog_var_name(Name) -->
    [C],
    { nonvar(C), code_type(C, prolog_var_start) }, !,
    csyms(Codes),
    { atom_codes(Name, [C|Codes]) }.

csyms([H|T]) -->
    csym(H), !,
    csyms(T).
csyms([]) -->
    [].

csym(C) -->
    [C],
    { nonvar(C), code_type(C, csym) }.

prolog_symbol(Symbol) -->
    [C],
    { nonvar(C), code_type(C, prolog_symbol) },
    basics_symbols_(Codes),
    { atom_codes(Symbol, [C|Codes]) }.

basics_symbols_([H|T]) -->
    [H],
    { nonvar(H), code_type(H, prolog_symbol) }, !,
    basics_symbols_(T).
basics_symbols_([]) -->
    [].

atom(Atom, Head, Tail) :-
    must_be(nonvar, Atom),
    format(codes(Codes), "~w", [Atom]),
    append(Codes, Tail, Head).

% Sequences of grammar bodies

sequence(Item, List) -->
    basics_each_(List, Item).

basics_each_([H|T], Item) -->
    call(Item, H),
    basics_each_(T, Item).
basics_each_([], _) -->
    [].

sequence(Item, Separator, List) -->
    basics_first_(List, Item, Separator).

basics_first_([H|T], Item, Separator) -->
    call(Item, H),
    (   Separator
    ->  !,
        basics_more_(T, Item, Separator)
    ;   { T = [] }
    ).
basics_first_([], _, _) -->
    [].

basics_more_([H|T], Item, Separator) -->
    call(Item, H),
    (   Separator
    ->  !,
        basics_more_(T, Item, Separator)
    ;   { T = [] }
    ).

sequence(Start, Item, Separator, End, List) -->
    Start,
    basics_first_(List, Item, Separator),
    End, !.

optional(Match, _Default) -->
    Match, !.
optional(_, Default) -->
    Default.

foreach(Generator, Element) -->
    foreach(Generator, Element, []).

foreach(Generator, Element, Separator, Head, Tail) :-
    term_variables(Generator, Generated),
    findall(Generated-Element, Generator, Solutions),
    basics_foreach_(Solutions, Generated, Separator, Head, Tail).

basics_foreach_([], _, _) -->
    [].
basics_foreach_([_-Element|Solutions], Generated, Separator) -->
    Element,
    (   { Solutions == [] }
    ->  []
    ;   Separator,
        basics_foreach_(Solutions, Generated, Separator)
    ).
