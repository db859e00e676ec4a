" Vim syntax file
" Language: retalis, event rules and goals
" docs/editors/make.py made this from the tables of operators.
if exists("b:current_syntax")
  finish
endif

syn case match
syn match retalisVariable "\<[A-Z_]\w*\>"
syn match retalisSymbol "[-+*/\\^<>=~:.?@#&$]\+"
syn match retalisArrow "\%([-+*/\\^<>=~:.?@#&$]\)\@1<!\%(<-\|:-\|?-\|-->\)\%([-+*/\\^<>=~:.?@#&$]\)\@!"
syn match retalisEnd "\.\ze\%(\s\|%\|$\)"
syn match retalisNumber "\<\d[0-9_]*\%(\.\d\+\)\=\%([eE][-+]\=\d\+\)\=\>"
syn match retalisNumber "\<0x\x\+\>\|\<0o\o\+\>\|\<0b[01]\+\>"
syn match retalisNumber "\<0'\%(\\.\|''\|[^\\]\)"
syn keyword retalisOperator iff Iff IFF do Do DO with With WITH where Where WHERE within Within WITHIN or Or OR check Check CHECK timestamp Timestamp TIMESTAMP event_multiply Event_multiply Event_Multiply EVENT_MULTIPLY par Par PAR and And AND cnot Cnot CNOT fnot Fnot FNOT without Without WITHOUT seq Seq SEQ forall_seq Forall_seq Forall_Seq FORALL_SEQ equals Equals EQUALS meets Meets MEETS during During DURING starts Starts STARTS finishes Finishes FINISHES ntimes Ntimes NTIMES star_times Star_times Star_Times STAR_TIMES aggregate Aggregate AGGREGATE absent Absent ABSENT not_preceded Not_preceded Not_Preceded NOT_PRECEDED at_end At_end At_End AT_END at_start At_start At_Start AT_START
syn keyword retalisProlog as discontiguous div dynamic initialization is meta_predicate mod module_transparent multifile public rdiv rem table thread_initialization thread_local volatile xor
syn region retalisAtom start=+'+ skip=+\\.\|''+ end=+'+
syn region retalisString start=+"+ skip=+\\.\|""+ end=+"+
syn region retalisString start=+`+ skip=+\\.\|``+ end=+`+
syn keyword retalisTodo contained TODO FIXME XXX
syn match retalisComment "%.*$" contains=retalisTodo,@Spell
syn region retalisComment start="/\*" end="\*/" contains=retalisTodo,@Spell

hi def link retalisVariable Identifier
hi def link retalisSymbol Operator
hi def link retalisArrow Statement
hi def link retalisEnd Delimiter
hi def link retalisNumber Number
hi def link retalisOperator Keyword
hi def link retalisProlog Operator
hi def link retalisAtom Constant
hi def link retalisString String
hi def link retalisTodo Todo
hi def link retalisComment Comment

let b:current_syntax = "retalis"
