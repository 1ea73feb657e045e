"""The parser of the command line: bad words are answered with those that were meant, help ends with examples."""

import argparse

from jaxmpm.errors import SceneError, near_or


class Parser(argparse.ArgumentParser):
    """A parser that reports bad options as the rest of the program reports bad input."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, formatter_class=_Help, **kwargs)
        self.set_defaults(parser=self)  # of a command, that of the command

    def error(self, message):
        """Raise SceneError with the command in front."""
        for word in ("argument COMMAND: ", "argument WHAT: ", "argument "):
            message = message.removeprefix(word)
        if "are required" in message:
            message += f" (see {self.prog} --help)"
        raise SceneError(f"{self._where()}{message}")

    def parse_all(self, arguments=None) -> argparse.Namespace:
        """The options; raises SceneError for words that no option is, with the nearest that is one."""
        options, unknown = self.parse_known_args(arguments)
        if unknown:
            options.parser.unknown(unknown[0])
        return options

    def unknown(self, word: str) -> None:
        """Raise SceneError for a word that means nothing here."""
        head, equals, _ = word.partition("=")
        options = [name for name in self.option_strings() if name != "-h"]
        if head.startswith("-"):
            near = next((name for name in options if name.startswith(head)), None)
            hint = f"did you mean {near}?" if near else near_or(head, options)
            raise SceneError(f"{self._where()}unknown {head} ({hint})")
        hint = f"did you mean --set {word}?" if equals and "--set" in options else f"see {self.prog} --help"
        raise SceneError(f"{self._where()}unknown {word} ({hint})")

    def option_strings(self) -> list[str]:
        """All that begin with a dash."""
        return [name for action in self._actions for name in action.option_strings]

    def show_examples(self, examples: list[tuple[str, str]]) -> None:
        """End the help with command lines, each with what it does."""
        width = max(len(line) for line, _ in examples)
        rows = "\n".join(f"  {line:{width}}  # {what}" for line, what in examples)
        self.epilog = f"examples:\n{rows}"

    def _check_value(self, action, value):
        if action.choices is not None and value not in action.choices:
            raise argparse.ArgumentError(action, f"{value}: {_meant(action, value)}")

    def _where(self) -> str:
        command = self.prog.partition(" ")[2]
        return f"{command}: " if command else ""


def _meant(action, value) -> str:
    """Advice on a word that is none of an action's choices."""
    if isinstance(action, argparse._SubParsersAction) and "run" in action.choices:
        from jaxmpm.scene_source import bundled

        if value in bundled() or str(value).endswith(".toml"):
            return f"expected a command (did you mean jaxmpm run {value}?)"
    return near_or(value, action.choices)


class _Help(argparse.RawDescriptionHelpFormatter):
    """Names and what they mean in one line each."""

    def __init__(self, prog):
        super().__init__(prog, max_help_position=27)
