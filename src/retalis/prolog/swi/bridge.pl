% Predicates that retalis loads into SWI-Prolog at its start: loading of files, limits, and callbacks.

:- module(retalis_bridge,
          [ retalis/1, prev/5, prev_binary/5, next/6, next_binary/6, next_inf/5, access_mem/3 ]).

:- meta_predicate limited(0, +).

% Goals of the program and its memories. A callback computes all solutions at once.

retalis(Goal) :-
    '$retalis_ask'(asked(Goal, Solutions)),
    '$member'(Goal, Solutions).

'$member'(Goal, [Goal]) :- !.
'$member'(Goal, [Goal|_]).
'$member'(Goal, [_|Solutions]) :-
    '$member'(Goal, Solutions).

prev(Id, Record, Start, End, At) :-
    retalis(prev(Id, Record, Start, End, At)).
prev_binary(Id, Record, Start, End, At) :-
    retalis(prev_binary(Id, Record, Start, End, At)).
next(Id, Record, Start, End, Low, High) :-
    retalis(next(Id, Record, Start, End, Low, High)).
next_binary(Id, Record, Start, End, Low, High) :-
    retalis(next_binary(Id, Record, Start, End, Low, High)).
next_inf(Id, Record, Start, End, At) :-
    retalis(next_inf(Id, Record, Start, End, At)).
access_mem(Id, Record, Interval) :-
    retalis(access_mem(Id, Record, Interval)).

% Limits

limited(Goal, Most) :-
    call_with_inference_limit(Goal, Most, Result),
    (   Result == inference_limit_exceeded
    ->  throw('$retalis_limit'(inferences))
    ;   true
    ).

interrupt(Engine, 0) :-
    thread_signal(Engine, throw('$retalis_limit'(interrupted))).
interrupt(Engine, 1) :-
    thread_signal(Engine, abort).

inferences(Engine, Count) :-
    thread_statistics(Engine, inferences, Count).

limit_stacks(Bytes) :-
    catch(( current_prolog_flag(stack_limit, Now),
            Least is min(Now, Bytes),
            set_prolog_flag(stack_limit, Least)
          ), error(_, _), true).

% An engine that a goal creates replaces the signal stack of the thread, see libswipl.py.

make_engine(Make) :-
    with_mutex(retalis_signal_stack,
               setup_call_cleanup(\+ '$retalis_note_stack', Make, \+ '$retalis_put_stack_back')).

:- catch(( use_module(library(prolog_wrap), []),
           prolog_wrap:wrap_predicate(system:'$engine_create'(_, _, _), retalis, Make,
                                      retalis_bridge:make_engine(Make)) ),
         error(_, _), true).  % versions without that library do not replace the stack

% Loading

:- thread_local problem/2, loading/0.

load(Spec, Module, Exports, Problems) :-
    give_up(Spec),
    setup_call_cleanup(
        assertz(loading),
        ( load_files(user:Spec, [if(changed), imports([])]),
          findall(Kind-Text, problem(Kind, Text), Problems) ),
        ( retractall(loading), retractall(problem(_, _)) )),
    absolute_file_name(Spec, File, [file_type(prolog), access(read)]),
    (   module_property(Module, file(File))
    ->  module_property(Module, exports(Exports))
    ;   Module = user,
        Exports = []
    ).

% In version 9.0.4 a tabled predicate is not tabled any more after its file has been loaded again, so it is unloaded first.

give_up(Spec) :-
    absolute_file_name(Spec, File, [file_type(prolog), access(read), file_errors(fail)]),
    source_file_property(File, modified(Then)),
    time_file(File, Now),
    Now > Then,
    !,
    unload_file(File).
give_up(_).

defined(Module, Name, Arity) :-
    functor(Head, Name, Arity),
    predicate_property(Module:Head, defined),
    !.

:- multifile user:message_hook/3.
:- dynamic user:message_hook/3.

user:message_hook(_, Kind, Lines) :-
    retalis_bridge:loading,
    (   Kind == error
    ;   Kind == warning
    ),
    retalis_bridge:note(Kind, Lines).

note(Kind, Lines) :-
    (   source_location(File, Line)
    ->  format(string(Where), '~w:~w: ', [File, Line])
    ;   Where = ""
    ),
    with_output_to(string(What), print_message_lines(current_output, '', Lines)),
    split_string(What, "", "\n ", [Short]),
    string_concat(Where, Short, Text),
    assertz(problem(Kind, Text)).

% A program may not end the process that it runs in.

:- at_halt(cancel_halt('retalis goes on: halt/0 ends no engine')).

