"""Commands whose help shows options under headings."""

from __future__ import annotations

from typing import Any

import click

from defocus_cli.option_types import refuse_kinds_with_blanks


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
