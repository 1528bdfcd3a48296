"""The ``defocus`` command: finds the subcommand, and reports errors in one line.

Exit codes: 0 done; 1 some of a batch failed, or defocus itself has a fault; 2 wrong usage; 3 a file
cannot be read or written; 130 interrupted by Ctrl-C; 141 the program that reads the output has
ended, as after ``| head``; 143 ended by SIGTERM; 129 ended by SIGHUP.
"""

from __future__ import annotations

import importlib
import os
import sys
import traceback
from collections.abc import Sequence
from contextlib import suppress
from errno import ENOSPC
from typing import Any

import click

from defocus_cli.options.shared import option, option_name
from defocus_cli.words.console import (
    Due,
    Interrupted,
    exit_code_of,
    log_to_stderr,
    print_json,
    require_stdout,
    write_stderr,
)
from defocus_core import gone
from defocus_core.errors import (
    DefocusError,
    UsageProblem,
    did_you_mean,
    lacks_memory,
    one_line,
    reason,
    with_dashes,
)
from defocus_core.system.process import Terminated, delayed_signals, terminations
from defocus_core.system.text import back_words, versions

# The commands in the order of help, with a description, so that help need not import them.
COMMANDS = {
    "render": "Defocus pictures, given their colour and depth.",
    "batch": "Render many pictures with many lenses, as a jobs file lists them.",
    "status": "Show the progress of a batch, and why jobs failed.",
    "merge": "Merge the journals of a batch that ran in shards.",
    "choose": "Write an HTML page on which you choose focus and blur.",
    "info": "Show the content of files: size, channels, depth range.",
    "depth": "Convert depth files of any format to EXR in planar metres.",
    "aperture": "Draw the aperture of a lens and the blur of a point.",
    "lenses": "List the lens files that come with defocus, or draw their blur.",
    "fit": "Find the lens that turns a sharp picture into a blurred one.",
    "compare": "Compare pictures, and name the cause where they differ.",
    "bench": "Measure error and time on scenes with known truth.",
    "verify": "Check on this machine that pictures obey the laws of a lens.",
    "help": "Print the reference on a topic, or list the topics.",
}


class Interruptible(click.Context):
    """A context of click that Ctrl-C ends without printing an empty line."""

    def __exit__(self, kind: type[BaseException] | None, *of: Any) -> None:
        super().__exit__(kind, *of)
        if kind is KeyboardInterrupt:
            raise Interrupted("interrupted; pictures that were finished are kept") from None


