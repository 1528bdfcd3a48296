"""Options that commands share, their types and headings, and their names in errors."""

from __future__ import annotations

import functools
import re
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from defocus_cli.words.console import Due, require_stdout
from defocus_core import gone
from defocus_core.errors import Place, UsageProblem
from defocus_core.request.quantities import byte_count, read_at

Command = Callable[..., Any]
Decorator = Callable[[Command], Command]


def option_name(param: click.Parameter | None) -> str:
    """The long name of an option, or the metavar of an argument, as a user writes it."""
    if isinstance(param, click.Option):
        return max(param.opts, key=len)
    return param.human_readable_name if param else "command line"


def position_of(param: click.Parameter | None) -> Place:
    """The place of an option or argument, for errors."""
    name = option_name(param)
    return Place(field=name[2:]) if name.startswith("--") else Place(name)


class FilePath(click.ParamType[Path]):
    """A path, which is not checked until it is opened."""

    name = "path"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """The path; an error if it is empty, as by a shell variable that is not set."""
        if not str(value):
            raise UsageProblem("empty", "is empty", "give a path", path=position_of(param))
        return Path(value)


class ReportPath(FilePath):
    """The path of a report. An error is raised before the work if it would replace another file."""

    def __init__(self, kind: str) -> None:
        self.kind = kind

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """The path; an error if it exists and is not an earlier report."""
        from defocus_core.io.write_files import require_replaceable
        from defocus_core.request.output_kinds import PICTURES

        path = super().convert(value, param, ctx)
        require_replaceable(path, self.kind)
        if path.suffix.lower() in PICTURES:
            problem = "is the name of a picture, not of a report"
            remedy = (
                f"end its name in .{({'junit': 'xml', 'markdown': 'md'}).get(self.kind, self.kind)}"
            )
            raise UsageProblem("malformed", problem, remedy, path=path)
        return path


class Words(click.Choice[str]):
    """Words to choose from."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The word; an error if it is unknown, which names the replacement of a removed word."""
        where = position_of(param)
        if value not in self.choices and (remedy := gone.remedy("value", value, where.field)):
            raise UsageProblem("unknown-name", f"'{value}' is not known", remedy, path=where)
        return super().convert(value, param, ctx)


