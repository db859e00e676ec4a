"""Event rules: scope of operators, and canonical terms."""

from typing import Any, List

import pytest
from asserting_accessors import compound
from parsing import read_clauses

from retalis import Operators
from retalis.prolog.syntax.term_reader import ReadTerm, read_program, read_term
from retalis.prolog.syntax.term_writer import write_term

OPERATORS = Operators.prolog()

RULES = {
    "a <- b": "<-(a,b)",
    "a iff b": "<-(a,b)",
    "a 'IFF' b": "<-(a,b)",
    # Prolog's signs in patterns, with the priorities of seq, par, and, or
    "a <- b * c": "<-(a,seq(b,c))",
    "a <- b seq c * d 'SEQ' e 'Seq' f": "<-(a,seq(seq(seq(seq(b,c),d),e),f))",
    "a <- x \\/ b /\\ c * e # f": "<-(a,or(x,par(and(b,seq(c,e)),f)))",
    "a <- x or b and c seq e": "<-(a,or(x,and(b,seq(c,e))))",
    "a <- p * (q \\/ r)": "<-(a,seq(p,or(q,r)))",
    "a <- b cnot c": "<-(a,cnot(b,c))",
    "a <- a seq b cnot c": "<-(a,cnot(seq(a,b),c))",
    "a <- e fnot f 'FNOT' g": "<-(a,fnot(fnot(e,f),g))",
    "a <- e not f": "<-(a,not(e,f))",
    "a <- b meets c seq d": "<-(a,seq(meets(b,c),d))",
    "a <- b seq c ntimes 3": "<-(a,ntimes(seq(b,c),3))",
    "a <- b seq (c ntimes 3)": "<-(a,seq(b,ntimes(c,3)))",
    "a <- b seq c star_times": "<-(a,seq(b,star_times(c)))",
    "a <- b seq c(Y) star_times seq d": "<-(a,seq(seq(b,star_times(c(Y))),d))",
    "a <- b 'Forall_Seq' c": "<-(a,forall_seq(b,c))",
    "a <- b, c": "<-(a,','(b,c))",
    "a <- b, c * d": "<-(a,seq(','(b,c),d))",
    # goals
    "a <- b where X is 2*3": "<-(a,where(b,is(X,*(2,3))))",
    "a <- b where (Z is X*2) , q": "<-(a,where(b,','(is(Z,*(X,2)),q)))",
    "a <- b where X or c": "<-(a,where(b,or(X,c)))",
    "a <- b within 5 where C": "<-(a,where(within(b,5),C))",
    "a <- b where C within 3": "<-(a,where(b,within(C,3)))",
    "a <- b * c within 2*60": "<-(a,within(seq(b,c),*(2,60)))",
    "a <- b * c check t1(X) do g(X*2)": "<-(a,do(check(seq(b,c),t1(X)),g(*(X,2))))",
    "a <- (b check X*2) * c": "<-(a,seq(check(b,*(X,2)),c))",
    "a <- b event_multiply member(X,[1*2]) do g": "<-(a,do(event_multiply(b,member(X,[*(1,2)])),g))",
    "a <- b timestamp t1(X)": "<-(a,timestamp(b,t1(X)))",
    "a <- b seq prolog(X is 1*2)": "<-(a,seq(b,prolog(is(X,*(1,2)))))",
    "a <- b seq query(X*2) seq db(X*2)": "<-(a,seq(seq(b,query(*(X,2))),db(*(X,2))))",
    "a <- b(X*2,[Y*3]) * c({Z*2})": "<-(a,seq(b(*(X,2),[*(Y,3)]),c({*(Z,2)})))",
    "a <- s seq aggregate(sum(X*2),b*c,R*1)": "<-(a,seq(s,aggregate(sum(*(X,2)),seq(b,c),*(R,1))))",
    # heads
    "h do g(X*2) <- b * c": "<-(do(h,g(*(X,2))),seq(b,c))",
    "null do (g, k*l) <- b": "<-(do(null,','(g,*(k,l))),b)",
    "out do (x or y) <- a": "<-(do(out,or(x,y)),a)",
    "b * c do X is 2*3": "do(seq(b,c),is(X,*(2,3)))",
    "a 'DO' b": "do(a,b)",
    "h(X*2) <- b * c do k": "<-(h(*(X,2)),do(seq(b,c),k))",
    # labels
    "r : a <- b * c": "rule:(r,<-(a,seq(b,c)))",
    "r 'rule:' a <- b * c": "rule:(r,<-(a,seq(b,c)))",
    "'rule:'(r, a <- b * c)": "rule:(r,<-(a,seq(b,c)))",
    "r([property(w,2*3)]) : a <- b * c": "rule:(r([property(w,*(2,3))]),<-(a,seq(b,c)))",
    "r : b * c do g": "rule:(r,do(seq(b,c),g))",
    "r : null do m:g <- b * c": "rule:(r,<-(do(null,:(m,g)),seq(b,c)))",
    "r1 'rule:' r2 'rule:' out <- a": "rule:(r1,rule:(r2,<-(out,a)))",
    "r : h <- b where m:g": "rule:(r,<-(h,where(b,:(m,g))))",
    # sub-patterns and rules as arguments
    "a <- b * (s(X) <- c * d) # e": "<-(a,par(seq(b,<-(s(X),seq(c,d))),e))",
    "ins_event_rule(late(X) <- inp(X) * b)": "ins_event_rule(<-(late(X),seq(inp(X),b)))",
    "f(a * b, x <- a * b, a * b)": "f(*(a,b),<-(x,seq(a,b)),*(a,b))",
    "[x <- a * b|y <- c * d]": "[<-(x,seq(a,b))|<-(y,seq(c,d))]",
    "null do ins_event_rule(l <- p * q) <- i * j": "<-(do(null,ins_event_rule(<-(l,seq(p,q)))),seq(i,j))",
    # written with functors
    "a <- seq(b, c*d)": "<-(a,seq(b,seq(c,d)))",
    "a <- 'SEQ'(b, 'Where'(c*d, X is 1*2))": "<-(a,seq(b,where(seq(c,d),is(X,*(1,2)))))",
    "a <- star_times(b*c) # not(1*2)": "<-(a,par(star_times(seq(b,c)),not(*(1,2))))",
    "<-(a, seq(b,c))": "<-(a,seq(b,c))",
    # the same words as atoms and functors
    "a <- b(seq, not, do, <-, *) * during": "<-(a,seq(b(seq,not,do,<-,*),during))",
    "a <- seq(1) * not": "<-(a,seq(seq(1),not))",
    "a <- do seq where": "<-(a,seq(do,where))",
    "null <- b": "<-(null,b)",
    # plain Prolog
    "h :- X is 2*3, Y = a:b": ":-(h,','(is(X,*(2,3)),=(Y,:(a,b))))",
    "h :- p(do), q(<-), r('Seq', *)": ":-(h,','(p(do),','(q(<-),r('Seq',*))))",
    ":- dynamic do/2, (<-)/2, seq/2": ":-(dynamic(','(/(do,2),','(/(<-,2),/(seq,2)))))",
    "lists:foo(X) :- X = 2*3": ":-(:(lists,foo(X)),=(X,*(2,3)))",
    "m:fact(2*3)": ":(m,fact(*(2,3)))",
    "x = do": "=(x,do)",
    "h :- ins_event_rule(a <- b * c), Z is 2*3": ":-(h,','(ins_event_rule(<-(a,seq(b,c))),is(Z,*(2,3))))",
    "p --> q * r": "-->(p,*(q,r))",
    "X = (a /\\ b)": "=(X,/\\(a,b))",
}


