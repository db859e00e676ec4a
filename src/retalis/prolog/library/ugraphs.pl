% Directed graphs without weights: sorted lists of Vertex-Neighbours, the neighbours sorted.
%
% defines: vertices_edges_to_ugraph/3 vertices/2 edges/2 add_vertices/3 del_vertices/3 add_edges/3 del_edges/3
% defines: transpose_ugraph/2 neighbours/3 neighbors/3 complement/2 compose/3 top_sort/2 reachable/3
% defines: transitive_closure/2 ugraph_union/3 connect_ugraph/3

vertices_edges_to_ugraph(Vertices, Edges, Graph) :-
    sort(Edges, Sorted),
    ugraph_ends_(Sorted, Ends),
    append(Vertices, Ends, All),
    sort(All, Set),
    ugraph_group_(Set, Sorted, Graph).

ugraph_ends_([], []).
ugraph_ends_([From-To|Edges], [From,To|Ends]) :-
    ugraph_ends_(Edges, Ends).

% ugraph_group_(Vertices, Edges, Graph): both sorted, and each edge begins at one of the vertices.

ugraph_group_([], _, []).
ugraph_group_([V|Vs], Edges, [V-Neighbours|Graph]) :-
    ugraph_from_(Edges, V, Neighbours, Rest),
    ugraph_group_(Vs, Rest, Graph).

ugraph_from_([From-To|Edges], V, [To|Neighbours], Rest) :-
    From == V, !,
    ugraph_from_(Edges, V, Neighbours, Rest).
ugraph_from_(Edges, _, [], Edges).

vertices(Graph, Vertices) :-
    pairs_keys(Graph, Vertices).

% An open list is no graph: what goes through all vertices fails for it.

edges(Graph, Edges) :-
    is_list(Graph),
    findall(From-To, (member(From-Neighbours, Graph), member(To, Neighbours)), Edges).

neighbours(Vertex, Graph, Neighbours) :-
    is_list(Graph),
    member(V-Found, Graph),
    V == Vertex, !,
    Neighbours = Found.

neighbors(Vertex, Graph, Neighbours) :-
    neighbours(Vertex, Graph, Neighbours).

add_vertices(Graph, Vertices, New) :-
    sort(Vertices, Set),
    ugraph_bare_(Set, Bare),
    ugraph_union(Graph, Bare, New).

ugraph_bare_([], []).
ugraph_bare_([V|Vs], [V-[]|Graph]) :-
    ugraph_bare_(Vs, Graph).

del_vertices(Graph, Vertices, New) :-
    sort(Vertices, Set),
    ugraph_without_(Graph, Set, New).

ugraph_without_([], _, []).
ugraph_without_([V-Neighbours|Graph], Set, New) :-
    (   ord_memberchk(V, Set)
    ->  New = New1
    ;   ord_subtract(Neighbours, Set, Left),
        New = [V-Left|New1]
    ),
    ugraph_without_(Graph, Set, New1).

add_edges(Graph, Edges, New) :-
    vertices_edges_to_ugraph([], Edges, Added),
    ugraph_union(Graph, Added, New).

del_edges(Graph, Edges, New) :-
    vertices_edges_to_ugraph([], Edges, Taken),
    ugraph_minus_(Graph, Taken, New).

ugraph_minus_([], _, []) :- !.
ugraph_minus_(Graph, [], Graph) :- !.
ugraph_minus_([V-Ns|Graph], [W-Ms|Taken], New) :-
    compare(Order, V, W),
    ugraph_minus_(Order, V-Ns, Graph, W-Ms, Taken, New).

ugraph_minus_(<, V, Graph, W, Taken, [V|New]) :-
    ugraph_minus_(Graph, [W|Taken], New).
ugraph_minus_(=, V-Ns, Graph, _-Ms, Taken, [V-Left|New]) :-
    ord_subtract(Ns, Ms, Left),
    ugraph_minus_(Graph, Taken, New).
ugraph_minus_(>, V, Graph, _, Taken, New) :-
    ugraph_minus_([V|Graph], Taken, New).

ugraph_union([], Graph, Graph) :- !.
ugraph_union(Graph, [], Graph) :- !.
ugraph_union([V-Ns|One], [W-Ms|Other], Union) :-
    compare(Order, V, W),
    ugraph_union_(Order, V-Ns, One, W-Ms, Other, Union).

ugraph_union_(<, V, One, W, Other, [V|Union]) :-
    ugraph_union(One, [W|Other], Union).
ugraph_union_(=, V-Ns, One, _-Ms, Other, [V-All|Union]) :-
    ord_union(Ns, Ms, All),
    ugraph_union(One, Other, Union).
ugraph_union_(>, V, One, W, Other, [W|Union]) :-
    ugraph_union([V|One], Other, Union).

transpose_ugraph(Graph, Transposed) :-
    is_list(Graph),
    pairs_keys(Graph, Vertices),
    findall(To-From, (member(From-Neighbours, Graph), member(To, Neighbours)), Edges),
    vertices_edges_to_ugraph(Vertices, Edges, Transposed).

complement(Graph, Complement) :-
    is_list(Graph),
    pairs_keys(Graph, Vertices),
    ugraph_others_(Graph, Vertices, Complement).