class Quantity(click.ParamType[Any]):
    """A quantity with its unit, parsed by a function of `defocus_core.request.quantities`."""

    def __init__(self, parse: Callable[[str], Any], name: str) -> None:
        self.parse = parse
        self.name = name

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The parsed ``value``; a value that is no text is returned as it is."""
        return read_at(position_of(param), self.parse, value) if isinstance(value, str) else value


# The topics of help that explain the options under a heading
HEADING_TOPICS = {
    "Lens": ("look", "shots", "photo", "conventions"),
    "Shot": ("shots",),
    "Output": ("conventions", "batch"),
    "Files": ("depth", "photo", "conventions"),
    "Machine": ("quality", "batch"),
}
_MANY = 25  # greatest number of options that short help shows in full


class GroupedOption(click.Option):
    """An option that the help shows under a heading; the short help only if it is common."""

    def __init__(
        self, *args: Any, heading: str = "Options", is_common: bool = False, **settings: Any
    ) -> None:
        super().__init__(*args, **settings)
        self.heading = heading
        self.is_common = is_common or self.required or heading not in HEADING_TOPICS


class GroupedCommand(click.Command):
    """A command whose help shows its options under their headings, in order."""

    def __init__(self, *args: Any, **settings: Any) -> None:
        super().__init__(*args, **settings)
        if not any("--verbose" in param.opts for param in self.params):
            text = "Print the traceback of an unexpected error on stderr."
            flag = GroupedOption(["-v", "--verbose"], is_flag=True, expose_value=False, help=text)
            self.params.append(flag)
        is_long = len(self.params) > _MANY
        self._rare = {p for p in self.params if is_long and not getattr(p, "is_common", True)}
        text = "Show all options and exit."
        asking: dict[str, Any] = {"is_flag": True, "is_eager": True, "expose_value": False}
        asking |= {"hidden": not self._rare, "callback": self._show_all, "help": text}
        self.params.append(GroupedOption(["--help-all"], **asking))

    def _show_all(self, ctx: click.Context, _: click.Parameter, is_asked: bool) -> None:
        """Print the help with all options."""
        if is_asked and not ctx.resilient_parsing:
            ctx.meta["left_out"] = set()
            click.echo(ctx.get_help(), color=ctx.color)
            ctx.exit()

    def get_help(self, ctx: click.Context) -> str:
        """The help text; an error if stdout is closed."""
        require_stdout()
        return super().get_help(ctx)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse ``args``, and replace the values of each `bundle` by its object."""
        ctx.meta["typed"] = ["defocus", *ctx.command_path.split()[1:], *args]
        try:
            rest = super().parse_args(ctx, args)
        except click.UsageError as error:
            error.ctx = error.ctx or ctx  # click forgets it if a value is missing
            raise
        bundles = () if ctx.resilient_parsing else getattr(self.callback, "bundles", ())
        given = dict(ctx.params)
        for name, make, keys in bundles:
            given[name] = make(**{key: given.pop(key) for key in keys})
        ctx.params = given
        return rest

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options of each heading, and how many options are left out."""
        sections: dict[str, list[tuple[str, str]]] = {}
        rare = ctx.meta.get("left_out", self._rare)
        left_out = Counter(param.heading for param in rare)
        for param in self.get_params(ctx):
            if param in rare:
                continue
            record = param.get_help_record(ctx) if isinstance(param, click.Option) else None
            if record is not None:
                sections.setdefault(getattr(param, "heading", "Options"), []).append(record)
        for heading, records in sections.items():
            with formatter.section(heading):
                formatter.write_dl(records)
        more = [
            (heading, f"{count} more: {', '.join(f'defocus help {t}' for t in topics)}")
            for heading, topics in HEADING_TOPICS.items()
            if (count := left_out[heading])
        ]
        if more:
            with formatter.section(f"Further options, which {ctx.command_path} --help-all shows"):
                formatter.write_dl(more)


def option(
    spelling: str,
    text: str,
    kind: Any = None,
    *,
    into: str = "",
    heading: str = "Options",
    **settings: Any,
) -> Decorator:
    """An option that is spelled as in the help, like ``-o --out FILE``, under a heading.

    `kind` is a type, the words to choose from, or a parser of quantities; an option without a value
    is a flag. ``into`` is the name of the parameter, by default that of the option.
    """
    words = spelling.split()
    named = [word for word in words if re.match("--?[a-z]", word)]
    names = [*named, into] if into else named
    metavar = " ".join(words[len(named) :])
    if isinstance(kind, Sequence):
        kind = Words(kind)
    elif callable(kind) and not isinstance(kind, click.ParamType):
        kind = Quantity(kind, metavar)
    elif kind is None and not metavar:
        settings["is_flag"] = True
    settings |= {"type": kind, "metavar": metavar or None, "help": text}
    return click.option(*names, cls=GroupedOption, heading=heading, **settings)


files_option = functools.partial(option, heading="Files")
lens_option = functools.partial(option, heading="Lens")
machine_option = functools.partial(option, heading="Machine")
output_option = functools.partial(option, heading="Output")


def bundle(name: str, make: Callable[..., Any], options: Sequence[Decorator]) -> Decorator:
    """Add options to a command, which gets an object made from their values.

    The command gets ``make(**values)`` as its argument ``name``.
    """

    def decorate(command: Any) -> Command:
        for option in reversed(options):
            command = option(command)
        added = command.__click_params__[-len(options) :]
        keys = dict.fromkeys(param.name for param in added)  # two flags may set one value
        command.bundles = [(name, make, keys), *getattr(command, "bundles", ())]
        made: Command = command
        return made

    return decorate


def check_inputs_option(command: Command) -> Command:
    """Add ``--check-inputs`` to a command, which gets ``check_inputs``: stat or hash."""
    return machine_option(
        "--check-inputs",
        "How to see that an input of a finished picture changed, so that it is rendered again: "
        "stat compares size and time of the file, hash its content.",
        ["stat", "hash"],
        default="stat",
        show_default=True,
    )(command)


def json_option(command: Command) -> Command:
    """Add ``--json`` to a command, which gets ``as_json``."""
    text = "Print the result as one JSON document on stdout; 'defocus help json' lists its fields."
    return option("--json", text, into="as_json")(command)


def verbose_option(command: Command) -> Command:
    """Add ``--verbose`` and ``--quiet`` to a command, which gets ``verbose`` alone."""

    def be_quiet(ctx: click.Context, _: click.Parameter, value: bool) -> None:
        if value and ctx.params.get("verbose"):
            raise UsageProblem(
                "contradiction", "contradicts -v", "leave one of them out", field="quiet"
            )
        Due.quiet = value

    text = "Print only warnings and errors."
    quiet = option("-q --quiet", text, expose_value=False, callback=be_quiet)
    text = "Print more on stderr, such as how files were read."
    verbose = option("-v --verbose", text, is_eager=True)
    return verbose(quiet(command))


def contact_option(command: Command) -> Command:
    """Add ``--contact`` to a command, which gets ``contact``: a number of pictures, or None."""
    text = "Also write a sheet of N small pictures, OUT/contact.png."
    return output_option("--contact N", text, click.IntRange(min=1, max=400))(command)


def dataset_options(command: Command) -> Command:
    """Add ``--shards-size`` to a command, which gets ``shards_size`` in bytes, or None."""
    return option(
        "--shards-size SIZE",
        "At the end, pack the samples into WebDataset tar files of this size, like 1GB. Tar files "
        "of an earlier run are packed again only if their samples changed.",
        byte_count,
    )(command)
