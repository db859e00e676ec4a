from retalis.syntax import Operators, read_program, read_term, to_text, writeq

OPS = Operators.prolog()


def test_slice():
    text = "tf([a('\"/odom\"',-1.5,[1|X])],'Hello w',nan)"
    assert writeq(read_term("a :- b, \\+ c ; d", OPS).term) == "a:-b,\\+c;d"
    assert to_text(read_term("f('\"a\"',-1.5,[1,2|x],'B')", OPS).term) == "f('\"a\"',-1.5,[1,2|x],'B')"
    assert len(list(read_program("a. b :- .\nc.", OPS))) == 3