ugraph_others_([], _, []).
ugraph_others_([V-Neighbours|Graph], Vertices, [V-Others|Complement]) :-
    ord_add_element(Neighbours, V, Taken),
    ord_subtract(Vertices, Taken, Others),
    ugraph_others_(Graph, Vertices, Complement).

compose(One, Other, Composed) :-
    is_list(One),
    is_list(Other),
    pairs_keys(One, Vs),
    pairs_keys(Other, Ws),
    ord_union(Vs, Ws, Vertices),
    list_to_assoc(Other, Second),
    list_to_assoc(One, First),
    ugraph_compose_(Vertices, First, Second, Composed).

ugraph_compose_([], _, _, []).
ugraph_compose_([V|Vs], First, Second, [V-To|Composed]) :-
    ugraph_at_(First, V, Through),
    ugraph_over_(Through, Second, To),
    ugraph_compose_(Vs, First, Second, Composed).

ugraph_at_(Assoc, V, Neighbours) :-
    (   get_assoc(V, Assoc, Found)
    ->  Neighbours = Found
    ;   Neighbours = []
    ).

ugraph_over_(Through, Second, To) :-
    ugraph_all_(Through, Second, Lists),
    ord_union(Lists, To).

ugraph_all_([], _, []).
ugraph_all_([V|Vs], Second, [To|Lists]) :-
    ugraph_at_(Second, V, To),
    ugraph_all_(Vs, Second, Lists).

% A vertex is reachable from itself, and in a closure only by a way of edges.

reachable(Vertex, Graph, Reachable) :-
    is_list(Graph),
    list_to_assoc(Graph, Neighbours),
    ugraph_reach_([Vertex], Neighbours, [Vertex], Reachable),
    ugraph_known_(Reachable, Neighbours).

% What the graph does not have is reachable from nowhere, and reaches nothing.

ugraph_known_([], _).
ugraph_known_([V|Vs], Neighbours) :-
    get_assoc(V, Neighbours, _),
    ugraph_known_(Vs, Neighbours).

ugraph_reach_([], _, Found, Found).
ugraph_reach_([V|Vs], Neighbours, Found, Reachable) :-
    ugraph_at_(Neighbours, V, To),
    ord_subtract(To, Found, New),
    ord_union(Found, New, Found1),
    append(New, Vs, Next),
    ugraph_reach_(Next, Neighbours, Found1, Reachable).

transitive_closure(Graph, Closure) :-
    is_list(Graph),
    list_to_assoc(Graph, Neighbours),
    ugraph_close_(Graph, Neighbours, Closure).

ugraph_close_([], _, []).
ugraph_close_([V-To|Graph], Neighbours, [V-All|Closure]) :-
    ugraph_reach_(To, Neighbours, To, All),
    ugraph_close_(Graph, Neighbours, Closure).

% A vertex that no edge ends at comes first; of several the first in the graph.

top_sort(Graph, Sorted) :-
    is_list(Graph),
    findall(To, (member(_-Neighbours, Graph), member(To, Neighbours)), Ends),
    msort(Ends, Ordered),
    clumped_keys_(Ordered, Counts),
    list_to_assoc(Counts, Incoming),
    list_to_assoc(Graph, Outgoing),
    ugraph_free_(Graph, Incoming, Free),
    ugraph_top_(Free, Outgoing, Incoming, Sorted),
    length(Graph, Size),
    length(Sorted, Size).

clumped_keys_([], []).
clumped_keys_([K|Ks], [K-N|Counts]) :-
    clumped_rest_(Ks, K, 1, N, Rest),
    clumped_keys_(Rest, Counts).

clumped_rest_([K1|Ks], K, N0, N, Rest) :-
    K1 == K, !,
    N1 is N0 + 1,
    clumped_rest_(Ks, K, N1, N, Rest).
clumped_rest_(Rest, _, N, N, Rest).

ugraph_free_([], _, []).
ugraph_free_([V-_|Graph], Incoming, Free) :-
    (   get_assoc(V, Incoming, _)
    ->  Free = Free1
    ;   Free = [V|Free1]
    ),
    ugraph_free_(Graph, Incoming, Free1).

ugraph_top_([], _, _, []).
ugraph_top_([V|Vs], Outgoing, Incoming, [V|Sorted]) :-
    get_assoc(V, Outgoing, To),
    ugraph_let_go_(To, Incoming, Incoming1, Vs, Free),
    ugraph_top_(Free, Outgoing, Incoming1, Sorted).

ugraph_let_go_([], Incoming, Incoming, Free, Free).
ugraph_let_go_([V|Vs], Incoming0, Incoming, Free0, Free) :-
    get_assoc(V, Incoming0, N),
    M is N - 1,
    put_assoc(V, Incoming0, M, Incoming1),
    (   M =:= 0
    ->  Free1 = [V|Free0]
    ;   Free1 = Free0
    ),
    ugraph_let_go_(Vs, Incoming1, Incoming, Free1, Free).

% A new vertex before all others, with edges to all of them.

connect_ugraph([], 0, []) :- !.
connect_ugraph(Graph, Start, [Start-Vertices|Graph]) :-
    pairs_keys(Graph, Vertices),
    Vertices = [First|_],
    (   number(First)
    ->  Start is floor(First) - 1
    ;   Start = 0
    ).
