# Debian's package rosbash has roscd, rosls and the like among its completions only, and not in its environment hook.
if ! type roscd >/dev/null 2>&1 && [ -r /usr/share/bash-completion/completions/rosbash ]; then
  . /usr/share/bash-completion/completions/rosbash
fi
