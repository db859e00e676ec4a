" docs/editors/make.py made this from the tables of operators.
autocmd BufNewFile,BufRead eventRules.txt,goalPredicates.txt,*.event,*.retalis set filetype=retalis
autocmd FileType retalis setlocal commentstring=%\ %s comments=:%
