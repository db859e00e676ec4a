# Completion of `retalis` for fish.

function __retalis_complete
  set -l words (commandline -opc) (commandline -ct)
  # fish completes an option with its value as one word.
  set -l value (string replace -r -- '^--[^=]*=' '' $words[-1])
  set -l option (string sub -l (math (string length -- $words[-1]) - (string length -- "$value")) -- $words[-1])
  set -l candidates ($words[1] complete words (math (count $words) - 1) $words 2>/dev/null </dev/null)
  if not set -q candidates[1]
    set candidates (__fish_complete_path $value)
  end
  printf '%s\n' "$option"$candidates
end

complete -c retalis -f -a '(__retalis_complete)'
