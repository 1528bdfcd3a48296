"""Types of option values, options grouped under headings, and the names of options in errors."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from itertools import takewhile
from pathlib import Path
from typing import Any

import click

from defocus_cli.formats.kinds import (
    FORMAT_ALIASES,
    KINDS,
    SUFFIXES,
)
from defocus_cli.jobs import quantities
from defocus_cli.system.errors import UsageProblem

Command = Callable[..., Any]
Decorator = Callable[[Command], Command]


def option_name(param: click.Parameter | None) -> str:
    """The long name of an option, or the metavar of an argument, as a user writes it."""
    if isinstance(param, click.Option):
        return max(param.opts, key=len)
    return param.human_readable_name if param else "command line"


class FilePath(click.ParamType[Path]):
    """A path; whether anything is there, and of use, is asked when it is opened."""

    name = "path"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """A path that is not empty, as ``"$UNSET"`` would be."""
        if not str(value):
            raise UsageProblem(option_name(param), "is empty", "give a path")
        return Path(value)


class Quantity(click.ParamType[Any]):
    """A quantity with its unit, read by a parser of ``quantities``."""

    def __init__(self, parse: Callable[[str], Any], name: str) -> None:
        self.parse = parse
        self.name = name

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Parse ``value``; what is parsed already passes."""
        if not isinstance(value, str):
            return value
        try:
            return self.parse(value)
        except quantities.QuantityError as error:
            raise UsageProblem(option_name(param), error.problem, error.remedy) from None


class Kinds(click.ParamType[tuple[str, ...]]):
    """Kinds of output, separated by commas."""

    name = "kinds"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, ...]:
        """Split and check; each kind once, in the order given."""
        if not isinstance(value, str):
            return tuple(value)
        kinds = tuple(dict.fromkeys(kind.strip() for kind in value.split(",")))
        for kind in kinds:
            if kind not in KINDS:
                remedy = f"choose from {', '.join(KINDS)}, separated by commas"
                raise UsageProblem(option_name(param), f"'{kind}' is not an output", remedy)
        return kinds


class Names(click.ParamType[tuple[str, ...]]):
    """Names separated by commas, each once; any if none are known."""

    name = "names"

    def __init__(self, known: Sequence[str] = ()) -> None:
        self.known = known

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, ...]:
        """Split and check."""
        if not isinstance(value, str):
            return tuple(value)
        names = tuple(dict.fromkeys(name.strip() for name in value.split(",")))
        for name in names:
            if not name or (self.known and name not in self.known):
                known = f"choose from {', '.join(self.known)}" if self.known else "give names"
                problem = f"'{name}' is not known" if name else "has an empty name"
                raise UsageProblem(option_name(param), problem, f"{known}, separated by commas")
        return names


class Listed(click.ParamType[tuple[Any, ...]]):
    """Values separated by commas, each once; `parse` raises ValueError for what is none."""

    def __init__(self, parse: Callable[[str], Any], name: str, example: str) -> None:
        self.parse = parse
        self.name = name
        self.example = example

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[Any, ...]:
        """Split and parse."""
        if not isinstance(value, str):
            return tuple(value)
        found = []
        for word in value.split(","):
            try:
                found.append(self.parse(word.strip()))
            except ValueError:
                problem = f"'{word.strip()}' is no {self.name}"
                remedy = f"write like {self.example}"
                raise UsageProblem(option_name(param), problem, remedy) from None
        return tuple(dict.fromkeys(found))


class Format(click.Choice[str]):
    """Type of the images; the long and short spellings of a suffix are the same."""

    def __init__(self) -> None:
        super().__init__(list(SUFFIXES))

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """The one name of a format."""
        return super().convert(FORMAT_ALIASES.get(value, value), param, ctx)


def refuse_kinds_with_blanks(args: Sequence[str]) -> None:
    """Refuse ``--outputs left right``, whose ``right`` click would take for the colour file."""
    for place, arg in enumerate(args):
        if arg != "--outputs" and not arg.startswith("--outputs="):
            continue
        _, equals, value = arg.partition("=")
        words = [value] * bool(equals) + list(args[place + 1 :])
        stray = takewhile(lambda w: w.strip(",") in KINDS and not Path(w).exists(), words[1:])
        kinds = [word.strip(",") for word in (*words[:1], *stray)]
        if len(kinds) > 1:
            problem = f"blanks separate {' '.join(kinds)}"
            raise UsageProblem("--outputs", problem, f"write commas, like {','.join(kinds)}")


class GroupedOption(click.Option):
    """An option that help shows under a heading."""

    def __init__(self, *args: Any, heading: str = "Options", **settings: Any) -> None:
        super().__init__(*args, **settings)
        self.heading = heading


class GroupedCommand(click.Command):
    """A command whose help shows its options under their headings, in order."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse; click forgets which command an option without its value belongs to."""
        refuse_kinds_with_blanks(args)
        try:
            return super().parse_args(ctx, args)
        except click.UsageError as error:
            error.ctx = error.ctx or ctx
            raise

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write one section for each heading."""
        sections: dict[str, list[tuple[str, str]]] = {}
        for param in self.get_params(ctx):
            record = param.get_help_record(ctx) if isinstance(param, click.Option) else None
            if record is not None:
                sections.setdefault(getattr(param, "heading", "Options"), []).append(record)
        for heading, records in sections.items():
            with formatter.section(heading):
                formatter.write_dl(records)


def grouped_option(heading: str, *names: str, **settings: Any) -> Decorator:
    """An option that help shows under a heading."""
    return click.option(*names, cls=GroupedOption, heading=heading, **settings)


def bundle(name: str, make: Callable[..., Any], options: Sequence[Decorator]) -> Decorator:
    """Add ``options`` to a command and hand it what ``make`` makes of their values, as ``name``."""

    def decorate(command: Command) -> Command:
        @functools.wraps(command)
        def call(*args: Any, **params: Any) -> Any:
            values = {key: params.pop(key) for key in keys}
            return command(*args, **{name: make(**values)}, **params)

        optioned: Any = call
        for option in reversed(options):
            optioned = option(optioned)
        keys = [param.name for param in optioned.__click_params__[-len(options) :]]
        return call

    return decorate
