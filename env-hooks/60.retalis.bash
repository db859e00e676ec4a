# generated from retalis/env-hooks/60.retalis.bash
# `retalis COMMAND ...` for `rosrun retalis retalis COMMAND ...`, with completion.
if ! type retalis >/dev/null 2>&1; then
  retalis() { rosrun retalis retalis "$@"; }
fi

_retalis_complete() {
  local word="${COMP_WORDS[COMP_CWORD]}" before="${COMP_WORDS[COMP_CWORD-1]}" number node="" words=""
  COMPREPLY=()
  for ((number = 1; number < COMP_CWORD - 1; number++)); do
    [ "${COMP_WORDS[number]}" = --node ] && node="${COMP_WORDS[number+1]}"
  done
  case "$before" in
    --node) words="$(retalis complete nodes 2>/dev/null)" ;;
    --wait-for) words="$(retalis complete memories ${node:+--node "$node"} 2>/dev/null)" ;;
    retalis) words="query list status explain watch reload console bag demo events" ;;
    *) words="--node --json --help"
       [ "${COMP_WORDS[1]}" = query ] && words="$words --most --seconds --inferences --wait-for --stamp --timeout"
       [ "${COMP_WORDS[1]}" = watch ] && words="$words --event --inputs --count"
       [ "${COMP_WORDS[1]}" = status ] && words="$words --every --once" ;;
  esac
  local IFS=$'\n'
  COMPREPLY=($(compgen -W "${words// /$'\n'}" -- "$word"))
}
complete -F _retalis_complete retalis
