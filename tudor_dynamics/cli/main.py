# Copyright 2026 tudor_dynamics contributors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
Entry point of ``tudor``: parse, run the subcommand, turn errors into exit codes.

A subcommand is a module or package of this one with ``EXAMPLES``, ``configure(parser)`` and
``run(args) -> int``; with ``DETAILS``, what ``-v`` prints, where there is more to say; with
``print_json`` of ``console``, where it has ``--json``. It is imported only when it is called, so
that ``tudor --help`` answers at once.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, ExitStack, redirect_stderr, redirect_stdout
import gc
from importlib import import_module
from itertools import groupby
import os
from pathlib import Path
import re
import shlex
import signal
import sys
import tempfile
import textwrap
import threading
from types import FrameType, ModuleType
from typing import Any, NoReturn
import warnings

# One BLAS thread: two on busy cores made a Gram matrix ninety times slower. Before numpy loads.
for _name in ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'):
    os.environ.setdefault(_name, '1')

from tudor_dynamics._version import __version__  # noqa: E402
from tudor_dynamics.errors import (  # noqa: E402
    ARGUMENT, complain, forget_output, meant, remedy_of, TudorError, TudorWarning)

GROUPS = {
    'begin': {
        'doctor': 'say whether this machine has what nodes and commands need',
    },
    'learn a model': {
        'info': 'say what is in a bag, what it is good for, what is wrong with it',
        'init': 'write the first description of an arm, from bags and URDF',
        'excite': 'plan the motion to record, and say what it will show',
        'fit': 'learn a dynamics model from bags',
        'fleet': 'fit many arms of one kind, and say which one differs',
    },
    'use it': {
        'evaluate': 'compare a model with bags it has not seen',
        'watch': 'show what a monitor sees, from a bag or from the topics of one that runs',
        'why': 'say why a monitor alarmed, from the bag that it wrote',
        'payload': 'say what the arm of a bag carries: mass, centre, inertia',
        'compare': 'put two models, or a model and a description, side by side',
        'export': 'write an identified arm as URDF, MJCF, or table',
        'feedforward': 'add to a trajectory the efforts that its motion needs',
        'shape': 'shape trajectories so that a tool or load does not keep vibrating',
        'tune': 'compute gains of damper and position loop, by load and pose',
    },
    'simulate an arm': {
        'record': 'let the simulated arm move in closed loop and record bags',
        'simulate': 'move rigid and flexible links, or list their vibrations',
    },
}
SUBCOMMANDS = {name: text for group in GROUPS.values() for name, text in group.items()}

OK, NOT_GOOD_ENOUGH, WRONG_INPUT, DEFECT = 0, 1, 2, 70
"""Exit codes; the last one, EX_SOFTWARE of sysexits.h, is for errors that nobody expected."""
RENAMED = {('tudor fit', '--force'): '--exit-zero',
           ('tudor simulate', '--plot'): '--pictures',
           ('tudor simulate', '--animate'): '--picture'}
"""Options that have another name since 1.0, by command."""
MEANT = {'--force': ('--overwrite',), '--plot': ('--picture', '--report'), '--roc': ('--report',),
         '--animate': ('--picture',), '--save': ('--out',), '--kind': ('--for',)}
"""Options that other commands had or have, and those in whose place they are looked for."""


class Parser(argparse.ArgumentParser):
    """Answers a wrong word with the word that was meant, in place of the whole usage."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Refuse unknown options before it is said that others are missing."""
        words = [part for word in (sys.argv[1:] if args is None else args) for part in (
            word.split('=', 1) if word.startswith(('--arm=', '--model=')) else [word])]
        bare = {action.dest for action in self._actions if not action.option_strings}
        if 'one' in bare:  # A and B of tudor compare, each an arm or a model
            words = [word for word in words if word not in ('--arm', '--model')]
        for name in ('arm', 'model'):  # --arm and --model work where a bare word names them, too
            if f'--{name}' in words[:-1] and name in bare:
                place = words.index(f'--{name}')
                words = [words[place + 1], *words[:place], *words[place + 2:]]
        for place, word in enumerate(words):
            old, *value = word.split('=', 1)
            if new := RENAMED.get((self.prog, old)):
                warnings.warn(f'{old} is now {new}; version 1.2 removes the old name',
                              TudorWarning, stacklevel=2)
                words[place] = '='.join((new, *value))
        for word in words:
            name = word.partition('=')[0]
            if name.startswith('--') and len(name) > 2 and self.prog != 'tudor' and not any(
                    option.startswith(name) for option in self._option_string_actions):
                known = self._option_string_actions
                self.error(f'there is no option {name}' + next((
                    f' (did you mean {new}?)' for new in MEANT.get(name, ()) if new in known),
                    meant(name, known)))
        return super().parse_known_args(words, namespace)

    def error(self, message: str) -> NoReturn:
        """Say in one line what is wrong, and where help is."""
        found = re.search(r"argument (.*): invalid choice: '(.*?)' \(choose from (.*)\)", message)
        if found:
            choices = found[3].replace("'", '')
            message = f'{found[1]} {found[2]}: choose from {choices}' + meant(
                found[2], choices.split(', '))
        complain(f'{self.prog}: {message.removeprefix("argument ")}; see {self.prog} --help')
        self.exit(WRONG_INPUT)


