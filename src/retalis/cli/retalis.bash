# Completion of `retalis` for bash.

declare -gA _retalis_known # commands, and the options of each: they are asked for once

_retalis_complete() {
  local word="${COMP_WORDS[COMP_CWORD]}" command="${COMP_WORDS[0]}" of="-"
  ((COMP_CWORD > 1)) && of="${COMP_WORDS[1]}"
  if ((COMP_CWORD == 1)) && [[ $word != -* ]]; then
    [ "${_retalis_known[commands]-}" ] || _retalis_known[commands]="$("$command" complete words 1 "$command" "" 2>/dev/null)"
    mapfile -t COMPREPLY < <(compgen -W "${_retalis_known[commands]}" -- "$word")
  elif [[ $word == -* ]]; then
    [ "${_retalis_known[-$of]-}" ] || _retalis_known[-$of]="$("$command" complete words 2 "$command" "$of" - 2>/dev/null)"
    mapfile -t COMPREPLY < <(compgen -W "${_retalis_known[-$of]}" -- "$word")
  else # names of nodes and memories come and go; where the command knows of nothing, bash takes the names of files
    mapfile -t COMPREPLY < <("$command" complete words "$COMP_CWORD" "${COMP_WORDS[@]}" 2>/dev/null </dev/null)
  fi
}
complete -o default -F _retalis_complete retalis
