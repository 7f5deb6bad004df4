"""The entry of the command line: ``beltrami COMMAND FILE... [options] -o OUT``; the commands are in :mod:`beltrami.commands`."""

from __future__ import annotations

import argparse
import re
import sys
import warnings
from collections.abc import Sequence
from typing import Any, NoReturn

import beltrami as bt

from . import arrays
from .commands import BAD_INPUT, COMMANDS, DONE, NOT_CONVERGED, load_commands
from .errors import ConvergenceError, Error


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"{self.prog}: {message}; {self.prog} --help lists what there is\n")


def _warning(message: Warning | str, *where: Any, **more: Any) -> None:
    print(f"note: {message}", file=sys.stderr)


def parser() -> argparse.ArgumentParser:
    """The parser with all commands."""
    top = _Parser(
        prog="beltrami", description="Intrinsic computing on triangle meshes and point clouds.",
        epilog="Exit codes: 0 done, 1 not converged (the answer is still written), 2 bad input.",
    )  # fmt: skip
    top.add_argument("--version", action="version", version=f"beltrami {bt.__version__}")
    commands = top.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, entry in load_commands().items():
        one = commands.add_parser(
            name, help=entry.summary, description=entry.summary[:1].upper() + entry.summary[1:] + ".", epilog="Defaults are in parentheses."
        )
        one.add_argument("--threads", metavar="K", type=int, help="how many threads to use")
        entry.declare(one)
    return top


def _in_flags(message: str, options: argparse.Namespace) -> str:
    """The message with options as this command spells them: the library's ``fill_holes=True`` is ``--fill-holes`` here."""

    def flag(found: re.Match[str]) -> str:
        name = found[1] if found[2] == "True" else f"no_{found[1]}"
        return f"--{name.replace('_', '-')}" if hasattr(options, name) else found[0]

    return re.sub(r"\b(\w+)=(True|False)\b", flag, message)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command; the exit code."""
    try:
        options = parser().parse_args(arguments)
    except SystemExit as leaving:  # argparse has said why
        return int(leaving.code or 0)
    try:
        if options.threads is not None:
            bt.set_num_threads(arrays.whole(options.threads, "--threads", 1, 4096))
        with warnings.catch_warnings():
            warnings.showwarning = _warning
            return COMMANDS[options.command].run(options)
    except ConvergenceError as error:
        print(f"beltrami {options.command}: not converged: {error}", file=sys.stderr)
        return NOT_CONVERGED
    except Error as error:
        print(f"beltrami {options.command}: {_in_flags(' '.join(str(error).split()), options)}", file=sys.stderr)
        return BAD_INPUT
    except BrokenPipeError:  # whoever read the table has seen enough
        sys.stderr.close()
        return DONE
    except KeyboardInterrupt:
        print(f"beltrami {options.command}: stopped", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