class Help(argparse.RawDescriptionHelpFormatter):
    """Wraps sentences and, after eight blanks, explanations; commands and tables stay."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        return '\n'.join(
            '\n'.join(lines) if not words or 0 < len(blanks) < 8 else textwrap.fill(
                ' '.join(' '.join(lines).split()), width, initial_indent=blanks,
                subsequent_indent=blanks, break_on_hyphens=False)
            for (blanks, words), lines in groupby(text.splitlines(), lambda line: (
                line[:len(line) - len(line.lstrip())], bool(line))))


def build_parser(only: str | None = None) -> argparse.ArgumentParser:
    """Build the parser."""
    listed = '\n\n'.join(f'{title}:\n' + '\n'.join(
        f'  {name:12} {text}' for name, text in group.items()) for title, group in GROUPS.items())
    parser = Parser(
        prog='tudor', usage='tudor COMMAND ...',
        formatter_class=Help,
        description='Dynamics of lightweight and elastic robot arms, learned from rosbags.\n\n'
                    + listed,
        epilog='Begin with `tudor init BAG --urdf FILE --out arm.yaml`. The help of each command\n'
               'has examples: `tudor fit --help`. Exit codes: 0 done, 1 data or model not good\n'
               f'enough, 2 wrong input, {DEFECT} a defect of tudor (--debug FILE keeps what\n'
               'a report of it needs), 130 interrupted. For completion by TAB in a shell:\n'
               '  eval "$(register-python-argcomplete tudor)"')
    parser.add_argument('--version', action='version', version=f'tudor_dynamics {__version__}')
    commands = parser.add_subparsers(dest='command', metavar='COMMAND', required=True,
                                     prog='tudor', help=argparse.SUPPRESS)
    for name, summary in SUBCOMMANDS.items():
        sub = commands.add_parser(
            name, description=summary[0].upper() + summary[1:] + '.',
            formatter_class=Help)
        if only == name:
            module = _subcommand(name)
            sub.epilog = module.EXAMPLES
            module.configure(sub)
            if hasattr(module, 'print_json'):
                sub.add_argument('--json', action='store_true', help='print one JSON object')
            loud = sub.add_mutually_exclusive_group()
            if hasattr(module, 'DETAILS'):
                loud.add_argument('-v', '--verbose', action='store_true', help=module.DETAILS)
            loud.add_argument('-q', '--quiet', action='store_true',
                              help='print errors alone, and with --json the object')
            sub.add_argument('--debug', metavar='FILE', help='write what a bug report needs: '
                             'versions, call, output, traceback, descriptions, what bags hold')
    return parser


def _with_options(text: str, only: str | None) -> str:
    """Write the arguments of the library in an error as options."""
    commands: Any = build_parser(only)._actions[-1].choices
    known = commands[only]._option_string_actions if only else {}
    return ARGUMENT.sub(lambda found: option if (
        option := f'--{found[1].replace("_", "-")}') in known else found[1], text)


def _subcommand(name: str) -> ModuleType:
    """Import a subcommand; what comes with it stays, and is not searched for garbage."""
    path = f'tudor_dynamics.cli.{name.replace("-", "_")}'
    if path in sys.modules or not gc.isenabled():
        return import_module(path)
    gc.disable()  # the searches would take a sixth of the time of `tudor evaluate`
    try:
        return import_module(path)
    finally:
        gc.freeze()
        gc.enable()


def _show_warning(message: Warning | str, category: type[Warning], *_: object) -> None:
    label = 'warning' if issubclass(category, TudorWarning) else category.__name__
    complain(f'{label}: {message}')


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``tudor``; argv: those of the process by default."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    completing = '_ARGCOMPLETE' in os.environ  # a shell asks what may come next
    words = os.environ.get('COMP_LINE', '').split() if completing else arguments
    only = next((word for word in words if word in SUBCOMMANDS), None)
    if completing:
        import argcomplete  # of no use otherwise
        argcomplete.autocomplete(build_parser(only))
    name = f'tudor {only}' if only else 'tudor'
    _open_standard_streams()
    with warnings.catch_warnings(), _interrupts_kept() as interrupted:
        warnings.showwarning = _show_warning  # type: ignore[assignment]
        warnings.simplefilter('default', TudorWarning)
        try:
            # parsing loads the subcommand's modules, which takes half a second
            code = _run(build_parser(only).parse_args(arguments), arguments)
            sys.stdout.flush()  # a reader that has gone is noticed here, not at exit
            return code
        except TudorError as err:
            complain(f'{name}: {_with_options(str(err), only)}')
            return WRONG_INPUT
        except BrokenPipeError:
            forget_output()
            return OK
        except OSError as err:
            place = f'{err.filename}: ' if err.filename else ''
            complain(f'{name}: {place}{err.strerror or err}; {remedy_of(err)}')
            try:
                sys.stdout.flush()
            except OSError:
                forget_output()
            return WRONG_INPUT
        except MemoryError as err:
            complain(f'{name}: not enough memory{f" ({err})" * bool(str(err))}; give fewer '
                     'or shorter bags, lower the sample rate, or use a machine with more memory')
            return WRONG_INPUT
        except KeyboardInterrupt:
            return _interrupted(name)
        except Exception as err:
            if interrupted.is_set():  # a library has made another error of it
                return _interrupted(name)
            what = f'{type(err).__name__}: {" ".join(str(err).split())[:120]}'
            complain(f'{name}: tudor has a defect ({what}); to report it, as docs/howto/'
                     f'report_a_bug.md says, {_traceback_file(arguments)}')
            return DEFECT


def _run(args: argparse.Namespace, arguments: Sequence[str]) -> int:
    """Run a subcommand, as loud as it was asked for, and recorded for a bug report."""
    args.call = shlex.join(('tudor', *arguments))
    with ExitStack() as muted:
        if args.quiet:
            nowhere = muted.enter_context(open(os.devnull, 'w'))
            muted.enter_context(redirect_stderr(nowhere))
            if not getattr(args, 'json', False):
                muted.enter_context(redirect_stdout(nowhere))
        run = _subcommand(args.command).run
        if args.debug is None:
            return int(run(args))
        from tudor_dynamics.cli.doctor import recorded  # of no use otherwise
        return int(recorded(Path(args.debug), arguments, lambda: run(args)))


@contextmanager
def _interrupts_kept() -> Iterator[threading.Event]:
    """Note interrupts, and repeat one that a callback of C swallows, as those of numba do."""
    report, handler, seen = sys.unraisablehook, signal.getsignal(signal.SIGINT), threading.Event()

    def again(lost: sys.UnraisableHookArgs) -> None:
        if not isinstance(lost.exc_value, KeyboardInterrupt):
            return report(lost)
        main = threading.main_thread().ident
        # a signal, as `_thread.interrupt_main` lets a system call wait on
        timer = threading.Timer(0.02, signal.pthread_kill, (main, signal.SIGINT))
        timer.daemon = True
        timer.start()

    def interrupt(number: int, frame: FrameType | None) -> None:
        seen.set()
        raise KeyboardInterrupt

    sys.unraisablehook = again
    # elsewhere it is ignored, or somebody else's
    ours = handler is signal.default_int_handler and (
        threading.current_thread() is threading.main_thread())
    if ours:
        signal.signal(signal.SIGINT, interrupt)
    try:
        yield seen
    finally:
        sys.unraisablehook = report
        if ours:
            signal.signal(signal.SIGINT, handler)


def _interrupted(name: str) -> int:
    complain(f'{name}: interrupted')
    if any(not item.daemon for item in threading.enumerate()[1:]):
        os._exit(130)  # nobody waits for what threads compute
    return 130


def _traceback_file(arguments: Sequence[str]) -> str:
    """Write what a report of a defect needs, and say where."""
    from tudor_dynamics.cli.doctor import report
    try:
        number, path = tempfile.mkstemp('.txt', 'tudor_defect_')
        with open(number, 'w', encoding='utf-8', errors='replace') as file:
            file.write(report(arguments))
    except OSError as err:
        return (f'run the command again with --debug FILE and send FILE (none could be written '
                f'in the folder {tempfile.gettempdir()!r}: {err.strerror})')
    return f'send {path}'


def _open_standard_streams() -> None:
    """Let closed standard streams lead nowhere; the next file opened would take their place."""
    for number, stream in enumerate(('stdin', 'stdout', 'stderr')):
        try:
            os.fstat(number)
        except OSError:
            opened = os.open(os.devnull, os.O_RDWR)
            if opened != number:
                os.dup2(opened, number)
                os.close(opened)
        if getattr(sys, stream) is None:
            setattr(sys, stream, open(number, 'r' if number == 0 else 'w', encoding='utf-8',
                                      closefd=False))


if __name__ == '__main__':
    sys.exit(main())
