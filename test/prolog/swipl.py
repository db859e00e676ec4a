"""Queries to SWI-Prolog: each goal runs in its own process, so that goals do not affect each other."""

import subprocess
import tempfile
from pathlib import Path
from typing import List

BATCH_SIZE = 500
BATCH_TIMEOUT_SECONDS = 120

PROGRAM = r"""
:- use_module(library(unix)).
:- use_module(library(lists)).
:- use_module(library(apply)).
:- use_module(library(assoc)).
:- use_module(library(pairs)).
:- use_module(library(ordsets)).
:- use_module(library(aggregate)).
:- use_module(library(solution_sequences)).
:- use_module(library(strings)).
:- use_module(library(yall)).
:- use_module(library(error)).
:- use_module(library(debug)).
:- use_module(library(listing)).
:- use_module(library(backcomp)).
:- use_module(library(date)).
:- use_module(library(gensym)).
:- use_module(library(terms)).
:- use_module(library(time)).
:- style_check(-singleton).
:- set_prolog_flag(stack_limit, 200_000_000).
:- set_prolog_flag(gc_thread, false).

'$shown'(T) :-
    (   acyclic_term(T)
    ->  copy_term(T, C, _), numbervars(C, 0, _),
        write_term(C, [quoted(true), ignore_ops(true), numbervars(true)])
    ;   write(cyclic)
    ).

'$one'(Text) :-
    catch(term_to_atom(G, Text), _, fail), !,
    with_output_to(string(Out),
                   catch('$solutions'(G, R), E, R = raised(E))),
    '$result'(R),
    (   Out == "" -> true ; write(' printed '), writeq(Out) ).
'$one'(_) :-
    write(unread).

'$solutions'(G, R) :-
    call_with_time_limit(1, call_with_inference_limit(findall(G, limit(5, G), L), 2_000_000, Within)),
    (   Within == inference_limit_exceeded
    ->  R = limit
    ;   R = solutions(L)
    ).

'$result'(limit) :-
    write(limit).
'$result'(solutions(L)) :-
    write('['), '$items'(L), write(']').
'$result'(raised(E)) :-
    (   subsumes_term(error(resource_error(_), _), E) -> write(limit)
    ;   E == time_limit_exceeded -> write(limit)
    ;   subsumes_term(error(_, _), E) -> arg(1, E, F), write('error('), '$shown'(F), write(')')
    ;   write('ball('), '$shown'(E), write(')')
    ).

'$items'([]).
'$items'([X]) :- !, '$shown'(X).
'$items'([X|Xs]) :- '$shown'(X), write(','), '$items'(Xs).

'$main' :-
    read_term(user_input, T, []),
    (   T == end_of_file
    ->  true
    ;   flush_output,
        fork(Pid),
        (   Pid == child
        ->  alarm(8, exec(false), _, []),
            '$one'(T), nl, write('#'), nl, flush_output, exec(true)
        ;   wait(Pid, Status),
            (   Status == exited(0) -> true ; write('lost'), nl, write('#'), nl )
        ),
        '$main'
    ).
"""


def quoted(text: str) -> str:
    """Return a text as a quoted atom for SWI-Prolog."""
    return "'" + text.replace("\\", "\\\\").replace("'", "\\'") + "'"


def ask(texts: List[str], program: str = PROGRAM) -> List[str]:
    """Return SWI-Prolog's answer to each text, or ``lost`` if the process crashed or timed out."""
    replies: List[str] = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "goals.pl"
        path.write_text(program, encoding="utf-8")
        while len(replies) < len(texts):
            batch = texts[len(replies) : len(replies) + BATCH_SIZE]
            batch_replies = _batch_answers(path, batch)[: len(batch)]
            replies += batch_replies if len(batch_replies) == len(batch) else [*batch_replies, "lost"]
    return replies


def _batch_answers(path: Path, batch: List[str]) -> List[str]:
    """Return the answers before the process ended or timed out."""
    command = ["swipl", "-q", "-l", str(path), "-g", "'$main'", "-t", "halt"]
    queries = "".join(quoted(text) + ".\n" for text in batch)
    try:
        process = subprocess.run(
            command,
            input=queries.encode(),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            timeout=BATCH_TIMEOUT_SECONDS,
            check=False,
            env={"LANG": "C.UTF-8", "PATH": "/usr/bin:/bin:/usr/local/bin"},
        )
        text = process.stdout
    except subprocess.TimeoutExpired as error:
        text = error.stdout or b""
    parts = text.decode("utf-8", "replace").split("\n#\n")
    return parts[:-1]
