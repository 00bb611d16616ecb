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

"""Entry point of the command: exit codes, one line for a user's mistake, help."""

from __future__ import annotations

import os
from pathlib import Path
import signal
import subprocess
import sys
from types import SimpleNamespace
from typing import Any
import warnings

import pytest

from tudor_dynamics._version import __version__
from tudor_dynamics.cli import main as entry
from tudor_dynamics.errors import BagError, TudorError, TudorWarning
from tudor_dynamics.models.bundle import load_bundle


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Put a subcommand in place of ``evaluate``; its run does what the test says."""
    module = SimpleNamespace(
        EXAMPLES='examples:\n  tudor evaluate bag',
        configure=lambda parser: parser.add_argument('bags', nargs='*'), run=lambda args: 0)
    monkeypatch.setattr(entry, 'import_module', lambda name: module)
    return module


@pytest.mark.parametrize('code', [0, 1, 2])
def test_exit_code_of_the_subcommand(command: Any, code: int) -> None:
    """What the subcommand returns is the exit code."""
    command.run = lambda args: code
    assert entry.main(['evaluate', 'bag']) == code


def _raise(err: BaseException) -> Any:
    def run(args: Any) -> int:
        raise err
    return run


@pytest.mark.parametrize(('err', 'code', 'line'), [
    (BagError('run1: not a bag; give .mcap'), 2, 'tudor evaluate: run1: not a bag; give .mcap'),
    (TudorError('run1: is empty;\n   give another bag'), 2,
     'tudor evaluate: run1: is empty; give another bag'),
    (PermissionError(13, 'Permission denied', '/x/y'), 2,
     'tudor evaluate: /x/y: Permission denied; change the rights of the file or folder, or give '
     'another path'),
    (OSError(5, 'Input/output error', 'run1'), 2,
     'tudor evaluate: run1: Input/output error; check path, rights and disk'),
    (MemoryError(), 2, 'tudor evaluate: not enough memory; give fewer or shorter bags, lower '
     'the sample rate, or use a machine with more memory'),
    (MemoryError('for 37 GiB'), 2, 'tudor evaluate: not enough memory (for 37 GiB); give fewer or '
     'shorter bags, lower the sample rate, or use a machine with more memory'),
    (KeyboardInterrupt(), 130, 'tudor evaluate: interrupted')])
def test_errors_are_one_line(
    command: Any, capsys: pytest.CaptureFixture[str], err: BaseException, code: int, line: str,
) -> None:
    """A user's mistake is one line on standard error and nothing on standard output."""
    command.run = _raise(err)
    assert entry.main(['evaluate']) == code
    assert capsys.readouterr() == ('', f'{line}\n')


@pytest.mark.parametrize('err', [ZeroDivisionError('a\n\x1b[2Jb'), RecursionError(
    'x' * 9000), KeyError('k')])
