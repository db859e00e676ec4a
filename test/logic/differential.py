"""Goals over the built-ins, made at random from a seed, and their answers here and in SWI-Prolog.

Usage: python differential.py COUNT [SEED]      compare with swipl, print what differs
       python differential.py --record COUNT    write goals and swipl's answers to goals.tsv
"""

import random
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Dict, List

from retalis.errors import SyntaxFault
from retalis.logic import Limits, Logic, PrologError
from retalis.syntax import read_term, write_term
from retalis.terms import copy, functor, variables

RECORD = Path(__file__).with_name("goals.tsv")
MOST = 5

_VALUES = r"""
X Y _ a b [] 1 0 -1 2 3 2.5 -0.5 1.0 "str" "" f(a) f(X,b) f(X,Y,X) [a,b] [b,a,b] [1,2|T] [X,Y] foo
abc '' [a|b] 1+2 3-1 [c-1,a-2,b-3,a-1] [3,1,2,1] ["a",b,1] 100 12345678901234567890 'X' - {} {a}
f(_) [_|_] [a,b,c] [[a],[b,c]] "abc" ab bc c 5 "12" '12' '3.5' x y Z [97,98] [a,'1'] < = > 'é'
g(f(a),Y) 255 0.1 1e10 -7 [1.0,1] 7 inf nan foo/1 (a,b) (a:-b) [x=1,y=2] "a,b,c" "," 0'a
member(Q,[1,2]) true fail (X=1;X=2) call(a) write "a-b" [h,e] 'ABC' "AbC" 64 65 -64 2.0 1.5 16 36 10
8 [0,1] [[1,a],[2,b]] p(1,2,3) p(3,2,1) t k-v [k-v,k2-v2]
"""
VALUES = _VALUES.split()
VALUES += ["'hello world'", "'a b'", "' 7'", '"x y"', "' '", '"  pad  "']

_PREDICATES = r"""
=/2 \=/2 ==/2 \==/2 @</2 @>/2 @=</2 @>=/2 compare/3 var/1 nonvar/1 atom/1 number/1 integer/1 float/1
atomic/1 compound/1 callable/1 is_list/1 string/1 ground/1 functor/3 functor/3 arg/3 arg/3 =../2
=../2 copy_term/2 term_variables/2 unify_with_occurs_check/2 ?=/2 subsumes_term/2 =@=/2 is/2 is/2
is/2 =:=/2 </2 >=/2 succ/2 plus/3 atom_length/2 atom_length/2 atom_concat/3 atom_concat/3 sub_atom/5
sub_atom/5 atom_chars/2 atom_chars/2 atom_codes/2 atom_codes/2 char_code/2 char_code/2
number_codes/2 number_codes/2 number_chars/2 atom_number/2 atom_number/2 upcase_atom/2
downcase_atom/2 term_to_atom/2 atomic_list_concat/2 atomic_list_concat/3 atomic_list_concat/3
string_concat/3 string_length/2 string_chars/2 string_codes/2 string_to_atom/2 number_string/2
atom_string/2 sub_string/5 split_string/4 split_string/4 string_code/3 string_lower/2 string_upper/2
text_concat/3 nb_setval/2 length/2 length/2 append/3 append/2 member/2 memberchk/2 select/3
selectchk/3 subtract/3 permutation/2 delete/3 exclude/3 nth0/3 nth1/3 nth0/4 last/2 msort/2 sort/2
sort/4 sort/4 predsort/3 keysort/2 reverse/2 sum_list/2 max_list/2 min_list/2 numlist/3
list_to_set/2 sumlist/2 intersection/3 union/3 subset/2 flatten/2 max_member/2 min_member/2
pairs_keys_values/3 pairs_keys/2 pairs_values/2 exclude/3 maplist/2 maplist/3 foldl/4 nextto/3
same_length/2 sum_list/2 list_to_ord_set/2 ord_union/3 ord_subtract/3 ord_memberchk/2 findall/3
findall/4 bagof/3 setof/3 aggregate_all/3 forall/2 between/3 call/1 call/2 \+/1 once/1 ignore/1
catch/3 tab/1 op/3 current_op/3 must_be/2 must_be/2 is_of_type/2 ground/1 term_string/2 sformat/3
format/3 char_type/2 code_type/2 setof/3 assertz/1 retract/1 clause/2 abolish/1 atom_to_term/3
number_vars/3 read_term_from_atom/3 tab/2 is_assoc/1 list_to_assoc/2 pairs_keys/2 last/2 sumlist/2
exclude/3 partition/4 string_code/3 concat_atom/2
"""
PREDICATES = _PREDICATES.split()
_LEFT_OUT = {
    "sformat/3",
    "number_vars/3",
    "tab/1",
    "tab/2",
    "concat_atom/2",
    "op/3",
    "current_op/3",
    "read_term_from_atom/3",
}

