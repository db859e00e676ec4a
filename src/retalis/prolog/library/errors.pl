% Predicates that throw ISO errors; debug messages by topic.
%
% defines: type_error/2 domain_error/2 existence_error/2 existence_error/3 permission_error/3 instantiation_error/1
% defines: uninstantiation_error/1 representation_error/1 syntax_error/1 resource_error/1
% defines: debug/3 debug/1 nodebug/1 debugging/1 debugging/2

type_error(Type, Culprit) :-
    throw(error(type_error(Type, Culprit), _)).

domain_error(Domain, Culprit) :-
    throw(error(domain_error(Domain, Culprit), _)).

existence_error(Type, Culprit) :-
    throw(error(existence_error(Type, Culprit), _)).

existence_error(Type, Culprit, In) :-
    throw(error(existence_error(Type, Culprit, In), _)).

permission_error(Action, Type, Culprit) :-
    throw(error(permission_error(Action, Type, Culprit), _)).

instantiation_error(_) :-
    throw(error(instantiation_error, _)).

uninstantiation_error(Culprit) :-
    throw(error(uninstantiation_error(Culprit), _)).

representation_error(Limit) :-
    throw(error(representation_error(Limit), _)).

syntax_error(Message) :-
    throw(error(syntax_error(Message), _)).

resource_error(Resource) :-
    throw(error(resource_error(Resource), _)).

% A global variable has the enabled topics. The topic of a message is unified with them.

debug(Topic) :-
    debug_topics_(Topics),
    (   member(Enabled, Topics), Enabled =@= Topic
    ->  true
    ;   nb_setval('$debug_topics', [Topic|Topics])
    ).

nodebug(Topic) :-
    debug_topics_(Topics),
    exclude(debug_covers_(Topic), Topics, Topics1),
    nb_setval('$debug_topics', Topics1).

debug_covers_(Topic, Enabled) :-
    subsumes_term(Topic, Enabled).

debugging(Topic) :-
    debug_topics_(Topics),
    member(Enabled, Topics),
    Topic = Enabled.

debugging(Topic, Enabled) :-
    (   debugging(Topic)
    ->  Enabled = true
    ;   Enabled = false
    ).

debug_topics_(Topics) :-
    (   nb_current('$debug_topics', Topics)
    ->  true
    ;   Topics = []
    ).

debug(Topic, Format, Arguments) :-
    (   \+ debugging(Topic)
    ->  true
    ;   format(user_error, "% ", []),
        format(user_error, Format, Arguments),
        nl(user_error)
    ).
