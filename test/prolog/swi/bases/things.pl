% Triples: what stands where, in a file beside this one.

:- module(things, [on/2, move/2, kinds/2]).
:- use_module(library(semweb/rdf_db)).
:- use_module(library(semweb/turtle)).

:- rdf_register_prefix(room, 'http://example.org/room#').
:- rdf_meta at(r, r).

:- prolog_load_context(directory, Folder),
   atom_concat(Folder, '/things.ttl', File),
   rdf_load(File, [format(turtle), silent(true)]).

on(Thing, Place) :-
    rdf(ThingUri, room:on, PlaceUri),
    rdf_global_id(room:Thing, ThingUri),
    rdf_global_id(room:Place, PlaceUri).

move(Thing, Place) :-
    rdf_global_id(room:Thing, ThingUri),
    rdf_global_id(room:Place, PlaceUri),
    rdf_retractall(ThingUri, room:on, _),
    rdf_assert(ThingUri, room:on, PlaceUri).

kinds(Thing, Kinds) :-
    rdf_global_id(room:Thing, Uri),
    findall(Name, ( rdf(Uri, rdf:type, Kind), rdf_reachable(Kind, rdfs:subClassOf, Over),
                    rdf_global_id(room:Name, Over) ), Found),
    sort(Found, Kinds).