@pytest.mark.parametrize("text", RULES)
def test_rule_is_read_as_canonical_term(text: str) -> None:
    read = read_term(text, OPERATORS)
    names = {variable: name for name, variable in read.names.items()}
    canonical = write_term(read.term, Operators(), variable_names=names).replace("'rule:'", "rule:")
    assert canonical == RULES[text]


def test_rules_of_original_program_are_read() -> None:
    text = """
    null_event do split_tf(Transforms) <- tf__0__tfMessage(Transforms).
    split_ar_pose(Markers) <- ar_pose__0__ARMarkers(Header,Markers).
    syncronized(
        geometry_msgs__0__PoseStamped(std_msgs__0__Header(Seq, [Sec,NSec], Name), Pose),
        transform_marker(RelPose,[Sec,NSec],Pose),
        [[odom_base,Z],[base_torso,Z]]
    )
      <- ar_marker(Seq,Name,RelPose,Sec,NSec) where (Z is Sec + (NSec * 0.000000001) ).
    """
    read = list(read_clauses(text, OPERATORS))
    assert [compound(entry.term)[0].name for entry in read] == ["<-", "<-", "<-"]
    assert read[1].singletons == ["Header"]
    condition = compound(read[2].term)[2][2]
    assert write_term(condition[2], ignore_ops=True, variable_names={}).startswith("+(")


def test_new_operator_applies_from_next_clause() -> None:
    operators = Operators.prolog()
    reader = read_program("a.\nx ~~ y.\n p <- q ~~ r * s.", operators)
    clauses: List[Any] = []
    for entry in reader:
        assert isinstance(entry, ReadTerm)
        operators.add(700, "xfx", "~~")
        clauses.append(write_term(entry.term, Operators()))
    assert clauses == ["a", "~~(x,y)", "<-(p,seq(~~(q,r),s))"]


def test_new_flags_apply_from_next_clause() -> None:
    reader = read_program('x("a"). x("a").', OPERATORS)
    clauses: List[Any] = []
    for entry in reader:
        assert isinstance(entry, ReadTerm)
        clauses.append(write_term(entry.term))
        reader.flags = reader.flags._replace(double_quotes="codes")
    assert clauses == ['x("a")', "x([97])"]
