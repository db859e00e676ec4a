% Heaps, with the least priority first: heap(Tree, Size). A tree is nil or t(Key, Priority, Trees), a pairing heap.
%
% defines: empty_heap/1 singleton_heap/3 add_to_heap/4 get_from_heap/4 delete_from_heap/4 heap_size/2
% defines: heap_to_list/2 list_to_heap/2 merge_heaps/3 min_of_heap/3 min_of_heap/5 is_heap/1 peek_at_heap/3

empty_heap(heap(nil, 0)).

singleton_heap(heap(t(Key, Priority, []), 1), Priority, Key).

is_heap(Heap) :-
    nonvar(Heap),
    Heap = heap(Tree, Size),
    integer(Size),
    Size >= 0,
    (   Size =:= 0
    ->  Tree == nil
    ;   nonvar(Tree),
        Tree = t(_, _, Trees),
        is_list(Trees)
    ).

heap_size(heap(_, Size), Size).

add_to_heap(heap(Tree0, Size0), Priority, Key, heap(Tree, Size)) :-
    heap_meld_(Tree0, t(Key, Priority, []), Tree),
    Size is Size0 + 1.

merge_heaps(heap(One, N), heap(Other, M), heap(Tree, Size)) :-
    heap_meld_(One, Other, Tree),
    Size is N + M.

heap_meld_(nil, Tree, Tree) :- !.
heap_meld_(Tree, nil, Tree) :- !.
heap_meld_(t(K1, P1, Trees1), t(K2, P2, Trees2), Tree) :-
    (   P1 @=< P2
    ->  Tree = t(K1, P1, [t(K2, P2, Trees2)|Trees1])
    ;   Tree = t(K2, P2, [t(K1, P1, Trees1)|Trees2])
    ).

get_from_heap(heap(t(Key, Priority, Trees), Size0), Priority, Key, heap(Tree, Size)) :-
    heap_pair_(Trees, Tree),
    Size is Size0 - 1.

heap_pair_([], nil).
heap_pair_([Tree], Tree) :- !.
heap_pair_([One,Other|Trees], Tree) :-
    heap_meld_(One, Other, Pair),
    heap_pair_(Trees, Rest),
    heap_meld_(Pair, Rest, Tree).

min_of_heap(heap(t(Key, Priority, _), _), Priority, Key).

min_of_heap(Heap, Priority1, Key1, Priority2, Key2) :-
    get_from_heap(Heap, Priority1, Key1, Rest),
    min_of_heap(Rest, Priority2, Key2).

peek_at_heap(Heap, Priority, Key) :-
    min_of_heap(Heap, Priority, Key).

list_to_heap(Pairs, Heap) :-
    must_be(list, Pairs),
    empty_heap(Empty),
    heap_fill_(Pairs, Empty, Heap).

heap_fill_([], Heap, Heap).
heap_fill_([Priority-Key|Pairs], Heap0, Heap) :-
    add_to_heap(Heap0, Priority, Key, Heap1),
    heap_fill_(Pairs, Heap1, Heap).

heap_to_list(Heap, Pairs) :-
    (   get_from_heap(Heap, Priority, Key, Rest)
    ->  Pairs = [Priority-Key|Pairs1],
        heap_to_list(Rest, Pairs1)
    ;   Pairs = []
    ).

% The first entry of the key; its trees go to the top.

delete_from_heap(heap(Tree0, Size0), Priority, Key, heap(Tree, Size)) :-
    heap_take_(Tree0, Key, Found, Tree), !,
    Priority = Found,
    Size is Size0 - 1.

heap_take_(t(K, P, Trees), Key, Priority, Tree) :-
    (   K == Key
    ->  Priority = P,
        heap_pair_(Trees, Tree)
    ;   heap_take_in_(Trees, Key, Priority, Left),
        Tree = t(K, P, Left)
    ).

heap_take_in_([Tree0|Trees], Key, Priority, Left) :-
    (   heap_take_(Tree0, Key, Priority, Tree)
    ->  (   Tree == nil
        ->  Left = Trees
        ;   Left = [Tree|Trees]
        )
    ;   Left = [Tree0|Left1],
        heap_take_in_(Trees, Key, Priority, Left1)
    ).
