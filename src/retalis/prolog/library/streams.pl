% Texts of streams and files; integer division; predicates of SWI-Prolog that have a fixed outcome here.
%
% defines: phrase_from_file/2 phrase_from_file/3 phrase_from_stream/2 read_string/3 read_string/5
% defines: copy_stream_data/2 copy_stream_data/3 get_single_char/1
% defines: message_to_string/2 divmod/4 is_dict/1 is_dict/2 abort/0

phrase_from_file(Grammar, File) :-
    phrase_from_file(Grammar, File, []).

phrase_from_file(Grammar, File, Options) :-
    read_file_to_codes(File, Codes, Options),
    phrase(Grammar, Codes).

phrase_from_stream(Grammar, Stream) :-
    read_stream_to_codes(Stream, Codes),
    phrase(Grammar, Codes).

% Read a number of characters, or all of them if the number is unbound.

read_string(Stream, Length, String) :-
    (   var(Length)
    ->  read_stream_to_codes(Stream, Codes),
        length(Codes, Length)
    ;   must_be(nonneg, Length),
        string_codes_(Length, Stream, Codes)
    ),
    string_codes(Text, Codes),
    String = Text.

string_codes_(0, _, []) :- !.
string_codes_(Remaining, Stream, Codes) :-
    get_code(Stream, Code),
    (   Code =:= -1
    ->  Codes = []
    ;   Codes = [Code|Codes1],
        Remaining1 is Remaining - 1,
        string_codes_(Remaining1, Stream, Codes1)
    ).

% Read up to a separator and return its code; padding is stripped at both ends.

read_string(Stream, Separators, Padding, Separator, String) :-
    string_codes(Separators, SeparatorCodes),
    get_code(Stream, Code),
    string_up_to_(Code, Stream, SeparatorCodes, Codes, End),
    string_codes(Text, Codes),
    split_string(Text, "", Padding, [Stripped]),
    Separator = End,
    String = Stripped.

string_up_to_(-1, _, _, [], -1) :- !.
string_up_to_(Code, _, SeparatorCodes, [], Code) :-
    memberchk(Code, SeparatorCodes), !.
string_up_to_(Code, Stream, SeparatorCodes, [Code|Codes], End) :-
    get_code(Stream, Next),
    string_up_to_(Next, Stream, SeparatorCodes, Codes, End).

copy_stream_data(In, Out) :-
    read_stream_to_codes(In, Codes),
    format(Out, "~s", [Codes]).

copy_stream_data(In, Out, Length) :-
    must_be(nonneg, Length),
    string_codes_(Length, In, Codes),
    format(Out, "~s", [Codes]).

get_single_char(Code) :-
    get_code(user_input, Code).

message_to_string(Message, String) :-
    (   Message = format(Format, Arguments)
    ->  format(string(String), Format, Arguments)
    ;   format(string(String), "~p", [Message])
    ).

divmod(Dividend, Divisor, Quotient, Remainder) :-
    must_be(integer, Dividend),
    must_be(integer, Divisor),
    Quotient is Dividend div Divisor,
    Remainder is Dividend mod Divisor.

% There are no dicts in this system.

is_dict(_) :-
    fail.

is_dict(_, _) :-
    fail.

abort :-
    throw('$aborted').