def test_mistakes_of_ours_are_one_line_and_a_file(
    command: Any, capsys: pytest.CaptureFixture[str], tmp_path: Path, err: Exception,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """An error that nobody raised on purpose leaves its traceback in a file to report."""
    command.run = _raise(err)
    monkeypatch.setattr(entry.tempfile, 'tempdir', str(tmp_path))
    assert entry.main(['evaluate', 'bag']) == 70
    out, line = capsys.readouterr()
    assert out == '' and line.count('\n') == 1 and line[:-1].isprintable() and len(line) < 600
    assert line.startswith(f'tudor evaluate: tudor has a defect ({type(err).__name__}: ')
    file, = tmp_path.iterdir()
    assert line.endswith('); to report it, as docs/howto/'
                         f'report_a_bug.md says, send {file}\n')
    text = file.read_text()
    assert 'call: tudor evaluate bag' in text and 'Traceback' in text and __version__ in text
    monkeypatch.setattr(entry.tempfile, 'tempdir', str(tmp_path / 'gone'))
    assert entry.main(['evaluate']) == 70
    assert ('run the command again with --debug FILE and send FILE (none could be written '
            f"in the folder '{tmp_path / 'gone'}': No such file" in capsys.readouterr().err)


@pytest.mark.parametrize(('err', 'code', 'ended'), [
    (None, 1, 'exit code: 1, after '), (BagError('run1: no such bag'), 2, 'ended by the error'),
    (ZeroDivisionError('a'), 70, 'ended by the error')])
def test_one_file_for_a_bug_report(
    command: Any, capsys: pytest.CaptureFixture[str], tmp_path: Path, err: Exception | None,
    code: int, ended: str, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Versions, call, output, traceback and descriptions, however the command ends."""
    def run(args: Any) -> int:
        print('a table')
        print('warning: a line', file=sys.stderr)
        if err is not None:
            raise err
        return 1
    command.run = run
    monkeypatch.setattr(entry.tempfile, 'tempdir', str(tmp_path))
    (tmp_path / 'arm.yaml').write_text('name: my arm\n')
    kept = tmp_path / 'debug.txt'
    assert entry.main(['evaluate', str(tmp_path / 'arm.yaml'), '--debug', str(kept)]) == code
    shown, text = capsys.readouterr(), kept.read_text()
    assert shown.out == 'a table\n' and shown.err.startswith('warning: a line\n')
    assert ended in text and 'a table\nwarning: a line\n' in text and __version__ in text
    assert f'call: tudor evaluate {tmp_path}' in text and 'name: my arm' in text
    assert ('Traceback' in text) == (err is not None)
    assert entry.main(['evaluate', '--debug', str(tmp_path)]) == 2  # a folder


def test_a_bug_report_holds_model_and_bags(
    root: Path, model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What a bundle is and was made by, the description in it, and what is in the bags."""
    monkeypatch.chdir(root)
    bag = 'bags/two_blade_test@0-50%'
    assert entry.main(['evaluate', bag, '--model', str(model), '--debug',
                       str(tmp_path / 'debug.txt')]) in (0, 1)
    text = (tmp_path / 'debug.txt').read_text()
    assert load_bundle(model).digest in text and 'made:' in text
    assert (model / 'arm.yaml').read_text() in text
    assert f'{bag}:\n{{' in text and '"checksum": "' in text and '/motor_currents' in text


@pytest.mark.parametrize(('words', 'out'), [(['-q'], ''), (['-q', '--json'], '{}\n')])
def test_quiet(command: Any, capsys: pytest.CaptureFixture[str], words: list[str],
               out: str) -> None:
    """Errors alone, and the object that was asked for."""
    def configure(parser: Any) -> None:
        parser.add_argument('--json', action='store_true')

    def run(args: Any) -> int:
        print('{}')
        warnings.warn('run1: 3 samples dropped', TudorWarning, stacklevel=1)
        raise BagError('run1: no such bag')
    command.configure, command.run = configure, run
    assert entry.main(['evaluate', *words]) == 2
    assert capsys.readouterr() == (out, 'tudor evaluate: run1: no such bag\n')


def test_warnings_are_lines(command: Any, capsys: pytest.CaptureFixture[str]) -> None:
    """Warnings about data come as lines without a place in the code: each once, in every run."""
    def run(args: Any) -> int:
        for bag in ('run1', 'run2', 'run1'):
            warnings.warn(f'{bag}: 3 samples dropped', TudorWarning, stacklevel=1)
        return 0
    command.run = run
    for _ in range(2):
        assert entry.main(['evaluate']) == 0
        assert capsys.readouterr().err == ''.join(
            f'warning: {bag}: 3 samples dropped\n' for bag in ('run1', 'run2'))


def test_help_lists_all_commands(capsys: pytest.CaptureFixture[str]) -> None:
    """The help names every command with what it does, and the exit codes."""
    with pytest.raises(SystemExit) as caught:
        entry.main(['--help'])
    assert caught.value.code == 0
    shown = ' '.join(capsys.readouterr().out.split())
    for name, summary in entry.SUBCOMMANDS.items():
        assert f'{name} {summary}' in shown
    assert 'Exit codes: 0 done, 1 data or model not good enough, 2 wrong input, 70' in shown


def test_help_of_a_command(capsys: pytest.CaptureFixture[str]) -> None:
    """The help of a command has examples."""
    with pytest.raises(SystemExit) as caught:
        entry.main(['evaluate', '--help'])
    assert caught.value.code == 0
    assert 'examples:\n  tudor evaluate --model model run4' in capsys.readouterr().out


@pytest.mark.parametrize('command', sorted(entry.SUBCOMMANDS))
def test_help_fits_into_80_columns(
    command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
) -> None:
    """No line of any help is longer; commands that go on end with a backslash."""
    monkeypatch.setenv('COLUMNS', '80')
    with pytest.raises(SystemExit):
        entry.main([command, '--help'])
    lines = capsys.readouterr().out.splitlines()
    assert 'examples:' in lines and max(map(len, lines)) <= 80


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    """The version is the package's."""
    with pytest.raises(SystemExit):
        entry.main(['--version'])
    assert capsys.readouterr().out == f'tudor_dynamics {__version__}\n'


@pytest.mark.parametrize(('arguments', 'command', 'meant'), [
    ([], '', 'required: COMMAND;'), (['dance'], '', 'COMMAND dance: choose from doctor'),
    (['evaluat', 'bag'], '', '(did you mean evaluate?)'),
    (['evaluate', '--jsn', 'bag'], ' evaluate', 'there is no option --jsn (did you mean --json?)'),
    (['evaluate', 'bag'], ' evaluate', 'required: --model;'),
    (['fit', 'bag', '--arm', 'a', '--out', 'b', '--models', 'elastik'], ' fit', 'mean elastic?')])
def test_wrong_arguments(
    arguments: list[str], command: str, meant: str, capsys: pytest.CaptureFixture[str],
) -> None:
    """A wrong or missing word ends with exit code 2, and one line says what was meant."""
    with pytest.raises(SystemExit) as caught:
        entry.main(arguments)
    assert caught.value.code == 2
    said = capsys.readouterr().err
    assert said.count('\n') == 1 and f'see tudor{command} --help' in said and meant in said


def test_missing_model(capsys: pytest.CaptureFixture[str]) -> None:
    """A model that is not there is named on one line."""
    assert entry.main(['evaluate', '--model', 'no/where', 'bag']) == 2
    err = capsys.readouterr().err
    assert err == ('tudor evaluate: no/where: no such folder; give the folder that tudor fit '
                   'wrote\n')


def test_reader_that_has_gone() -> None:
    """``tudor ... | head`` ends quietly, be the output short or long."""
    buffered = {key: value for key, value in os.environ.items() if key != 'PYTHONUNBUFFERED'}
    for size in (10, 1_000_000):
        code = (
            'import sys, types, tudor_dynamics.cli.main as m\n'
            'sys.stdin.read()\n'  # until the reader has gone
            'm.import_module = lambda name: types.SimpleNamespace(EXAMPLES="",\n'
            f'    configure=lambda p: None, run=lambda a: print("x" * {size}) or 0)\n'
            'sys.exit(m.main(["evaluate"]))\n')
        process = subprocess.Popen([sys.executable, '-c', code], stdin=subprocess.PIPE,
                                   stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                                   env=buffered)
        assert process.stdout is not None and process.stdin is not None
        process.stdout.close()
        process.stdin.close()
        assert process.stderr is not None
        assert process.stderr.read() == b''
        process.stderr.close()
        assert process.wait(30) == 0


def _slow_module() -> str:
    """Give a program whose subcommand takes long to load, and says when it has begun."""
    return ('import sys, time, tudor_dynamics.cli.main as m\n'
            'def load(name):\n'
            '    print("loading", flush=True)\n'
            '    time.sleep(60)\n'
            'm.import_module = load\n'
            'sys.exit(m.main(["evaluate", "x"]))\n')


def test_interrupt_while_modules_load() -> None:
    """Ctrl-C before the subcommand is even there is one line, too."""
    process = subprocess.Popen(
        [sys.executable, '-c', _slow_module()], text=True, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,  # who runs tests in the background may ignore the signal
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL))
    assert process.stdout is not None and process.stderr is not None
    assert process.stdout.readline() == 'loading\n'
    process.send_signal(signal.SIGINT)
    assert process.communicate()[1] == 'tudor evaluate: interrupted\n'
    assert process.returncode == 130


def test_an_interrupt_that_a_library_makes_another_error_of(
    command: Any, capsys: pytest.CaptureFixture[str],
) -> None:
    """Compilers and loaders of modules keep nothing of it but its text, or less."""
    def run(args: Any) -> int:
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            pass
        raise SystemError('initialization failed without raising an exception')
    command.run = run
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # workers may ignore it
    try:
        assert entry.main(['evaluate']) == 130
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
    assert capsys.readouterr() == ('', 'tudor evaluate: interrupted\n')


@pytest.mark.parametrize('closed', ['>&-', '2>&-', '<&-', '<&- >&- 2>&-'])
def test_closed_streams(closed: str, root: Path) -> None:
    """Where nobody listens the work is done all the same, and no file takes a stream's place."""
    info = f'"{sys.executable}" -m tudor_dynamics info bags/two_blade_test --json {closed}'
    first = ('import os, tudor_dynamics.cli.main as m; m._open_standard_streams(); '
             'os._exit(os.open(os.sep, 0) < 3)')
    for command in (info, f'"{sys.executable}" -c "{first}" {closed}'):
        shell = subprocess.run(['sh', '-c', command], cwd=root, check=False, text=True,
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        assert (shell.returncode, shell.stderr) == (0, '')


@pytest.mark.skipif(not Path('/dev/full').exists(), reason='no /dev/full here')
def test_full_output(root: Path) -> None:
    """Output to a full disk is one line and exit code 2, also at exit."""
    with open('/dev/full', 'w', encoding='utf-8') as full:
        done = subprocess.run(
            [sys.executable, '-m', 'tudor_dynamics', 'info', 'bags/two_blade_test'], cwd=root,
            stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr == 'tudor info: No space left on device; free some space\n'


@pytest.mark.parametrize(('command', 'slow'), [
    ('evaluate', {'scipy.signal', 'scipy.optimize', 'scipy.interpolate', 'scipy.stats',
                  'matplotlib', 'jinja2', 'joblib'}),
    ('fit', {'scipy.signal', 'scipy.interpolate', 'scipy.stats', 'matplotlib', 'jinja2'})])
def test_commands_begin_lean(command: str, slow: set[str]) -> None:
    """A command imports no library before it is needed that takes a tenth of a second, or more."""
    code = (f'import sys, tudor_dynamics.cli.main as entry; entry.build_parser({command!r}); '
            'print(*sys.modules)')
    done = subprocess.run([sys.executable, '-c', code], check=True, text=True,
                          stdout=subprocess.PIPE)
    loaded = set(done.stdout.split())
    assert f'tudor_dynamics.cli.{command}' in loaded
    assert not loaded & slow


@pytest.mark.parametrize(('typed', 'answers'), [
    ('tudor fi', {'fit'}), ('tudor fit --mod', {'--models'}),
    ('tudor shape path.csv --by ', {'zv', 'zvd', 'timing'})])
def test_a_shell_completes(typed: str, answers: set[str]) -> None:
    """Commands, options and choices, by the protocol of argcomplete: words on descriptor 8."""
    asked = {'COMP_LINE': typed, 'COMP_POINT': str(len(typed)), 'COMP_TYPE': '9',
             '_ARGCOMPLETE': '1', '_ARGCOMPLETE_IFS': '\n', '_ARGCOMPLETE_SUPPRESS_SPACE': '1'}
    done = subprocess.run(
        ['bash', '-c', f'{sys.executable} -m tudor_dynamics 8>&1 9>/dev/null'],
        env=os.environ | asked, capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) == answers


@pytest.mark.parametrize(('words', 'name'), [
    (['excite', '--floor', '0', '--meshes', 'a', 'b', '--arm', 'x', '--out', 'plan'], 'arm'),
    (['simulate', '--arm', 'x', '--modes', '3'], 'arm'),
    (['tune', '--arm', 'x', '--model', 'm', '--out', 'y'], 'arm'),
    (['tune', '--arm=x', '--model=m', '--out', 'y'], 'arm'),
    (['export', '--to', 'urdf', '--model', 'x', '--out', 'y'], 'model')])
def test_arm_and_model_have_one_name(words: list[str], name: str) -> None:
    """Where a bare word names them, the option of the other commands does, too."""
    args = entry.build_parser(words[0]).parse_args(words)
    assert getattr(args, name) == 'x'
    assert args.out in (None, 'plan', 'y')


def test_a_description_that_cannot_be_read_is_left_out_of_a_bug_report(
    command: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What the command says of it is what the file is for."""
    (tmp_path / 'secret.yaml').write_text('name: arm')
    monkeypatch.setattr('os.access', lambda *_: False)
    command.run, kept = _raise(BagError('secret.yaml: cannot be read')), tmp_path / 'debug.txt'
    assert entry.main(['evaluate', str(tmp_path / 'secret.yaml'), '--debug', str(kept)]) == 2
    assert 'cannot be read' in kept.read_text() and 'name: arm' not in kept.read_text()


@pytest.mark.parametrize(('command', 'old', 'new'), [
    ('fit', '--force', '--exit-zero'), ('simulate', '--plot', '--pictures')])
def test_old_names_of_options(
    capsys: pytest.CaptureFixture[str], command: str, old: str, new: str,
) -> None:
    """They work, and one line says what they are called now."""
    with pytest.raises(SystemExit, match='2'):
        entry.main([command, old, 'arm.yaml', '--out', 'm', '--bag'])
    err = capsys.readouterr().err
    assert f'warning: {old} is now {new}; version 1.2 removes the old name\n' in err
    assert 'there is no option --bag' in err
