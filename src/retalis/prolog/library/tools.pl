% Time measurement, random choices, and input by line and by file.
%
% defines: time/1 ansi_format/3
% defines: randseq/3 randset/3 random_select/3 random_subseq/3 random_perm2/4 random_numlist/4
% defines: maybe/0 maybe/1 maybe/2
% defines: read_line_to_codes/2 read_line_to_codes/3 read_line_to_string/2 read_stream_to_codes/2
% defines: read_stream_to_codes/3 read_file_to_codes/3 read_file_to_string/3 read_file_to_terms/3 string_lines/2

time(Goal) :-
    must_be(callable, Goal),
    time_now_(Start),
    (   catch(Goal, Error, time_threw_(Start, Error))
    *-> time_report_(Start)
    ;   time_report_(Start),
        fail
    ).

time_now_(at(Inferences, Cpu, Wall)) :-
    statistics(inferences, Inferences),
    statistics(cputime, Cpu),
    statistics(walltime, [Wall|_]).

time_threw_(Start, Error) :-
    time_report_(Start),
    throw(Error).

time_report_(at(Inferences0, Cpu0, Wall0)) :-
    time_now_(at(Inferences1, Cpu1, Wall1)),
    Inferences is Inferences1 - Inferences0,
    Cpu is Cpu1 - Cpu0,
    Wall is (Wall1 - Wall0) / 1000,
    Percent is round(100 * Cpu / max(Wall, 0.001)),
    Speed is round(Inferences / max(Cpu, 0.000001)),
    format(user_error, "% ~D inferences, ~3f CPU in ~3f seconds (~d% CPU, ~d Lips)~n",
           [Inferences, Cpu, Wall, Percent, Speed]).

% Colours are ignored.

ansi_format(_, Format, Arguments) :-
    format(Format, Arguments).

maybe :-
    random_between(0, 1, 0).

maybe(Probability) :-
    must_be(between(0.0, 1.0), Probability),
    random(Fraction),
    Fraction < Probability.

maybe(Count, Total) :-
    random_between(1, Total, Number),
    Number =< Count.

random_select(Item, List, Rest) :-
    (   is_list(List)
    ->  length(List, Places)
    ;   must_be(list, Rest),
        length(Rest, Length),
        Places is Length + 1
    ),
    Places > 0,
    random_between(1, Places, Number),
    nth1(Number, List, Item, Rest).

random_subseq([], [], []).
random_subseq([Item|Items], Chosen, Excluded) :-
    (   maybe
    ->  Chosen = [Item|Chosen1],
        Excluded = Excluded1
    ;   Chosen = Chosen1,
        Excluded = [Item|Excluded1]
    ),
    random_subseq(Items, Chosen1, Excluded1).

random_perm2(A, B, X, Y) :-
    (   maybe
    ->  X = A,
        Y = B
    ;   X = B,
        Y = A
    ).

random_numlist(Probability, Low, High, List) :-
    must_be(between(0.0, 1.0), Probability),
    findall(N, (between(Low, High, N), maybe(Probability)), List).

% Distinct random integers from 1 to High.

randset(Count, High, Set) :-
    randseq(Count, High, Sequence),
    sort(Sequence, Set).

randseq(Count, High, Sequence) :-
    must_be(nonneg, Count),
    (   Count > High
    ->  throw(error(domain_error(not_greater_than(High), Count), _))
    ;   random_distinct_(Count, High, [], Sequence)
    ).

random_distinct_(0, _, Sequence, Sequence) :- !.
random_distinct_(Count, High, Sequence0, Sequence) :-
    random_between(1, High, Number),
    (   memberchk(Number, Sequence0)
    ->  random_distinct_(Count, High, Sequence0, Sequence)
    ;   Remaining is Count - 1,
        random_distinct_(Remaining, High, [Number|Sequence0], Sequence)
    ).

% Read a line without its end; end_of_file at the end of a stream.

read_line_to_codes(Stream, Codes) :-
    get_code(Stream, Code),
    (   Code =:= -1
    ->  Codes = end_of_file
    ;   line_codes_(Code, Stream, Line),
        Codes = Line
    ).

line_codes_(-1, _, []) :- !.
line_codes_(0'\n, _, []) :- !.
line_codes_(0'\r, Stream, Line) :- !,
    get_code(Stream, Code),
    (   Code =:= 0'\n
    ->  Line = []
    ;   Line = [0'\r|Line1],
        line_codes_(Code, Stream, Line1)
    ).
line_codes_(Code, Stream, [Code|Line]) :-
    get_code(Stream, Next),
    line_codes_(Next, Stream, Line).

read_line_to_codes(Stream, Codes, Tail) :-
    get_code(Stream, Code),
    line_whole_(Code, Stream, Codes, Tail).

line_whole_(-1, _, Tail, Tail) :- !.
line_whole_(0'\n, _, [0'\n|Tail], Tail) :- !.
line_whole_(Code, Stream, [Code|Codes], Tail) :-
    get_code(Stream, Next),
    line_whole_(Next, Stream, Codes, Tail).

read_line_to_string(Stream, String) :-
    read_line_to_codes(Stream, Codes),
    (   Codes == end_of_file
    ->  String = end_of_file
    ;   string_codes(Line, Codes),
        String = Line
    ).

read_stream_to_codes(Stream, Codes) :-
    read_stream_to_codes(Stream, Codes, []).

read_stream_to_codes(Stream, Codes, Tail) :-
    get_code(Stream, Code),
    stream_codes_(Code, Stream, Codes, Tail).

stream_codes_(-1, _, Tail, Tail) :- !.
stream_codes_(Code, Stream, [Code|Codes], Tail) :-
    get_code(Stream, Next),
    stream_codes_(Next, Stream, Codes, Tail).

% Read whole files; the options of open/4 are ignored.

read_file_to_codes(File, Codes, _) :-
    setup_call_cleanup(open(File, read, Stream), read_stream_to_codes(Stream, Codes), close(Stream)).

read_file_to_string(File, String, Options) :-
    read_file_to_codes(File, Codes, Options),
    string_codes(Text, Codes),
    String = Text.

read_file_to_terms(File, Terms, _) :-
    setup_call_cleanup(open(File, read, Stream), stream_terms_(Stream, Terms), close(Stream)).

stream_terms_(Stream, Terms) :-
    read(Stream, Term),
    (   Term == end_of_file
    ->  Terms = []
    ;   Terms = [Term|Terms1],
        stream_terms_(Stream, Terms1)
    ).

string_lines(String, Lines) :-
    (   nonvar(String)
    ->  split_string(String, "\n", "", Parts0),
        (   append(Parts, [""], Parts0)
        ->  Lines = Parts
        ;   Lines = Parts0
        )
    ;   must_be(list, Lines),
        maplist(line_ended_, Lines, Ended),
        atomics_to_string_(Ended, String)
    ).

line_ended_(Line, Ended) :-
    string_concat(Line, "\n", Ended).

atomics_to_string_(Parts, String) :-
    atomic_list_concat(Parts, Atom),
    atom_string(Atom, String).
