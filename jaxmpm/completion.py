"""Scripts by which shells complete the command line, made from its parser."""

import argparse
from dataclasses import dataclass, field

from jaxmpm.errors import SceneError, near_or

PLACES = ("scene", "folder", "file")  # what of the disk may stand somewhere


@dataclass
class Command:
    """What may follow a command: options (with their help and what they take) and words."""

    options: dict[str, tuple[str, str]] = field(default_factory=dict)  # name to help and kind of value, "" for none
    words: dict[str, str] = field(default_factory=dict)  # commands below this one and choices, with their help
    place: str = ""  # kind of the word that may stand there: "scene", "folder", "file"


def commands(parser: argparse.ArgumentParser, scenes: list[str]) -> dict[str, Command]:
    """All commands by the words that lead to them, "" for none yet: "run", "calibrate energy" …"""
    found = {}
    _collect(parser, "", scenes, found)
    return found


def _collect(parser, path, scenes, found):
    one = found[path] = Command()
    for action in parser._actions:
        about = "" if action.help in (None, argparse.SUPPRESS) else _plain(action.help)
        if isinstance(action, argparse._SubParsersAction):
            helps = {choice.dest: _plain(choice.help or "") for choice in action._choices_actions}
            for name, below in action.choices.items():
                one.words[name] = helps.get(name, "")
                _collect(below, f"{path} {name}".strip(), scenes, found)
        elif action.option_strings:
            kind = "" if action.nargs == 0 else " ".join(action.choices or ()) or _kind(action)
            one.options |= {name: (about, kind) for name in action.option_strings if name.startswith("--")}
        else:
            one.place = _kind(action)
            one.words |= dict.fromkeys(action.choices or (), "")
            if one.place == "scene":
                one.words |= dict.fromkeys(scenes, "")


def _kind(action) -> str:
    """What an action's value is, by what its help calls it."""
    name = action.metavar[0] if isinstance(action.metavar, tuple) else action.metavar or action.dest
    return {"SCENE": "scene", "DIR": "folder", "FILE": "file", "FILE.toml": "file"}.get(str(name), "word")


def _plain(text: str) -> str:
    """Help as it is shown, which may stand between single quotes."""
    return text.replace("%%", "%").replace("'", "’")


def script(shell: str, found: dict[str, Command]) -> str:
    """The script for bash, zsh or fish; raises SceneError for another shell."""
    if shell not in SHELLS:
        raise SceneError(f"completion {shell}: {near_or(shell, SHELLS)}")
    return SHELLS[shell](found)


# bash and zsh share a function that says what may come; it needs no more than the words so far.


def _cases(found: dict[str, Command]) -> str:
    """Shell code: of a command's `path` what may follow, and after an option (`before`) its values."""
    lines = ['  case "$path/$before" in']
    for path, one in found.items():
        for name, (_, kind) in one.options.items():
            if kind:
                lines.append(f"    '{path}/{name}') {_values(kind)};;")
    lines += ["    *)", '      case "$path" in']
    for path, one in found.items():
        words = " ".join([*one.words, *one.options])
        lines.append(f"        '{path}') reply=\"{words}\"; files={one.place if one.place in PLACES else 'none'};;")
    return "\n".join([*lines, "      esac;;", "  esac"])


def _values(kind: str) -> str:
    if kind in PLACES:
        return f'reply=""; files={kind}'
    return f'reply="{kind if kind != "word" else ""}"; files=none'


def _path(found: dict[str, Command]) -> str:
    """Shell code: the command that the words so far make, in `path`; those are in `typed`."""
    known = " ".join(f"'{path}'" for path in found if path)
    return f"""  local path="" word step
  for word in "${{typed[@]}}"; do
    step="${{path:+$path }}$word"
    for known in {known}; do
      if [ "$known" = "$step" ]; then path="$step"; fi
    done
  done"""


def _bash(found: dict[str, Command]) -> str:
    return f"""# completion of jaxmpm for bash: eval "$(jaxmpm completion bash)"
_jaxmpm() {{
  local current="${{COMP_WORDS[COMP_CWORD]}}" before="${{COMP_WORDS[COMP_CWORD-1]}}" reply="" files=none known
  local typed=("${{COMP_WORDS[@]:1:COMP_CWORD-1}}")
{_path(found)}
{_cases(found)}
  COMPREPLY=($(compgen -W "$reply" -- "$current"))
  case "$files" in
    scene) COMPREPLY+=($(compgen -f -X '!*.toml' -- "$current") $(compgen -d -- "$current"));;
    folder) COMPREPLY+=($(compgen -d -- "$current"));;
    file) COMPREPLY+=($(compgen -f -- "$current"));;
  esac
}}
complete -o filenames -F _jaxmpm jaxmpm
"""


def _zsh(found: dict[str, Command]) -> str:
    return f"""#compdef jaxmpm
# completion of jaxmpm for zsh: eval "$(jaxmpm completion zsh)", after compinit
_jaxmpm() {{
  local before="${{words[CURRENT-1]}}" reply="" files=none known
  local typed=("${{(@)words[2,CURRENT-1]}}")
{_path(found)}
{_cases(found)}
  [ -n "$reply" ] && compadd -- ${{=reply}}
  case "$files" in
    scene) _files -g '*.toml';;
    folder) _files -/;;
    file) _files;;
  esac
}}
compdef _jaxmpm jaxmpm
"""


def _fish(found: dict[str, Command]) -> str:
    lines = ["# completion of jaxmpm for fish: jaxmpm completion fish > ~/.config/fish/completions/jaxmpm.fish", "complete -c jaxmpm -f"]
    for path, one in found.items():
        when = [f"__fish_seen_subcommand_from {word}" for word in path.split()]
        below = [name for name in one.words if f"{path} {name}".strip() in found]
        if below:
            when.append(f"not __fish_seen_subcommand_from {' '.join(below)}")
        start = f"complete -c jaxmpm -n '{'; and '.join(when)}'"
        lines += [f"{start} -a '{word}' -d '{about}'" for word, about in one.words.items()]
        if one.place in ("scene", "file"):
            lines.append(f"{start} -F")
        if one.place == "folder":
            lines.append(f"{start} -a '(__fish_complete_directories)'")
        for name, (about, kind) in one.options.items():
            takes = {"": "", "word": " -x", "scene": " -r -F", "file": " -r -F", "folder": " -x -a '(__fish_complete_directories)'"}
            lines.append(f"{start} -l {name[2:]} -d '{about}'{takes.get(kind, f' -x -a {chr(39)}{kind}{chr(39)}')}")
    return "\n".join(lines) + "\n"


SHELLS = {"bash": _bash, "zsh": _zsh, "fish": _fish}
