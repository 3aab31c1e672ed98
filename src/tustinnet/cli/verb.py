"""Verbs as commands: their help, and what is refused before anything is loaded.

That are options of an earlier version, and paths that name nothing or that no file system takes.
"""

from collections import Counter
from collections.abc import Mapping
from typing import Any

from typer.core import TyperCommand

from tustinnet.errors import InputError
from tustinnet.old_names import OPTIONS

_LONGEST_PART, _LONGEST = 255, 4000  # bytes of a file's name and of a path, as systems have them
_FILES = ("FILE", "DIR", "MODEL", "RUN")  # words of metavars of values that may be paths
_FIRST, _FEW = 6, 9  # options that the help lists first, and number of those that need no groups


class Verb(TyperCommand):
    """A verb; its paths are checked before anything is loaded for it."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parses the arguments.

        Raises:
            InputError: an option of an earlier version, one of a single value that is given twice,
                an empty path, or one with a name that is too long.
        """
        if not ctx.resilient_parsing:
            for option in (arg.partition("=")[0] for arg in args):
                if instead := OPTIONS.get((str(self.name), option)):
                    raise InputError(option, "an option of an earlier version", instead)
            values, _, given = self.make_parser(ctx).parse_args(args=list(args))
            for option, times in Counter(given).items():
                if times > 1 and not (option.multiple or getattr(option, "is_flag", False)):
                    raise InputError(max(option.opts, key=len), "given twice", "one value")
            for parameter in self.get_params(ctx):
                is_argument = parameter.param_type_name == "argument"
                if is_argument or any(word in str(parameter.metavar) for word in _FILES):
                    name = parameter.metavar if is_argument else max(parameter.opts, key=len)
                    value = values.get(str(parameter.name))
                    for path in value if isinstance(value, list | tuple) else [value]:
                        if isinstance(path, str):
                            _require_path(str(name), path)
        return super().parse_args(ctx, args)

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Writes arguments and options; of many options first those that are used most."""
        by_kind: dict[str, list[tuple[str, str]]] = {"argument": [], "option": []}
        for parameter in self.get_params(ctx):
            if record := parameter.get_help_record(ctx):
                by_kind[parameter.param_type_name].append(record)
        options = by_kind["option"]
        first = _FIRST if len(options) > _FEW else len(options)
        for title, records in (
            ("Arguments", by_kind["argument"]),
            ("Options", options[:first]),
            ("More options", options[first:]),
        ):
            if records:
                with formatter.section(title):
                    formatter.write_dl(records)


def refuse_options(given: Mapping[str, object], case: str, expected: str, remedy: str = "") -> None:
    """Raises an error for the first option that was given where it does not apply.

    Args:
        given: values by option; those that are None or False were not given.
        case: the case in which they do not apply, as `without records`.
        expected: what they need.
        remedy: what to do.
    """
    for option, value in given.items():
        if value is not None and value is not False:
            raise InputError(option, f"not applicable {case}", expected, remedy)


def _require_path(name: str, path: str) -> None:
    """Raises unless a text can be a path; an empty one would be the current folder."""
    if not path.strip():
        raise InputError(name, f"'{path}'", "a path or a name", "for the current folder, write .")
    sizes = [len(part.encode(errors="replace")) for part in path.split("/")]
    if max(sizes) > _LONGEST_PART or sum(sizes) + len(sizes) > _LONGEST:
        raise InputError(
            name,
            f"'{path[:30]}...', a path of {len(path)} characters",
            f"at most {_LONGEST}, and {_LONGEST_PART} bytes in each name",
        )
    if "\0" in path:
        raise InputError(name, "a path with a zero byte", "a path")