class LazyGroup(click.Group):
    """The commands: modules of ``defocus_cli.commands``, each imported when it is used."""

    context_class = Interruptible

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of the commands, in the order of help."""
        return list(COMMANDS)

    def get_help(self, ctx: click.Context) -> str:
        """The help text.

        Raises:
            InputError: stdout is closed.
        """
        require_stdout()
        return super().get_help(ctx)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands, one line each."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of that name; None if there is none."""
        if cmd_name not in COMMANDS:
            return None
        with delayed_signals():
            module = importlib.import_module(f"defocus_cli.commands.{cmd_name}")
        command: click.Command = module.command
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The name of the command at the start of ``args``, the command, and the other words."""
        if args[0] not in COMMANDS:
            remedy = did_you_mean(args[0], tuple(COMMANDS), "see 'defocus --help'")
            remedy = gone.remedy("command", args[0], otherwise=remedy)
            raise UsageProblem("unknown-name", "no such command", remedy, path=args[0])
        return super().resolve_command(ctx, args)


@click.group(
    cls=LazyGroup,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)
@option("--version", "Print the versions of defocus, its renderer and Numba.", into="wants_version")
@click.pass_context
def cli(ctx: click.Context, wants_version: bool) -> None:
    """Defocus sharp pictures as a lens would, by the depth of each pixel.

    \b
    Examples:
      defocus render photo.png depth.png -o out --focal-length 50mm --fnumber 1.4 --focus 2m
      defocus info scene.exr
    """  # noqa: D301  click reads the backspace
    if wants_version:
        require_stdout()
        click.echo(f"defocus {versions()}")
        click.echo(f"on a CPU {back_words()}")
        ctx.exit()
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help())


def main(args: Sequence[str] | None = None) -> int:
    """Run the command line ``args`` (default: the process's own) and return the exit code."""
    args = list(sys.argv[1:] if args is None else args)
    Due.json, Due.quiet, Due.keys = "--json" in args, False, {}
    # NumPy multiplies only small matrices here, which threads that wait make slower
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    log_to_stderr()
    try:
        with terminations():
            code = cli.main(args, prog_name="defocus", standalone_mode=False)
    except (click.Abort, KeyboardInterrupt):  # before a command ran
        return _fail("interrupted", Interrupted.exit_code)
    except Terminated as ended:
        line = f"ended by {ended.signal_name}; pictures that were finished are kept"
        return _fail(line, 128 + ended.number)
    except DefocusError as error:
        return _fail(str(error), exit_code_of(error), error.code)
    except click.ClickException as error:
        return _fail(error_line(error), error.exit_code)
    except SystemExit as ended:  # click's answer to a broken pipe, or to a shell that completes
        return 0 if ended.code == 0 else 141  # as if by SIGPIPE, which Python ignores
    except OSError as error:
        remedy = (
            "free some space" if error.errno == ENOSPC else "check the path and its permissions"
        )
        return _fail(one_line(f"{error.filename or 'system'}: {reason(error)}; {remedy}"), 3)
    except Exception as error:
        if {"-v", "--verbose"} & set(args):
            traceback.print_exc()
        if lacks_memory(error):
            problem = f"the system gives no more memory: {reason(error)}"
            remedy = "close other programs, or raise the limit, as 'ulimit -v unlimited' does"
            return _fail(one_line(f"memory: {problem}; {remedy}"), 3, "out-of-memory")
        problem = f"unexpected {type(error).__name__}: {reason(error)}"
        return _fail(f"{problem}; please report it, with what -v says", 1)
    return code if isinstance(code, int) else 0


def error_line(error: click.ClickException) -> str:
    """A click error in the form ``SUBJECT: problem; remedy``."""
    if not isinstance(error, click.UsageError):
        return one_line(error.format_message())
    remedy = f"see '{error.ctx.command_path if error.ctx else 'defocus'} --help'"
    subject, problem = "command line", one_line(error.message).rstrip(".")
    if isinstance(error, click.NoSuchOption):
        subject, problem = error.option_name, "no such option"
        if error.possibilities:
            remedy = f"did you mean {' or '.join(sorted(error.possibilities))}?"
        if error.ctx is not None and error.ctx.info_name == "batch":
            from defocus_core.request.jobs_file import KEYS

            table, _, key = KEYS.get(subject.removeprefix("--"), "").partition(" ")
            remedy = f"write {key} below {table} of the jobs file" if table else remedy
        command = error.ctx.info_name if error.ctx else None
        remedy = gone.remedy("option", subject.lstrip("-"), command or "", remedy)
    elif isinstance(error, click.BadParameter):
        subject = option_name(error.param)
        if isinstance(error, click.MissingParameter):
            problem = "is missing"
            if isinstance(error.param, click.Option) and error.param.metavar:
                remedy = f"add {error.param.opts[0]} {error.param.metavar}"
    elif isinstance(error, click.BadOptionUsage):
        subject = error.option_name
        problem = problem.removeprefix(f"Option '{subject}' ")
    return f"{subject}: {problem}; {remedy}"


def _fail(line: str, exit_code: int, code: str | None = None) -> int:
    """Print why a command failed on stderr and, with ``--json``, as a document on stdout."""
    line = with_dashes(line, Due.keys)
    try:
        write_stderr(f"defocus: {line}")
    except OSError:  # a full disk, or a limit on file sizes
        if not Due.json:
            with suppress(OSError):
                click.echo(f"defocus: {line}")
    if Due.json:
        with suppress(OSError, DefocusError):  # nobody reads stdout, or it cannot be written
            print_json(error={"message": line, "exit_code": exit_code, "code": code})
    return exit_code


if __name__ == "__main__":
    sys.exit(main())