_ARITHMETIC = r"""
X 1 2 -3 0 2.5 -0.5 7 10 3 a foo(1) inf nan 12345678901234567890 1.0 e pi max_tagged_integer "a" [5]
"""
ARITHMETIC = _ARITHMETIC.split()
_FUNCTIONS = r"""
+/2 -/2 */2 ///2 mod/2 rem/2 div/2 //2 min/2 max/2 **/2 ^/2 >>/2 <</2 /\/2 \//2 xor/2 gcd/2 atan2/2
atan/2 copysign/2 log/2 truncate/1 -/1 +/1 abs/1 sign/1 sqrt/1 sin/1 cos/1 atan/1 exp/1 log/1 log2/1
floor/1 ceiling/1 round/1 integer/1 float/1 float_integer_part/1 float_fractional_part/1 \/1 msb/1
succ/1 plus/2 asin/1 acos/1 tan/1 sinh/1 cot/1 acot/1
"""
FUNCTIONS = _FUNCTIONS.split()


def goals(count: int, seed: int) -> List[str]:
    """Return goals as text."""
    random.seed(seed)
    made: Dict[str, None] = {}
    while len(made) < count:
        if random.random() < 0.2:
            made["X is " + expression(2)] = None
            continue
        name, _, arity = random.choice(PREDICATES).rpartition("/")
        if f"{name}/{arity}" in _LEFT_OUT:
            continue
        if name == "is":
            made["X is " + expression(1)] = None
            continue
        args = ",".join(
            f"({value})" if ":-" in value or ";" in value else value for value in arguments(int(arity))
        )
        quoted = name if name[0].isalpha() else f"'{name}'".replace("\\", "\\\\")
        made[f"{quoted}({args})"] = None
    return list(made)


def arguments(arity: int) -> List[str]:
    return [random.choice(VALUES) if random.random() > 0.3 else random.choice("XYZ") for _ in range(arity)]


def expression(depth: int) -> str:
    if depth == 0 or random.random() < 0.3:
        return random.choice(ARITHMETIC)
    name, _, arity = random.choice(FUNCTIONS).rpartition("/")
    quoted = f"'{name}'".replace("\\", "\\\\") if not name.isalpha() else name
    return f"{quoted}({','.join(expression(depth - 1) for _ in range(int(arity)))})"


def answer(text: str) -> str:
    """Return the answers to a goal here: the list of instantiated goals, or the error term."""
    logic = Logic()
    logic.limits = Limits(inferences=200_000, seconds=5, megabytes=300)
    output: List[str] = []
    logic.output = logic.error_output = output.append
    try:
        goal = read_term(text, logic.operators).term
    except SyntaxFault:
        return "unread"
    try:
        found = []
        for _ in logic.solutions(goal):
            found.append(shown(goal))
            if len(found) == MOST:
                break
        return f"[{','.join(found)}]"
    except PrologError as error:
        term = error.term
        if term.__class__ is tuple and term[0] is functor("error", 2):
            return f"error({shown(term[1])})"
        return f"ball({shown(term)})"


def shown(term: object) -> str:
    """Return a term as canonical text with its variables named in order."""
    numbered = copy(term)
    for number, var in enumerate(variables(numbered)):
        var.ref = (functor("$VAR", 1), number)
    return write_term(numbered, quoted=True, ignore_ops=True, numbervars=True)


SWI = r"""
:- set_prolog_flag(toplevel_print_anon, false).
:- style_check(-singleton).
shown(T) :-
    copy_term(T, C, _), numbervars(C, 0, _),
    write_term(C, [quoted(true), ignore_ops(true), numbervars(true)]).
one(Text) :-
    catch(term_to_atom(G, Text), _, fail), !,
    catch(( call_with_time_limit(5, findall(G, limit(5, G), L)), write_list(L) ), E, fault(E)), nl.
write_list(L) :- write('['), write_items(L), write(']').
write_items([]).
write_items([X]) :- !, shown(X).
write_items([X|Xs]) :- shown(X), write(','), write_items(Xs).
fault(error(E, _)) :- !, write('error('), shown(E), write(')').
fault(E) :- write('ball('), shown(E), write(')').
main :-
    read_term(user_input, T, []),
    ( T == end_of_file -> true ; write('#'), ( one(T) -> true ; write(unread), nl ), main ).
"""


def swipl_answers(texts: List[str]) -> List[str]:
    """Return SWI-Prolog's answers; goals that print mix that into their answers."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "goals.pl"
        path.write_text(SWI)
        quoted = "".join("'" + text.replace("\\", "\\\\").replace("'", "\\'") + "'.\n" for text in texts)
        done = subprocess.run(
            ["swipl", "-q", "-l", str(path), "-g", "main", "-t", "halt"],
            input=quoted,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            check=True,
        )
    return [part.rstrip("\n") for part in ("\n" + done.stdout).split("\n#")[1:]]


def main() -> None:
    """Compare or record."""
    if sys.argv[1] == "--record":
        texts = goals(int(sys.argv[2]), 7)
        pairs = zip(texts, swipl_answers(texts))
        RECORD.write_text("".join(f"{text}\t{found}\n" for text, found in pairs if "\n" not in found))
        return
    texts = goals(int(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else random.randrange(1 << 30))
    differing = 0
    for text, theirs in zip(texts, swipl_answers(texts)):
        ours = answer(text)
        if ours != theirs:
            differing += 1
            print(f"{text}\n  here  {ours}\n  swipl {theirs}")
    print(f"{differing} of {len(texts)} differ")


if __name__ == "__main__":
    main()
